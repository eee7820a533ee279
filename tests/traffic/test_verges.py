"""Asphalt that ends as far out all along tells turns, and never ends within a lane."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traffic import road
from verge_marks import at, verges

from queuetail.traffic.road import place
from queuetail.traffic.verges import NO_VERGES, Trials, beside_cost, misses, together
from queuetail.types import Approach

TURNS, SHIFTS_M = np.radians(np.arange(-3.0, 3.01, 0.5)), np.arange(-6.0, 6.01, 0.5)


def trials(approach: Approach) -> Trials:
    middle = place(approach, np.array([100.0]), np.array([0.0]))[0]
    return Trials(TURNS, SHIFTS_M, np.array([60.0, -40.0]), middle, np.array([-1.0, 0.0]))


def test_only_the_turn_that_is_none_costs_little() -> None:
    true = road(lanes=2, course_deg=0.0)
    seen = verges(true, 0.8, 2.6, np.random.default_rng(1))
    cost, ends = beside_cost([true], seen, trials(true))
    turn, shift = np.unravel_index(cost.argmin(), cost.shape)
    assert TURNS[turn] == 0.0
    # How far out the asphalt ends is not known, so a shift within the shoulders costs nothing.
    none = int(np.flatnonzero(SHIFTS_M == 0.0)[0])
    assert cost[turn, none] < cost.min() + 1.0
    assert ends[turn, none] == pytest.approx([0.8, 2.6], abs=0.25)
    assert abs(SHIFTS_M[shift]) <= 1.5


@pytest.mark.parametrize("lane_m", [-3.5, 3.5])
def test_a_lane_aside_would_let_the_asphalt_end_in_a_lane(lane_m: float) -> None:
    true = road(lanes=2, course_deg=0.0)
    seen = verges(true, 0.8, 2.6, np.random.default_rng(2), strays=0)
    cost, _ = beside_cost([true], seen, trials(true))
    row = int(np.flatnonzero(TURNS == 0.0)[0])
    here, there = (int(np.flatnonzero(s == SHIFTS_M)[0]) for s in (0.0, lane_m))
    assert cost[row, there] > cost[row, here] + 4.0


def test_nothing_seen_costs_nothing() -> None:
    true = road(lanes=2)
    cost, _ = beside_cost([true], NO_VERGES, trials(true))
    assert not cost.any()
    miss, left, J = misses([true], NO_VERGES, np.array([1.0, 2.0]))
    assert (len(miss), left.shape, J.shape) == (0, (0, 2), (0, 2))
    assert len(together([])) == 0


def test_of_each_stretch_the_nearest_counts() -> None:
    true = road(lanes=2, course_deg=0.0)
    station = np.array([50.0, 50.0, 62.0, 50.0])
    offset = np.array([1.1, 3.0, 0.7, -7.0 - 2.2])
    seen = at(true, station, offset, np.array([0, 0, 0, 1]), np.array([0, 0, 1, 0]))
    miss, _, J = misses([true], seen, np.array([1.0, 2.0]))
    assert miss == pytest.approx([0.1, np.nan, -0.3, -0.2], nan_ok=True)
    assert J.tolist() == [[-1, 0], [-1, 0], [-1, 0], [0, 1]]


@settings(max_examples=25, deadline=None)
@given(
    left_m=st.floats(-1.0, 5.0),
    right_m=st.floats(-1.0, 5.0),
    by_m=st.floats(-0.2, 0.2),
    lanes=st.integers(1, 4),
)
def test_derivatives_by_the_ends_are_right(
    left_m: float, right_m: float, by_m: float, lanes: int
) -> None:
    true = road(lanes=lanes, course_deg=30.0)
    seen = verges(true, left_m, right_m, np.random.default_rng(3), strays=0)
    ends = np.array([1.0, 2.0])
    before, _, J = misses([true], seen, ends)
    after, _, _ = misses([true], seen, ends + by_m)
    assert after - before == pytest.approx(J.sum(axis=1) * by_m, abs=1e-9)
    # The one stretch of each place has one place: it counts however far off it is.
    assert np.isfinite(before).all()
