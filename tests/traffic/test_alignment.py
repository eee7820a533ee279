"""Biased trajectories and lines are brought back onto the lanes that they belong to."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traffic import drive, opposite, road
from verge_marks import verges

from queuetail.geo.ground import apply_homography
from queuetail.traffic.alignment import Alignment, Camera
from queuetail.traffic.alignment import align as align_to
from queuetail.traffic.lane_evidence import NO_MARKS, WINDOW_M, LineMarks, gather
from queuetail.traffic.paths import Trajectory
from queuetail.traffic.road import locate, place
from queuetail.traffic.verges import NO_VERGES, Verges
from queuetail.types import Approach, Floats

CAMERA = Camera(np.array([140.0, -20.0]), 110.0)


def align(
    approaches: Sequence[Approach],
    seen: Sequence[Trajectory],
    camera: Camera,
    marks: LineMarks = NO_MARKS,
    beside: Verges = NO_VERGES,
) -> Alignment | None:
    return align_to(approaches, gather(seen, marks), camera, 0.0, beside)


def biased(seen: list[Trajectory], yaw_deg: float, shift: tuple[float, float]) -> list[Trajectory]:
    """What is located with a heading and a position that are wrong."""
    c, s = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    R = np.array([[c, -s], [s, c]])
    foot = CAMERA.foot_enu
    return [Trajectory(t.times_s, (t.enu - foot) @ R.T + foot + shift) for t in seen]


def tilted(slope: tuple[float, float], yaw_deg: float, shift: tuple[float, float]) -> Floats:
    """What a wrong pitch and roll, heading and place do to the ground: (3, 3)."""
    c, s = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    H = np.array([[c, -s, 0.0], [s, c, 0.0], [*(-np.array(slope) / CAMERA.height_m), 1.0]])
    there, back = np.eye(3), np.eye(3)
    there[:2, 2], back[:2, 2] = CAMERA.foot_enu + shift, -CAMERA.foot_enu
    return np.asarray(there @ H @ back)


def seen_through(H: Floats, marks: LineMarks) -> LineMarks:
    enu = apply_homography(H, marks.enu)
    course = apply_homography(H, marks.enu + marks.course) - enu
    return LineMarks(enu, course / np.linalg.norm(course, axis=1, keepdims=True))


def beside_through(H: Floats, beside: Verges) -> Verges:
    """Verges as they are seen by a wrong attitude."""
    seen = seen_through(H, LineMarks(beside.seen.enu, beside.seen.course))
    return replace(beside, seen=replace(beside.seen, enu=seen.enu, course=seen.course))


def paint(
    approach: Approach, edges: tuple[int, ...], rng: np.random.Generator, share: float = 1.0
) -> LineMarks:
    """Marks on some of the lanes' edges, counted from the axis, a few centimetres off."""
    length = float(np.linalg.norm(np.diff(approach.axis_enu, axis=0), axis=1).sum())
    station = np.tile(np.arange(WINDOW_M / 2, length, WINDOW_M), len(edges))
    edge = np.repeat(edges, len(station) // len(edges))
    kept = rng.uniform(size=len(station)) < share
    offset = -edge * approach.lane_width_m + rng.normal(0.0, 0.03, len(station))
    enu = place(approach, station[kept], offset[kept])
    return LineMarks(enu, locate(approach, enu)[2])


def strange_lines(
    true: Approach, rng: np.random.Generator, offset_m: Floats, station_m: Floats, spread_m: float
) -> LineMarks:
    """Marks at all of some offsets and stations, which are nobody's lanes."""
    offset = np.tile(offset_m, len(station_m))
    station = np.repeat(station_m, len(offset_m))
    strange = place(true, station, offset + rng.normal(0.0, spread_m, len(offset)))
    return LineMarks(strange, locate(true, strange)[2])


def lateral_after(true: Approach, marks: LineMarks, wrong: LineMarks, found: Alignment) -> Floats:
    """How far across the road corrected marks are from where they are painted."""
    fixed = found.apply(wrong.enu)
    return np.asarray(locate(true, fixed)[1] - locate(true, marks.enu)[1])


def lateral_errors(true: Approach, seen: list[Trajectory], fixed: Floats) -> Floats:
    """How far across the road corrected places are from where they were driven."""
    driven = np.concatenate([t.enu for t in seen])
    return np.asarray(locate(true, fixed)[1] - locate(true, driven)[1])


@pytest.mark.parametrize("radius_m", [math.inf, 300.0])
@pytest.mark.parametrize("lanes", [1, 2, 3])
def test_recovers_heading_and_shift(radius_m: float, lanes: int) -> None:
    true = road(radius_m, lanes=lanes, course_deg=10.0)
    seen = drive(true, np.random.default_rng(lanes), 14, noise_m=0.4, fragment=0.5, changing=0.1)
    wrong = biased(seen, 1.0, (1.2, -0.9))
    found = align([true], wrong, CAMERA)
    assert found is not None
    # A tilt moves a straight road much as a turn does: vehicles alone hardly tell them apart.
    assert found.rotation_deg == pytest.approx(-1.0, abs=2.5 * found.rotation_sigma_deg)
    assert found.rotation_sigma_deg < 0.8
    fixed = found.apply(np.concatenate([t.enu for t in wrong]))
    assert np.abs(np.median(lateral_errors(true, seen, fixed))) < 0.3
    assert np.quantile(np.abs(lateral_errors(true, seen, fixed)), 0.95) < 0.6
    assert found.vehicles >= 12
    assert found.residual_m < 0.5
    assert found.shift_sigma_m < (2.0 if lanes == 1 else 0.7)


def test_one_shift_for_both_carriageways() -> None:
    rng = np.random.default_rng(3)
    true = road(lanes=2, course_deg=10.0)
    other = opposite(true, 8.0)
    seen = drive(true, rng, 8) + drive(other, rng, 8)
    found = align([true, other], biased(seen, -1.5, (2.0, 0.5)), CAMERA)
    assert found is not None
    fixed = found.apply(np.concatenate([t.enu for t in biased(seen, -1.5, (2.0, 0.5))]))
    assert np.abs(lateral_errors(true, seen, fixed)).max() < 0.5


def test_does_not_move_along_a_straight_road() -> None:
    true = road(lanes=2, course_deg=0.0)
    seen = drive(true, np.random.default_rng(4), 12)
    found = align([true], biased(seen, 0.0, (1.5, 2.0)), CAMERA)
    assert found is not None
    middle = np.concatenate([t.enu for t in seen]).mean(axis=0)
    moved = found.apply(middle[None])[0] - middle
    assert moved[0] == pytest.approx(-1.5, abs=0.3)
    assert abs(moved[1]) < 1.5  # what the turn about the camera does there, no more
    assert found.shift_m == pytest.approx(1.5, abs=0.3)  # to the left of a road northwards


def test_says_that_it_may_be_the_other_lane() -> None:
    true = road(lanes=2, course_deg=0.0)
    single = Approach("one", true.axis_enu, 0.0, 1, 3.5)
    seen = drive(single, np.random.default_rng(5), 10)
    sure = align([true], drive(true, np.random.default_rng(5), 10), CAMERA)
    unsure = align([true], biased(seen, 0.0, (1.6, 0.0)), CAMERA)
    assert sure is not None
    assert unsure is not None
    assert unsure.shift_sigma_m > 3 * sure.shift_sigma_m


def test_none_until_enough_agree() -> None:
    rng = np.random.default_rng(6)
    true = road(lanes=2)
    across = road(lanes=2, course_deg=130.0, start=(100.0, 60.0))
    assert align([true], (), CAMERA) is None
    assert align((), drive(true, rng, 8), CAMERA) is None
    assert align([true], drive(true, rng, 3), CAMERA) is None
    assert align([true], drive(true, rng, 9, from_to_m=(0.0, 20.0)), CAMERA) is None
    assert align([true], drive(across, rng, 9), CAMERA) is None


@pytest.mark.parametrize("radius_m", [math.inf, 300.0, -500.0])
def test_lines_alone_undo_a_wrong_attitude(radius_m: float) -> None:
    rng = np.random.default_rng(1)
    true = road(radius_m, lanes=2, course_deg=10.0)
    marks = paint(true, (0, 1, 2), rng, share=0.7)
    wrong = seen_through(tilted((0.008, -0.005), 1.0, (1.4, -1.0)), marks)
    assert np.abs(locate(true, wrong.enu)[1] - locate(true, marks.enu)[1]).max() > 1.5
    found = align([true], (), CAMERA, wrong)
    assert found is not None
    assert np.abs(lateral_after(true, marks, wrong, found)).max() < 0.2
    assert found.marks > 0.9 * len(marks)
    assert found.vehicles == 0
    assert found.move_sigma_m < 0.3


def test_lines_say_more_than_vehicles_that_all_seem_aside() -> None:
    rng = np.random.default_rng(2)
    true = road(lanes=2, course_deg=0.0)
    marks = paint(true, (0, 2), rng)
    seen = biased(drive(true, rng, 14), 0.0, (0.5, 0.0))  # as shadows set them
    alone, both = align([true], seen, CAMERA), align([true], seen, CAMERA, marks)
    assert alone is not None
    assert both is not None
    assert alone.shift_m == pytest.approx(0.5, abs=0.2)
    assert abs(both.shift_m) < 0.1
    assert both.move_sigma_m < alone.move_sigma_m


def test_one_line_alone_may_be_any() -> None:
    true = road(lanes=2, course_deg=0.0)
    marks = paint(true, (2,), np.random.default_rng(3))
    wrong = seen_through(tilted((0.0, 0.0), 0.0, (1.75, 0.0)), marks)
    found = align([true], (), CAMERA, wrong)
    assert found is not None
    assert found.move_sigma_m > 1.0


@pytest.mark.parametrize("radius_m", [math.inf, 300.0])
def test_the_ends_of_the_asphalt_tell_which_line_it_is(radius_m: float) -> None:
    rng = np.random.default_rng(3)
    true = road(radius_m, lanes=2, course_deg=0.0)
    bias = tilted((0.006, -0.004), 0.8, (1.2, 0.0))
    marks, beside = paint(true, (2,), rng), verges(true, 0.8, 2.6, rng)
    wrong = seen_through(bias, marks)
    alone = align([true], (), CAMERA, wrong)
    both = align([true], (), CAMERA, wrong, beside_through(bias, beside))
    assert alone is not None
    assert both is not None
    assert np.abs(lateral_after(true, marks, wrong, both)).max() < 0.25
    assert both.move_sigma_m < 0.5 * alone.move_sigma_m
    assert both.verges > 0.8 * 2 * len(np.unique(beside.stretch))


def test_the_ends_of_the_asphalt_alone_are_no_lanes() -> None:
    true = road(lanes=2, course_deg=0.0)
    beside = verges(true, 0.8, 2.6, np.random.default_rng(3))
    assert align([true], (), CAMERA, NO_MARKS, beside) is None


def test_few_vehicles_will_do_where_the_asphalt_ends_on_both_sides() -> None:
    rng = np.random.default_rng(7)
    true = road(lanes=2, course_deg=0.0)
    bias = tilted((0.0, 0.0), 1.0, (1.0, 0.0))
    seen = drive(true, rng, 3)
    wrong = [replace(t, enu=apply_homography(bias, t.enu)) for t in seen]
    marks = seen_through(bias, paint(true, (1,), rng, share=0.15))
    assert len(marks) < 6
    assert align([true], wrong, CAMERA, marks) is None
    found = align([true], wrong, CAMERA, marks, beside_through(bias, verges(true, 0.8, 2.6, rng)))
    assert found is not None
    fixed = found.apply(np.concatenate([t.enu for t in wrong]))
    assert abs(np.median(lateral_errors(true, seen, fixed))) < 0.4


def test_lines_do_not_turn_a_road_round() -> None:
    """An axis drawn against the traffic has its lanes on the wrong side: lines would fit there."""
    rng = np.random.default_rng(5)
    true = road(lanes=2, course_deg=0.0)
    drawn = Approach("drawn", true.axis_enu[::-1], 0.0, 2, 3.5)
    marks = paint(true, (0, 1, 2), rng)
    assert align([drawn], (), CAMERA, marks) is not None
    assert align([drawn], drive(true, rng, 5), CAMERA, marks) is None
    right = align([true], drive(true, rng, 5) + drive(opposite(true, 0.5), rng, 9), CAMERA, marks)
    assert right is not None
    assert abs(right.shift_m) < 0.1


def test_lines_of_another_road_are_no_evidence() -> None:
    rng = np.random.default_rng(4)
    true = road(lanes=2, course_deg=0.0)
    # Nothing is painted where lanes have edges, at whatever shift: lines every 2.2 m.
    marks = strange_lines(true, rng, np.arange(-6.6, 3.0, 2.2), np.arange(6.0, 222.0, 12.0), 0.1)
    assert align([true], (), CAMERA, marks) is None


def test_many_vehicles_in_their_lanes_outweigh_strange_lines() -> None:
    """Ridges of gravel and repairs lie anywhere; that twenty drivers keep lanes is no chance."""
    rng = np.random.default_rng(4)
    true = road(lanes=2, course_deg=0.0)
    marks = strange_lines(true, rng, np.arange(-9.6, 9.0, 2.7), np.arange(30.0, 210.0, 30.0), 0.4)
    assert align([true], drive(true, rng, 6), CAMERA, marks) is None
    found = align([true], drive(true, rng, 24), CAMERA, marks)
    assert found is not None
    assert abs(found.shift_m) < 0.5


@settings(max_examples=15, deadline=None)
@given(
    yaw_deg=st.floats(-2.0, 2.0),
    east_m=st.floats(-1.0, 1.0),
    course_deg=st.floats(0.0, 360.0),
    lanes=st.integers(2, 4),
    seed=st.integers(0, 99),
)
def test_correction_undoes_any_small_bias(
    yaw_deg: float, east_m: float, course_deg: float, lanes: int, seed: int
) -> None:
    true = road(lanes=lanes, course_deg=course_deg, start=(100.0, 20.0))
    seen = drive(true, np.random.default_rng(seed), 5 * lanes)
    wrong = biased(seen, yaw_deg, (east_m, 0.3))
    middle = np.concatenate([t.enu for t in wrong]).mean(axis=0)
    found = align([true], wrong, Camera(middle, 110.0))
    assert found is not None
    errors = lateral_errors(true, seen, found.apply(np.concatenate([t.enu for t in wrong])))
    # A lane to the side fits as well where the outer lanes' vehicles are few; never in between.
    lanes_off = np.round(np.median(errors) / true.lane_width_m)
    assert abs(np.median(errors) - lanes_off * true.lane_width_m) < 0.4
    assert found.shift_sigma_m > 0.3 * abs(lanes_off) * true.lane_width_m
