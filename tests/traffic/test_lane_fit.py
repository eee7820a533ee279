"""Lanes across a carriageway: vehicles keep to their middles, painted lines lie on their edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.traffic.lanes import fit_lanes
from queuetail.types import Floats


def lines(*offsets_m: float, marks: int = 14, noise_m: float = 0.05) -> Floats:
    rng = np.random.default_rng(0)
    return np.repeat(offsets_m, marks) + rng.normal(0.0, noise_m, len(offsets_m) * marks)


def test_without_votes_there_are_no_lanes() -> None:
    with pytest.raises(ValueError, match="at least one vote"):
        fit_lanes(np.zeros(0), np.zeros(0, np.int64))


@settings(max_examples=30, deadline=None)
@given(
    width_m=st.floats(3.0, 4.1),
    count=st.integers(1, 4),
    left_m=st.floats(-20.0, 20.0),
    aside_m=st.floats(-0.8, 0.8),
)
def test_lines_show_the_lanes_to_a_decimetre_however_vehicles_lean(
    width_m: float, count: int, left_m: float, aside_m: float
) -> None:
    owner = np.arange(12)
    votes = left_m - (owner % count + 0.5) * width_m + aside_m
    edges = [left_m - n * width_m for n in range(count + 1)]
    lanes = fit_lanes(votes, owner, lines(*edges), doubt_m=0.5)
    assert lanes.count == count
    assert lanes.left_edge_m == pytest.approx(left_m, abs=0.15)
    assert lanes.width_m == pytest.approx(width_m, abs=0.1)
    assert lanes.aside_m == pytest.approx(aside_m, abs=0.35)
    assert lanes.edges_m == pytest.approx(edges, abs=0.2)


def test_the_far_edge_of_an_empty_lane_tells_the_width() -> None:
    """Two edge lines, and vehicles that seem to drive far right in the right one of two lanes."""
    votes, owner = np.full(5, -6.2), np.arange(5)
    lanes = fit_lanes(votes, owner, lines(0.0, -7.2))
    assert lanes.count == 1
    assert lanes.width_m == pytest.approx(3.6, abs=0.05)
    assert lanes.left_edge_m == pytest.approx(-3.6, abs=0.1)


def test_lines_of_another_carriageway_do_not_count() -> None:
    votes, owner = np.array([-1.8, -5.4] * 4), np.arange(8)
    alone = fit_lanes(votes, owner, lines(0.0, -7.2))
    beside = fit_lanes(votes, owner, lines(0.0, -7.2, 8.0, 15.2))
    assert beside == alone


def test_one_vehicle_is_enough_for_a_lane_between_lines_only() -> None:
    votes, owner = np.array([-1.8, -5.4]), np.arange(2)
    assert fit_lanes(votes, owner).count == 1
    assert fit_lanes(votes, owner, lines(0.0, -7.2)).count == 2
    # Beyond the lines it may be anything.
    beyond = np.array([-1.8, -1.8, -5.4, -5.4, -9.0])
    assert fit_lanes(beyond, np.array([0, 1, 2, 3, 4]), lines(0.0, -7.2)).count == 2
