"""Roads are found from made traffic of known geometry, as they are, and never out of nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traffic import drive, opposite, road, strays

from queuetail.traffic.axis_ends import LINED_ONWARD_M, ONWARD_M
from queuetail.traffic.carriageways import Trajectory, discover
from queuetail.traffic.lane_evidence import LineMarks
from queuetail.traffic.road import locate, place
from queuetail.types import Approach


def assert_same_road(found: Approach, true: Approach, lateral_m: float = 0.5) -> None:
    station, _, _ = locate(true, found.axis_enu)
    length = float(np.linalg.norm(np.diff(true.axis_enu, axis=0), axis=1).sum())
    axis = found.axis_enu[(station > -5.0) & (station < length + 5.0)]  # beyond, nothing is true
    station, offset, course = locate(true, axis)
    legs = np.diff(axis, axis=0)
    assert ((legs * course[1:]).sum(axis=1) > 0).all(), "the axis goes the wrong way"
    assert (np.diff(station) > 0).all()
    assert np.median(np.abs(offset)) < lateral_m
    assert np.abs(offset).max() < 2 * lateral_m
    assert found.lanes == true.lanes
    if true.lanes > 1:
        assert found.lane_width_m == pytest.approx(true.lane_width_m, rel=0.1)


@pytest.mark.parametrize("radius_m", [math.inf, 300.0, -120.0])
@pytest.mark.parametrize("lanes", [1, 2, 3, 4])
def test_finds_both_carriageways_with_their_lanes(radius_m: float, lanes: int) -> None:
    rng = np.random.default_rng(lanes)
    true = road(radius_m, lanes=lanes, width_m=3.2 if lanes == 3 else 3.6)
    other = opposite(true, 7.0)
    seen = drive(true, rng, 30, fragment=0.4, changing=0.2) + drive(other, rng, 12)
    found = discover(seen + strays(rng, 5, true.axis_enu))
    assert len(found) == 2
    assert_same_road(found[0], true)
    assert_same_road(found[1], other)


@pytest.mark.parametrize("radius_m", [math.inf, 300.0, -150.0])
def test_axis_spans_where_traffic_was_seen_and_goes_on_as_the_road_does(radius_m: float) -> None:
    true = road(radius_m, length_m=400.0)
    seen = drive(true, np.random.default_rng(1), 10, from_to_m=(120.0, 300.0))
    (found,) = discover(seen)
    station, offset, _ = locate(true, found.axis_enu)
    assert station[0] == pytest.approx(120.0 - ONWARD_M, abs=8.0)
    assert station[-1] == pytest.approx(300.0 + ONWARD_M, abs=8.0)
    assert np.abs(offset).max() < 1.5
    assert np.linalg.norm(np.diff(found.axis_enu, axis=0), axis=1).max() < 30.0


def test_two_way_road_parted_by_a_line_is_two_approaches() -> None:
    rng = np.random.default_rng(5)
    true = road(250.0, lanes=1)
    other = opposite(true, 0.0)
    found = discover(drive(true, rng, 9, noise_m=0.3) + drive(other, rng, 6, noise_m=0.3))
    assert [a.lane_width_m for a in found] == [3.5, 3.5]
    assert_same_road(found[0], true)
    assert_same_road(found[1], other)


def test_ramp_is_an_approach_from_where_it_diverges() -> None:
    rng = np.random.default_rng(2)
    main = road(length_m=300.0, lanes=2)
    s = np.arange(0.0, 301.0, 2.0)
    ramp = Approach("ramp", place(main, s, np.where(s > 120, -3.5 - 0.1 * (s - 120), -3.5)))
    found = discover(drive(main, rng, 16) + drive(ramp, rng, 8))
    assert len(found) == 2
    assert found[0].name == "NEB"
    assert found[1].name == "NEB 2"
    assert_same_road(found[0], main)
    assert_same_road(found[1], ramp)
    assert locate(main, found[1].axis_enu[:1])[0][0] > 120.0


def test_lane_beyond_a_wide_gap_is_another_approach() -> None:
    rng = np.random.default_rng(3)
    near, far = road(lanes=2), road(lanes=2)
    far = Approach("far", place(far, np.arange(0.0, 250.0, 5.0), np.full(50, 14.0)), 0.0, 1)
    found = discover(drive(near, rng, 12) + drive(far, rng, 6))
    assert [a.lanes for a in found] == [2, 1]
    assert_same_road(found[1], far)


def test_most_traffic_comes_first() -> None:
    rng = np.random.default_rng(4)
    true = road(lanes=1, course_deg=90.0)
    found = discover(drive(true, rng, 4) + drive(opposite(true, 9.0), rng, 9))
    assert [a.name for a in found] == ["WB", "EB"]


def test_is_not_sure_with_too_little() -> None:
    rng = np.random.default_rng(6)
    true = road(lanes=1)
    assert discover(()) == ()
    assert discover(drive(true, rng, 2, from_to_m=(0.0, 60.0))) == ()
    assert discover(drive(true, rng, 6, from_to_m=(0.0, 12.0))) == ()
    assert discover(strays(rng, 12, true.axis_enu)) == ()
    assert len(discover(drive(true, rng, 3, from_to_m=(0.0, 60.0)))) == 1


def painted(true: Approach, from_to_m: tuple[float, float] = (0.0, 250.0)) -> LineMarks:
    """Both edge lines, every twelve metres."""
    s = np.arange(from_to_m[0] + 6.0, from_to_m[1], 12.0)
    rng = np.random.default_rng(1)
    right_m = -true.lanes * true.lane_width_m
    enu = [place(true, s, np.full(len(s), o) + rng.normal(0, 0.05, len(s))) for o in (0.0, right_m)]
    both = np.concatenate(enu)
    return LineMarks(both, locate(true, both)[2])


@pytest.mark.parametrize("radius_m", [math.inf, 400.0, -400.0])
def test_two_short_trajectories_between_lines_show_a_road_to_a_decimetre(radius_m: float) -> None:
    rng = np.random.default_rng(8)
    true = road(radius_m, width_m=3.6)
    seen = [
        *drive(true, rng, 2, noise_m=0.3, from_to_m=(60.0, 95.0)),
        *drive(true, rng, 1, noise_m=0.3, from_to_m=(100.0, 118.0)),
    ]
    assert discover(seen[:2]) == ()
    (found,) = discover(seen, painted(true))
    assert_same_road(found, true, lateral_m=0.2)
    assert found.lane_width_m == pytest.approx(3.6, abs=0.06)


def test_an_axis_follows_lines_beyond_the_traffic_and_onward() -> None:
    true = road(-600.0, length_m=400.0)
    seen = drive(true, np.random.default_rng(1), 10, from_to_m=(150.0, 250.0))
    lined = painted(true, (100.0, 312.0))
    (found,) = discover(seen, lined)
    station, offset, _ = locate(true, found.axis_enu)
    assert station[[0, -1]] == pytest.approx(
        [106.0 - LINED_ONWARD_M, 306.0 + LINED_ONWARD_M], abs=9
    )
    assert np.abs(offset).max() < 1.0
    # A line that begins again after a long gap is another road's.
    apart = LineMarks(lined.enu + 300.0 * lined.course, lined.course)
    (alone,) = discover(seen, apart)
    assert locate(true, alone.axis_enu)[0][-1] == pytest.approx(250.0 + ONWARD_M, abs=9.0)


def test_a_road_may_be_suspected_long_before_it_is_sure() -> None:
    true = road(lanes=1)
    seen = drive(true, np.random.default_rng(2), 1, noise_m=0.2, from_to_m=(100.0, 118.0))
    assert discover(seen) == ()
    (suspected,) = discover(seen, suspect=True)
    assert_same_road(suspected, true, lateral_m=3.0)


def test_what_was_known_of_a_road_steadies_it() -> None:
    """Where few vehicles creep, their own courses say little."""
    rng = np.random.default_rng(9)
    true = road(300.0, width_m=3.6)
    seen = drive(true, rng, 3, noise_m=0.7, from_to_m=(100.0, 122.0))
    (found,) = discover(seen, painted(true), known=(true,))
    assert_same_road(found, true, lateral_m=0.2)


def test_standing_vehicles_and_gaps_do_no_harm() -> None:
    rng = np.random.default_rng(7)
    true = road(lanes=2)
    seen = drive(true, rng, 8)
    seen.append(Trajectory(np.arange(300) / 6, true.axis_enu[40] + rng.normal(0, 0.3, (300, 2))))
    seen.append(Trajectory(np.zeros(1), np.array([[np.nan, 0.0]])))
    seen.append(Trajectory(np.zeros(0), np.zeros((0, 2))))
    (found,) = discover(seen)
    assert_same_road(found, true)


@settings(max_examples=12, deadline=None)
@given(
    bend=st.floats(-1 / 100, 1 / 100),
    lanes=st.integers(1, 4),
    width_m=st.floats(3.0, 4.2),
    course_deg=st.floats(0.0, 360.0),
    noise_m=st.floats(0.2, 0.8),
    seed=st.integers(0, 1000),
)
def test_any_road_is_found_where_it_is(
    bend: float, lanes: int, width_m: float, course_deg: float, noise_m: float, seed: int
) -> None:
    true = road(1 / bend if bend else math.inf, 200.0, lanes, width_m, course_deg)
    found = discover(drive(true, np.random.default_rng(seed), 30, noise_m, fragment=0.5))
    assert len(found) == 1
    assert_same_road(found[0], true, lateral_m=0.6)
