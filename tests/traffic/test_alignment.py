"""Biased trajectories are brought back onto the lanes that they were driven on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from synthetic_traffic import drive, opposite, road

from queuetail.traffic.alignment import align
from queuetail.traffic.paths import Trajectory
from queuetail.traffic.road import locate
from queuetail.types import Approach, Floats

CAMERA = np.array([140.0, -20.0])


def biased(seen: list[Trajectory], yaw_deg: float, shift: tuple[float, float]) -> list[Trajectory]:
    """What is located with a heading and a position that are wrong."""
    c, s = math.cos(math.radians(yaw_deg)), math.sin(math.radians(yaw_deg))
    R = np.array([[c, -s], [s, c]])
    return [Trajectory(t.times_s, (t.enu - CAMERA) @ R.T + CAMERA + shift) for t in seen]


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
    assert found.rotation_deg == pytest.approx(-1.0, abs=0.2)
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
    assert abs(moved[1]) < 0.6  # what the turn about the camera does there, no more
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
    found = align([true], wrong, middle)
    assert found is not None
    errors = lateral_errors(true, seen, found.apply(np.concatenate([t.enu for t in wrong])))
    # A lane to the side fits as well where the outer lanes' vehicles are few; never in between.
    lanes_off = np.round(np.median(errors) / true.lane_width_m)
    assert abs(np.median(errors) - lanes_off * true.lane_width_m) < 0.4
    assert found.shift_sigma_m > 0.3 * abs(lanes_off) * true.lane_width_m
