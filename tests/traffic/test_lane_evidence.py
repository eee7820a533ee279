"""Where vehicles and lines belong: middles and edges of lanes, in each one's own direction."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_traffic import drive, opposite, road

from queuetail.traffic.lane_evidence import (
    NO_MARKS,
    WANDER_M,
    WINDOW_M,
    LineMarks,
    gather,
    lateral,
    miss_m,
    ways,
)
from queuetail.traffic.road import place
from queuetail.types import Approach, Floats

ROAD = road(lanes=2, width_m=3.5, course_deg=0.0)


def marks(offset_m: Floats, approach: Approach = ROAD, back: bool = False) -> LineMarks:
    station = np.linspace(20.0, 200.0, len(offset_m))
    enu = place(approach, station, offset_m)
    course = np.tile([0.0, -1.0 if back else 1.0], (len(offset_m), 1))
    return LineMarks(enu, course)


def test_vehicles_that_moved_and_lines_are_gathered_by_the_way_they_cover() -> None:
    rng = np.random.default_rng(0)
    far, near = drive(ROAD, rng, 5), drive(ROAD, rng, 3, from_to_m=(50.0, 68.0))
    seen = gather([*far, *near], marks(np.zeros(7)))
    assert seen.vehicles == 5
    assert seen.is_mark.sum() == 7
    assert seen.weight[seen.is_mark] == pytest.approx(WINDOW_M / WANDER_M)
    # A vehicle that drove 250 m says as much as 250 m of line.
    one = seen.weight[seen.owner == 0].sum()
    assert one == pytest.approx(250.0 / WANDER_M, rel=0.15)


def test_thinned_evidence_is_less_and_weighs_the_same() -> None:
    seen = gather(drive(ROAD, np.random.default_rng(2), 10), marks(np.zeros(7)))
    few = seen.thinned(60)
    assert few.vehicles == 10
    assert few.is_mark.sum() == 7
    assert 40 < (~few.is_mark).sum() <= 60
    for kind in (True, False):
        weight = few.weight[few.is_mark == kind].sum()
        assert weight == pytest.approx(seen.weight[seen.is_mark == kind].sum())
    assert len(gather((), NO_MARKS).thinned(60)) == 0


def test_nothing_is_gathered_from_nothing() -> None:
    seen = gather((), NO_MARKS)
    assert len(seen) == 0
    assert seen.vehicles == 0
    assert len(lateral([ROAD], seen, 10.0).miss_m) == 0


def test_lines_belong_on_edges_whichever_way_they_run() -> None:
    offset = np.array([0.2, -3.6, -7.0, 1.5, -8.5])
    for back in (False, True):
        found = lateral([ROAD], gather((), marks(offset, back=back)), 10.0)
        assert found.miss_m == pytest.approx([0.2, -0.1, 0.0, 1.5, -1.5], abs=1e-9)
        assert found.left == pytest.approx(np.tile([-1.0, 0.0], (5, 1)), abs=1e-9)


def test_vehicles_belong_in_the_lanes_that_go_their_way() -> None:
    other = opposite(ROAD, 8.0)
    seen = gather(drive(other, np.random.default_rng(1), 6, noise_m=0.1), NO_MARKS)
    alone = lateral([ROAD], seen, 20.0)
    assert np.isnan(alone.miss_m).all()
    both = lateral([ROAD, other], seen, 20.0)
    assert np.abs(both.miss_m).max() < 1.2


def test_who_drives_along_an_approach_and_who_against() -> None:
    rng = np.random.default_rng(3)
    seen = gather(drive(ROAD, rng, 4) + drive(opposite(ROAD, 2.0), rng, 6), marks(np.zeros(9)))
    assert ways(ROAD, seen) == (4, 0)
    assert ways(ROAD, seen, beside_m=9.0) == (4, 6)
    assert ways(opposite(ROAD, 2.0), seen) == (6, 0)
    assert ways(Approach("turned", ROAD.axis_enu[::-1], 0.0, 2, 3.5), seen, 8.0) == (6, 4)


def test_what_is_out_of_reach_belongs_nowhere() -> None:
    found = lateral([ROAD], gather((), marks(np.array([0.5, 9.0]))), 5.0)
    assert np.isfinite(found.miss_m).tolist() == [True, False]


@given(offset_m=st.floats(-20.0, 12.0), lanes=st.integers(1, 4), is_mark=st.booleans())
def test_no_place_where_it_belongs_is_nearer(offset_m: float, lanes: int, is_mark: bool) -> None:
    approach = Approach("a", np.array([[0.0, 0.0], [0.0, 100.0]]), 0.0, lanes, 3.6)
    miss = float(miss_m(approach, np.array([offset_m]), np.array([is_mark]))[0])
    places = -3.6 * (np.arange(lanes + 1) if is_mark else np.arange(lanes) + 0.5)
    assert abs(miss) == pytest.approx(np.abs(offset_m - places).min(), abs=1e-9)
