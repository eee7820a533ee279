"""Vehicles followed along their lanes: what drives, stops, merges, hides, and what never was."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose
from queuetail.tracking.lane_tracker import LaneTracker
from queuetail.tracking.lane_vehicle import Interval, LaneVehicle, owns
from queuetail.types import (
    Approach,
    Band,
    CameraPose,
    LaneSight,
    Origin,
    RoadPoints,
    RoadRaster,
    Scene,
    Tracks,
    TrackState,
)

ORIGIN = Origin(36.11, -97.057)
ROAD = (Approach("NB", np.array([[0.0, 0.0], [400.0, 0.0]]), 0.0, 2, 3.6),)
VIEW = (0.0, 300.0)
# The camera stands to the right: what is tall leans over the lane to its left.
BAND = Band(0, (0, 60), 1500, 0, (0, 1500), (21.0, 39.0), 18.0, np.full((12, 2), (0.0, -2.0)))
MAPPING = mapping_from_pose(
    CameraPose(36.11, -97.0554, 150.0, 0.0, -90.0, 0.0, intrinsics_from_hfov(1280, 720, 84.0)),
    ORIGIN,
)
CONTRAST, BODY = 0.5, 1.0
# Lane, rear and front of one interval, and its contrast and body if they are not a vehicle's.
Seen = tuple[float, ...]


STEP_M = 0.2  # of the columns in which a lane's own motion is told
# Lane, first and last station of a stretch: how fast it moves there, and what is hidden there.
Flow = tuple[int, float, float, float]
Hidden = tuple[int, float, float]


def sights(flows: Sequence[Flow], hidden: Sequence[Hidden]) -> dict[tuple[int, int], LaneSight]:
    """Return what each lane shows beside its intervals: nothing where nothing is said."""
    columns = round(VIEW[1] / STEP_M)
    speeds, hides = np.full((2, columns), np.nan), np.zeros((2, columns), np.bool_)
    for lane, first, last, speed in flows:
        speeds[lane - 1, max(round(first / STEP_M), 0) : round(last / STEP_M)] = speed
    for lane, first, last in hidden:
        hides[lane - 1, max(round(first / STEP_M), 0) : round(last / STEP_M)] = True
    return {(0, lane): LaneSight(0.0, STEP_M, speeds[lane - 1], hides[lane - 1]) for lane in (1, 2)}


def points(
    seen: Sequence[Seen],
    view: tuple[float, float] = VIEW,
    flows: Sequence[Flow] = (),
    hidden: Sequence[Hidden] = (),
) -> RoadPoints:
    """Return intervals as the view gives them: cut where they reach its ends."""
    seen = [s for s in seen if s[2] > view[0] + 0.5 and s[1] < view[1] - 0.5]
    n = len(seen)
    rows = np.array([(*s, *(CONTRAST, BODY)[len(s) - 3 :]) for s in seen], float).reshape(n, 5)
    lane = rows[:, 0].astype(np.int64)
    return RoadPoints(
        approach=np.zeros(n, np.int64),
        lane=lane,
        rear_m=np.maximum(rows[:, 1], view[0]),
        front_m=np.minimum(rows[:, 2], view[1]),
        offset_m=-(lane - 0.5) * 3.6,
        cut_rear=rows[:, 1] < view[0],
        cut_front=rows[:, 2] > view[1],
        contrast=rows[:, 3],
        body=rows[:, 4],
        shadow=np.zeros(n, np.bool_),
        roof=np.zeros(n, np.bool_),
        astride=np.zeros(n, np.bool_),
        spans={0: view},
        boxes_px=np.zeros((n, 4)),
        sights=sights(flows, hidden),
    )


class Road:
    """A tracker and its clock."""

    def __init__(self) -> None:
        self.tracker = LaneTracker()
        self.t_s = 0.0

    def see(
        self,
        *seen: Seen,
        dt_s: float = 0.1,
        approaches: tuple[Approach, ...] = ROAD,
        flows: Sequence[Flow] = (),
        hidden: Sequence[Hidden] = (),
        shadows: Sequence[int] = (),
        shadow_at: Sequence[float] = (),
        astride: bool = False,
    ) -> Tracks:
        raster = RoadRaster(np.zeros((1, 1), np.uint8), 5.0, (BAND,), 1, approaches, {0: VIEW})
        told = points(seen, flows=flows, hidden=hidden)
        told.shadow[np.isin(told.lane, shadows) | np.isin(told.rear_m, shadow_at)] = True
        if astride:
            told.astride[:], told.offset_m[:] = True, -3.6
        tracks = self.tracker.update(told, Scene(self.t_s, raster, MAPPING))
        self.t_s += dt_s
        return tracks


def confirmed(tracks: Tracks) -> list[int]:
    return [i for i, s in enumerate(tracks.states) if s is not TrackState.TENTATIVE]


def rear(tracks: Tracks, i: int = 0) -> float:
    return float(tracks.enu[i, 0] - tracks.length_m[i] / 2)


def braked(t_s: float, stop_m: float, speed_mps: float = 10.0) -> tuple[float, float]:
    """Return where a car is at `t_s` and how fast: it brakes at 5 m/s² up to its stop."""
    braking_s = speed_mps / 5
    rest_s = max(stop_m / speed_mps + braking_s / 2 - t_s, 0.0)
    if rest_s > braking_s:
        return speed_mps * t_s, speed_mps
    return stop_m - 2.5 * rest_s**2, 5 * rest_s


def test_a_driving_car_is_confirmed_soon_and_measured_well() -> None:
    road, rng = Road(), np.random.default_rng(0)
    ids = set()
    for step in range(60):
        at = -3.0 + 25.0 * step / 10 + rng.normal(0, 0.15)
        tracks = road.see((1, at, at + 4.6))
        ids |= set(tracks.ids.tolist())
        if step == 12:
            assert len(confirmed(tracks)) == 1
    assert len(ids) == 1
    assert tracks.velocity_mps[0] == pytest.approx([25.0, 0.0], abs=0.6)
    assert rear(tracks) == pytest.approx(-3.0 + 25.0 * 5.9, abs=0.4)
    assert tracks.length_m[0] == pytest.approx(4.6, abs=0.3)
    assert tracks.sigma_m[0] < 0.4


def drives_in(**looks: float) -> list[int]:
    """Return the pictures of 8 a second in which one told of what drives in at 25 m/s."""
    road, told = Road(), []
    for step in range(6):
        at = 1.0 + 25.0 * step / 8
        seen = (1, at, at + 4.6, looks.get("contrast", CONTRAST), looks.get("body", BODY))
        if confirmed(road.see(seen, dt_s=1 / 8)):
            told.append(step)
    return told


def test_what_surely_drives_is_told_in_the_second_picture_that_shows_it() -> None:
    """A dark thing that drives must go a way as well, and what is as faint as a stain."""
    assert drives_in() == [1, 2, 3, 4, 5]
    assert drives_in(body=0.1) == [5]
    assert 1 not in drives_in(contrast=0.12)


def test_who_was_told_early_and_is_not_seen_again_is_let_go_at_once() -> None:
    road = Road()
    road.see((1, 20.0, 24.6), dt_s=1 / 8)
    assert confirmed(road.see((1, 23.0, 27.6), dt_s=1 / 8))
    road.see(dt_s=1 / 8)
    road.see(dt_s=1 / 8)
    assert not confirmed(road.see(dt_s=1 / 8))


@pytest.mark.parametrize("to_lane", [1, 2])
def test_a_car_that_drives_between_two_lanes_for_long_is_one_car(to_lane: int) -> None:
    road = Road()
    for step in range(100):
        at = 1.0 + 6.0 * step / 10
        between = 40 <= step < 70
        lane = 1 if step < 70 else to_lane
        # Beside it, where it was taken out of the lane's middle, the road stands still.
        still = [(1, 0.0, VIEW[1], 0.0)] if between else []
        tracks = road.see((lane, at, at + 4.6), flows=still, astride=between)
        if between:
            assert tracks.velocity_mps[0, 0] == pytest.approx(6.0, abs=0.5)
    assert tracks.ids.tolist() == [1]
    assert confirmed(tracks) == [0]
    assert rear(tracks) == pytest.approx(1.0 + 6.0 * 9.9, abs=0.4)


def test_nothing_is_born_between_two_lanes() -> None:
    road = Road()
    for step in range(30):
        at = 1.0 + 6.0 * step / 10
        assert len(road.see((1, at, at + 4.6), astride=True)) == 0


def test_the_road_that_stands_still_does_not_stop_a_car_that_is_not_seen() -> None:
    road = Road()
    for step in range(40):
        at = 1.0 + 10.0 * step / 10
        road.see((1, at, at + 4.6), flows=[(1, at, at + 4.6, 10.0)])
    for _ in range(8):
        tracks = road.see(flows=[(1, 0.0, VIEW[1], 0.0)])
    assert tracks.velocity_mps[0, 0] == pytest.approx(10.0, abs=0.5)
    assert rear(tracks) == pytest.approx(1.0 + 10.0 * 4.7, abs=0.8)


@given(
    speed=st.floats(3.0, 30.0),
    steps=st.lists(st.floats(0.02, 0.4), min_size=30, max_size=50),
)
@settings(max_examples=40)
def test_the_speed_does_not_depend_on_when_the_frames_came(
    speed: float, steps: list[float]
) -> None:
    road = Road()
    for dt_s in steps:
        at = 1.0 + speed * road.t_s
        if at > VIEW[1] - 12:
            break
        tracks = road.see((1, at, at + 4.6), dt_s=dt_s)
    if road.t_s > 2.0:
        assert len(tracks) == 1
        assert tracks.velocity_mps[0, 0] == pytest.approx(speed, abs=0.05 * speed + 0.2)


def test_a_braking_car_is_followed_into_its_stop_and_held_for_minutes() -> None:
    road = Road()
    at, speed, worst = 1.0, 28.0, 0.0
    for step in range(150):
        at += speed * 0.1
        speed = max(speed - 0.5, 0.0) if step > 15 else speed
        tracks = road.see((1, at, at + 4.6))
        if step > 10:
            worst = max(worst, abs(tracks.velocity_mps[0, 0] - speed))
    assert worst < 2.0
    for _ in range(600):
        tracks = road.see((1, at, at + 4.6), dt_s=0.5)
    assert tracks.ids.tolist() == [1]
    assert tracks.states[0] is TrackState.CONFIRMED
    assert tracks.velocity_mps[0, 0] == pytest.approx(0.0, abs=0.05)
    assert road.tracker.footprints() == [
        (0, 1, pytest.approx(at, abs=0.2), pytest.approx(at + 4.6, abs=0.4), True, True)
    ]


def test_two_that_merge_stay_two_and_the_last_ones_rear_is_right() -> None:
    road = Road()
    for step in range(120):
        first = min(80.0 + 1.5 * step, 150.0)
        second = min(2.0 + 2.0 * step, 150.0 - 4.6 - 0.6)
        if first - second - 4.6 < 1.2:
            tracks = road.see((1, second, first + 4.6))  # bumper to bumper: one interval
        else:
            tracks = road.see((1, second, second + 4.6), (1, first, first + 4.6))
    assert len(tracks) == 2
    assert min(rear(tracks, 0), rear(tracks, 1)) == pytest.approx(144.8, abs=0.5)
    assert sorted(tracks.length_m.tolist()) == pytest.approx([4.6, 4.6], abs=0.6)
    assert np.abs(tracks.velocity_mps).max() < 0.5


def test_cars_that_merge_at_the_first_picture_are_told_by_their_length() -> None:
    road = Road()
    for _ in range(30):
        tracks = road.see((1, 100.0, 100.0 + 4 * 7.2))
    assert 3 <= len(tracks) <= 5
    assert min(rear(tracks, i) for i in range(len(tracks))) == pytest.approx(100.0, abs=0.6)


def test_a_truck_is_one_vehicle() -> None:
    road = Road()
    for step in range(60):
        at = 1.0 + 2.0 * step
        tracks = road.see((2, at, at + 16.5))
    assert len(tracks) == 1
    assert tracks.length_m[0] == pytest.approx(16.5, abs=0.5)


def test_a_trailer_that_shows_only_its_ends_is_one_truck() -> None:
    """Its cab and its rear drive a third of a second apart, as no two vehicles do, then queue."""
    road = Road()
    for step in range(150):
        at, _ = braked(step / 10, 130.0, 20.0)
        tracks = road.see((2, at, at + 4.5), (2, at + 11.0, at + 15.0))
    assert len(tracks) == 1
    assert tracks.length_m[0] == pytest.approx(15.0, abs=0.8)
    assert rear(tracks) == pytest.approx(130.0, abs=0.8)


def test_two_cars_that_follow_closely_stay_two() -> None:
    road = Road()
    for step in range(100):
        at = 1.0 + 1.2 * step
        tracks = road.see((1, at, at + 4.6), (1, at + 11.0, at + 15.6))
    assert len(tracks) == 2


def test_who_stops_dead_is_who_came() -> None:
    road = Road()
    ids = set()
    for step in range(90):
        at, speed = min(1.0 + 2.4 * step, 120.0), 24.0 if step < 50 else 0.0
        tracks = road.see((1, at, at + 4.6), flows=[(1, at, at + 4.6, speed)])
        ids |= {tracks.ids[i] for i in confirmed(tracks)}
    assert ids == {1}
    assert rear(tracks) == pytest.approx(120.0, abs=0.3)
    assert tracks.velocity_mps[0, 0] == pytest.approx(0.0, abs=0.1)


def test_the_shade_of_a_truck_beside_it_is_no_truck() -> None:
    """It drives as far as the truck, but is all shade, as long as it, and marked as its shadow."""
    road = Road()
    for step in range(80):
        at = 1.0 + 2.0 * step
        tracks = road.see((2, at, at + 12.0), (1, at, at + 12.0, 0.5, 0.05), shadows=(1,))
    assert [round(float(tracks.enu[i, 1]), 1) for i in confirmed(tracks)] == [-5.4]


def test_a_shadow_that_drives_beside_its_caster_is_never_a_vehicle() -> None:
    """It shows more than shade where it enters, and then goes as far as the car beside it."""
    road = Road()
    for n in range(60):
        at = 20.0 + 2.5 * n
        car, shadow = (1, at, at + 4.6), (2, at + 1.0, at + 5.6, 0.3, 0.3 if n < 2 else 0.0)
        tracks = road.see(
            car,
            shadow,
            flows=[(1, at, at + 5, 25.0), (2, at, at + 6, 25.0)],
            shadows=[2] if n >= 2 else [],
        )
    assert len(confirmed(tracks)) == 1


def test_a_dark_car_is_believed_between_standing_ones_only() -> None:
    """What is all shade may be a tree's; as long as a car, before and behind one, it is a car."""
    road = Road()
    row = [(1, 100.0, 104.6), (1, 107.0, 111.6, 0.5, 0.05), (1, 114.0, 118.6)]
    alone = (1, 93.0, 97.6, 0.5, 0.05)
    for _ in range(30):
        tracks = road.see(alone, *row)
    assert sorted(round(rear(tracks, i)) for i in confirmed(tracks)) == [100, 107, 114]


def test_a_dark_car_in_a_row_is_believed_though_it_may_be_its_neighbours_shadow() -> None:
    road = Road()
    row = [(1, 100.0, 104.6), (1, 107.0, 111.6, 0.5, 0.05), (1, 114.0, 118.6)]
    after = (1, 121.0, 125.6, 0.5, 0.05)
    for _ in range(30):
        tracks = road.see(*row, after, shadow_at=(107.0, 121.0))
    assert sorted(round(rear(tracks, i)) for i in confirmed(tracks)) == [100, 107, 114]


def test_a_dark_car_that_merges_with_a_bright_one_is_kept() -> None:
    """It drove here, so it is no shadow of what it now stands close behind."""
    road = Road()
    for step in range(100):
        at, _ = braked(step / 10, 80.0)
        tracks = road.see((1, at, at + 4.6, 0.5, 0.05), (1, 87.0, 91.6))
    for _ in range(50):
        tracks = road.see((1, 80.0, 91.6, 0.5, 0.45))
    assert sorted(round(rear(tracks, i)) for i in confirmed(tracks)) == [80, 87]


def test_who_is_new_stays_in_the_interval_that_shows_it() -> None:
    """Four cars in one interval, and a dark thing just behind: none of the four slips there."""
    road = Road()
    for _ in range(20):
        flow = (1, 100.0, 126.6, 0.0)
        tracks = road.see((1, 100.0, 126.6), (1, 93.5, 98.5, 0.5, 0.05), flows=[flow])
    assert sorted(round(rear(tracks, i)) for i in confirmed(tracks)) == [100, 107, 113, 121]


def test_what_stands_in_front_of_half_a_vehicle_does_not_stop_it() -> None:
    """A parked car hides the lower half of a bus: the picture stands still there."""
    road = Road()
    for step in range(60):
        at = 10.0 + 0.6 * step
        hidden = (1, at - 1.0, at + 7.0, 0.0) if step > 30 else (1, 0.0, 0.1, 0.0)
        tracks = road.see((1, at, at + 11.0), flows=[(1, at, at + 11.0, 6.0), hidden])
    assert np.linalg.norm(tracks.velocity_mps[0]) == pytest.approx(6.0, abs=0.5)


def test_half_a_car_does_not_shrink_it() -> None:
    road = Road()
    for step in range(60):
        at = min(1.0 + 2.0 * step, 60.0)
        road.see((1, at, at + 12.0))
    for _ in range(20):
        tracks = road.see((1, 60.0, 65.0))
    assert tracks.length_m[0] == pytest.approx(12.0, abs=0.8)
    assert rear(tracks) == pytest.approx(60.0, abs=0.5)


def test_a_lane_change_keeps_the_vehicle() -> None:
    road = Road()
    for step in range(60):
        at = 1.0 + 2.0 * step
        tracks = road.see((1 if step < 30 else 2, at, at + 4.6))
    assert tracks.ids.tolist() == [1]
    assert tracks.enu[0, 1] == pytest.approx(-5.4, abs=0.6)


def test_a_car_that_enters_through_the_edge_has_its_own_length() -> None:
    """Its rear is outside at first: only the front is seen, and the interval grows."""
    road = Road()
    for step in range(30):
        at = -4.5 + 0.4 * step
        tracks = road.see((1, at, at + 4.6))
        if step == 4:
            assert rear(tracks) == pytest.approx(at, abs=1.2)
    assert len(tracks) == 1
    assert tracks.length_m[0] == pytest.approx(4.6, abs=0.4)
    assert tracks.velocity_mps[0, 0] == pytest.approx(4.0, abs=0.5)


def test_a_car_that_leaves_is_let_go() -> None:
    road = Road()
    for step in range(40):
        at = 250.0 + 2.5 * step
        tracks = road.see((1, at, at + 4.6))
    assert len(tracks) == 0


def test_what_is_not_seen_coasts_for_a_moment_only() -> None:
    road = Road()
    for step in range(30):
        tracks = road.see((1, 1.0 + step, 5.6 + step))
    tracks = road.see()
    assert tracks.states == (TrackState.COASTING,)
    before = float(tracks.sigma_m[0])
    tracks = road.see()
    assert tracks.sigma_m[0] > before
    for _ in range(20):
        tracks = road.see()
    assert len(tracks) == 0


def test_a_car_hidden_by_a_truck_beside_it_is_kept() -> None:
    road = Road()
    for step in range(120):
        car = min(30.0 + step, 60.0)
        truck = -70.0 + 2.0 * step if step < 63 else 56.0
        hidden = truck < car and car + 4.6 < truck + 16.0
        seen = [(2, truck, truck + 16.0)] + ([] if hidden else [(1, car, car + 4.6)])
        tracks = road.see(*seen, hidden=[(1, truck, truck + 16.0)])
    assert len(tracks) == 2
    assert sorted(tracks.length_m.tolist()) == pytest.approx([4.6, 16.0], abs=0.8)


def test_what_is_hidden_stands_still_and_does_not_creep() -> None:
    road, rng = Road(), np.random.default_rng(3)
    for _ in range(30):
        at = 60.0 + rng.normal(0, 0.2)
        road.see((1, at, at + 4.6))
    for _ in range(300):
        tracks = road.see(hidden=[(1, 50.0, 75.0)])
    assert rear(tracks) == pytest.approx(60.0, abs=0.5)
    assert tracks.velocity_mps[0, 0] == pytest.approx(0.0, abs=0.05)


def test_the_lane_s_own_motion_tells_a_newcomer_s_speed_at_once() -> None:
    road = Road()
    flows = [(1, 100.0, 104.6, 17.0)]
    tracks = road.see((1, 100.0, 104.6), flows=flows)
    assert tracks.velocity_mps[0, 0] == pytest.approx(17.0, abs=0.5)


def test_within_a_merged_interval_each_vehicle_goes_its_own_way() -> None:
    """Three cars close up and stop as one interval: only the lane's motion tells the middle."""
    road = Road()
    stops = (120.0, 112.0, 104.0)
    for step in range(220):
        ways = [braked(step / 10 - 1.2 * (2 - i), stop) for i, stop in enumerate(reversed(stops))]
        ats = [at for at, _ in ways]
        merged = step > 105
        seen = [(1, min(ats), max(ats) + 4.6)] if merged else [(1, at, at + 4.6) for at in ats]
        tracks = road.see(*seen, flows=[(1, at, at + 4.6, speed) for at, speed in ways])
    assert len(tracks) == 3
    rears = sorted(rear(tracks, i) for i in range(3))
    assert rears == pytest.approx(sorted(stops), abs=1.0)


def test_motion_that_cannot_be_the_vehicle_s_is_another_s() -> None:
    road = Road()
    for step in range(60):
        flows = [(1, 0.0, 300.0, -1.5)] if step > 20 else []
        tracks = road.see((1, 50.0 + step, 54.6 + step), flows=flows)
    assert tracks.velocity_mps[0, 0] == pytest.approx(10.0, abs=1.0)


def test_the_covariance_shrinks_with_every_measurement_and_settles() -> None:
    road = Road()
    sigmas = [float(road.see((1, 100.0, 104.6)).sigma_m[0]) for _ in range(60)]
    assert all(b <= a + 0.02 for a, b in itertools.pairwise(sigmas[2:]))
    assert sigmas[-1] < 0.35


def test_a_queue_of_the_first_picture_is_believed_within_a_second() -> None:
    road = Road()
    for _ in range(10):
        tracks = road.see((1, 150.0, 154.6), (1, 157.0, 161.6), (2, 140.0, 156.0))
    assert len(confirmed(tracks)) == 3


def test_apparitions_in_mid_view_are_not_believed_at_once() -> None:
    road = Road()
    for _ in range(50):
        road.see()
    for step in range(100):
        tracks = road.see((1, 150.0, 154.6))
        if step < 40:
            assert confirmed(tracks) == []
    assert len(confirmed(tracks)) == 1  # after all: a parked car that was uncovered


@pytest.mark.parametrize("stain", [(1, 150.0, 154.6, 0.08), (1, 150.0, 152.2, 0.6)])
def test_flat_stains_and_small_things_are_never_believed(stain: Seen) -> None:
    road = Road()
    for _ in range(200):
        assert confirmed(road.see(stain)) == []


def test_a_trees_shadow_is_never_believed_and_takes_no_passing_car() -> None:
    road = Road()
    for step in range(300):
        sway = 0.5 * np.sin(step / 8)
        seen: list[Seen] = [(1, 150.0 + sway, 156.0 + sway, CONTRAST, 0.0)]
        at = 1.0 + 1.3 * (step - 60)
        if step >= 60 and at < 290:
            if at + 4.6 > 149.0 and at < 157.0:  # merged: the detector tells the car by its body
                seen = []
            seen.append((1, at, at + 4.6))
        tracks = road.see(*seen)
        believed = confirmed(tracks)
        assert len(believed) <= 1
    assert believed == []


def test_a_standing_thing_that_others_drive_through_is_no_vehicle() -> None:
    road = Road()
    for _ in range(15):
        tracks = road.see((1, 150.0, 154.6))
    assert len(confirmed(tracks)) == 1
    for step in range(90):
        at = 1.0 + 2.5 * step
        over = at + 4.6 > 149.3 and at < 155.3
        merged: list[Seen] = [(1, min(at, 150.0), max(at + 4.6, 154.6))]
        seen = merged if over else [(1, at, at + 4.6), (1, 150.0, 154.6)]
        tracks = road.see(*seen)
    believed = confirmed(tracks)
    assert all(abs(rear(tracks, i) - 150.0) > 20 for i in believed)
    for _ in range(150):
        tracks = road.see((1, 150.0, 154.6))
    assert confirmed(tracks) == []


def drive_through(road: Road, standing: Seen) -> list[int]:
    """Let a car drive at 25 m/s through a standing thing; return what is believed there then."""
    _, rear_m, front_m = standing[:3]
    for step in range(90):
        at = 1.0 + 2.5 * step
        over = at + 4.6 > rear_m - 0.7 and at < front_m + 0.7
        merged: list[Seen] = [(1, min(at, rear_m), max(at + 4.6, front_m))]
        tracks = road.see(*(merged if over else [(1, at, at + 4.6), standing]))
    return [i for i in confirmed(tracks) if abs(rear(tracks, i) - rear_m) < 20]


def test_what_drove_and_stands_where_two_others_drive_through_is_no_vehicle() -> None:
    """A shadow that came along beside a vehicle: one alone may be thought of in a wrong lane."""
    road = Road()
    for n in range(80):
        at, _ = braked(n / 10, 150.0, 25.0)
        road.see((1, at, at + 4.6))
    for _ in range(30):
        road.see((1, 150.0, 154.6))
    assert len(drive_through(road, (1, 150.0, 154.6))) == 1
    assert drive_through(road, (1, 150.0, 154.6)) == []


@pytest.mark.parametrize("mark", [True, False])
def test_what_lies_where_a_known_stain_lies_is_that_and_no_passing_vehicle(mark: bool) -> None:
    thing = LaneVehicle(1, 0, 1, 150.0, 0.0, 3.0, -1.8, 0.0, mark=mark)
    assert owns(thing, Interval(0, 1, 150.5, 153.5, -1.8, False, False), 9.0) is mark
    joined = Interval(0, 1, 145.5, 153.5, -1.8, False, False)
    assert not owns(thing, joined, 9.0)


def drive_into(road: Road) -> None:
    """Let a car drive at 18 m/s to 6 m before a thing at 150 m, and be seen no more."""
    for n in range(120):
        at = 1.0 + 1.8 * n
        seen = [(1, at, at + 4.6)] if at + 4.6 < 144.0 else []
        road.see((1, 150.0, 153.0), *seen)


def test_what_others_drive_into_at_speed_is_no_vehicle() -> None:
    """The light between a bridge and its shadow: who comes from under it is another one."""
    road = Road()
    for _ in range(15):
        tracks = road.see((1, 150.0, 153.0))
    assert len(confirmed(tracks)) == 1
    drive_into(road)
    assert len(confirmed(road.see((1, 150.0, 153.0)))) == 1  # one may be lost for another reason
    drive_into(road)
    assert confirmed(road.see((1, 150.0, 153.0))) == []


def stands_at_the_edge(others_lane: int) -> list[int]:
    """Let two cars appear at 25 m/s just ahead of what stands where the picture begins."""
    road = Road()
    thing: Seen = (1, 2.0, 6.6)
    for _ in range(15):
        tracks = road.see(thing)
    assert len(confirmed(tracks)) == 1
    for n in range(60):
        at = 7.5 + 2.5 * (n % 30)
        flows = [(1, 2.0, 6.6, 0.0), (others_lane, at, at + 4.6, 25.0)]
        tracks = road.see(thing, (others_lane, at, at + 4.6), flows=flows)
    return [i for i in confirmed(tracks) if rear(tracks, i) < 10.0]


def test_what_stands_where_others_come_from_is_no_vehicle() -> None:
    """A tree's shadow at the picture's edge: who comes in is seen only when it has passed that."""
    assert stands_at_the_edge(others_lane=1) == []
    assert len(stands_at_the_edge(others_lane=2)) == 1


def test_what_stands_half_outside_where_the_picture_begins_may_be_anything() -> None:
    """Road that the sun lights, beyond a shadow's edge; a car that drove there is one."""
    road = Road()
    for _ in range(40):
        tracks = road.see((1, -1.0, 6.0))
    assert confirmed(tracks) == []
    came = Road()
    for n in range(80):
        at, speed = braked(n / 10, 4.0, speed_mps=6.0)
        tracks = came.see((1, at - 3.5, at + 1.1), flows=[(1, 0.0, at + 1.1, speed)])
    assert len(confirmed(tracks)) == 1


def test_a_car_that_came_and_stopped_stays_though_others_are_lost_behind_it() -> None:
    road = Road()
    for n in range(200):
        at, speed = braked(n / 10, 150.0)
        road.see((1, at, at + 3.0), flows=[(1, at, at + 3.0, speed)])
    drive_into(road)
    drive_into(road)
    assert len(confirmed(road.see((1, 150.0, 153.0)))) == 1


def test_what_stands_beside_where_all_drive_is_no_traffic() -> None:
    """A car parked on the shoulder, while the site's lanes lie a little aside."""
    road = Road()
    for n in range(100):
        at = (15.0 * 0.1 * n) % 250.0
        road.see((2, at, at + 4.6), flows=[(2, at, at + 5.0, 15.0)])
    road.tracker._lines._offset_m[0, 2] = (-4.0, 100)
    road.t_s = 0.05 + road.t_s
    stands: list[Seen] = [(2, 120.0, 124.6)]
    for _ in range(90):
        tracks = road.see(*stands, flows=[(2, 119.0, 126.0, 0.0)])
    assert not any(abs(rear(tracks, i) - 120.0) < 2.0 for i in confirmed(tracks))


def test_who_is_only_supposed_to_go_on_has_not_moved() -> None:
    """A stain that seemed to drive when it was first seen, and was not seen again."""
    road = Road()
    for n in range(7):
        road.see((1, 100.0 + 3.0 * n, 104.0 + 3.0 * n, 0.2, 0.05))
    for _ in range(4):
        assert confirmed(road.see(dt_s=0.08)) == []


def test_another_road_starts_anew() -> None:
    road = Road()
    for step in range(20):
        road.see((1, 1.0 + step, 5.6 + step))
    other = (Approach("NB", ROAD[0].axis_enu + np.array([0.0, 60.0]), 0.0, 2, 3.6),)
    assert len(road.see(approaches=other)) == 0


def test_vehicles_stay_who_they_are_when_the_road_is_laid_out_anew() -> None:
    """Both the counting of stations and the lanes change, one lane's width to the left."""
    road = Road()
    for step in range(30):
        before = road.see((1, 40.0 + step, 44.6 + step), (2, 20.0, 24.6))
    moved = (Approach("NB", ROAD[0].axis_enu + np.array([20.0, 3.6]), 0.0, 2, 3.6),)
    for step in range(30, 60):
        after = road.see((2, 20.0 + step, 24.6 + step), approaches=moved)
        if step == 30:
            # The other one stands in no lane of the new road.
            assert after.ids.tolist() == before.ids[:1].tolist()
            assert confirmed(after) == [0]
            assert after.velocity_mps[0, 0] == pytest.approx(10.0, abs=0.5)
    assert after.ids.tolist() == before.ids[:1].tolist()
    assert rear(after) == pytest.approx(99.0, abs=0.5)


def test_who_stands_unseen_till_the_road_is_laid_out_anew_must_prove_it_later() -> None:
    for seconds, believed in ((5.0, 1), (15.0, 0)):
        road = Road()
        for _ in range(round(seconds * 10)):
            road.see()
        moved = (Approach("NB", ROAD[0].axis_enu, 0.0, 2, 3.6),)
        for _ in range(20):
            tracks = road.see((1, 120.0, 124.6), approaches=moved)
        assert len(confirmed(tracks)) == believed


def test_who_stands_when_a_road_is_first_found_is_believed_at_once() -> None:
    road = Road()
    for _ in range(150):
        road.see(approaches=())
    for _ in range(10):
        tracks = road.see((1, 120.0, 124.6))
    assert len(confirmed(tracks)) == 1


def test_ids_are_never_used_twice() -> None:
    road = Road()
    ids: list[int] = []
    for _ in range(3):
        for step in range(20):
            tracks = road.see((1, 1.0 + step, 5.6 + step))
        ids += tracks.ids.tolist()
        for _ in range(20):
            road.see()
    assert len(ids) == len(set(ids)) == 3


def test_a_truck_that_enters_is_not_slow_while_its_rear_is_outside() -> None:
    """Its front moves; the edge of the view, where it seems to end, does not."""
    road = Road()
    speeds = []
    for step in range(24):
        tracks = road.see((1, -20.0 + 2.0 * step, -2.0 + 2.0 * step))
        speeds += [float(tracks.velocity_mps[i, 0]) for i in confirmed(tracks)]
    assert len(speeds) > 10
    assert min(speeds) > 12.0
    assert speeds[-1] == pytest.approx(20.0, abs=1.0)
    assert float(tracks.length_m[0]) == pytest.approx(18.0, abs=1.0)


def test_what_is_not_seen_stops_behind_the_one_ahead() -> None:
    road = Road()
    for step in range(120):
        seen: list[Seen] = [(1, 150.0, 154.6)]
        at = 20.0 + 1.2 * step
        if at < 138:  # then it is gone from the picture for the last second
            seen.append((1, at, at + 4.6))
        tracks = road.see(*seen)
        if len(tracks) == 2:
            assert tracks.enu[:, 0].min() < 149.6
            assert np.diff(np.sort(tracks.enu[:, 0]))[0] > 4.6
        if at > 146:
            break
