"""The paper's tracker: windows follow, hold what stops, drop what leaves; speeds in metres."""

from __future__ import annotations

import math

import numpy as np
import pytest

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose
from queuetail.tracking.meanshift import MAX_MISSED_FRAMES, MIN_AGE_FRAMES, MeanShiftTracker
from queuetail.types import (
    CameraPose,
    Detections,
    Image,
    Origin,
    Raster,
    Scene,
    Tracks,
    TrackState,
)
from queuetail.vision.view import WholeFrame

ORIGIN = Origin(36.11, -97.057)
LENS = intrinsics_from_hfov(640, 360, 90.0)
HEIGHT_M = 64.0  # 0.2 m/px
MAPPING = mapping_from_pose(
    CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, HEIGHT_M, 0.0, -90.0, 0.0, LENS), ORIGIN
)
Places = list[tuple[int, int]]
CAR = (24, 12)  # 4.8 m × 2.4 m
VIEW = WholeFrame(640)


def asphalt() -> Image:
    generator = np.random.default_rng(3)
    return np.clip(90 + generator.normal(0, 3, (360, 640, 3)), 0, 255).astype(np.uint8)


ROAD = asphalt()


def car() -> Image:
    image = np.zeros((CAR[1], CAR[0], 3), np.uint8)
    image[:] = (40, 40, 200)
    image[3:9, 5:10] = (60, 20, 20)
    return image


def scene(t_s: float, cars: list[tuple[int, int]]) -> Scene:
    image = ROAD.copy()
    for x, y in cars:
        patch = car()[: max(360 - y, 0), max(-x, 0) : max(640 - x, 0)]
        left = max(x, 0)
        image[y : y + patch.shape[0], left : left + patch.shape[1]] = patch
    return Scene(t_s, Raster(image, np.eye(3)), MAPPING)


class Drive:
    """A tracker with a clock: each step shows cars, and blobs for some of them."""

    def __init__(self, rate_hz: float = 25.0) -> None:
        self.tracker = MeanShiftTracker(VIEW.locate)
        self.frame = 0
        self.rate_hz = rate_hz

    def step(
        self, cars: list[tuple[int, int]], seen: list[tuple[int, int]] | None = None
    ) -> Tracks:
        return self.sees([(x, y, *CAR) for x, y in (cars if seen is None else seen)], cars)

    def sees(self, blobs: list[tuple[int, int, int, int]], cars: list[tuple[int, int]]) -> Tracks:
        now = scene(self.frame / self.rate_hz, cars)
        boxes = np.array(blobs, float).reshape(-1, 4)
        found = Detections(boxes, boxes[:, 2] * boxes[:, 3])
        self.frame += 1
        return self.tracker.update(VIEW.locate(found, now.raster, MAPPING), now)


def test_no_blobs_give_no_tracks() -> None:
    tracks = Drive().step([])
    assert len(tracks) == 0
    assert tracks.enu.shape == (0, 2)
    assert tracks.velocity_mps.shape == (0, 2)


def test_a_moving_car_keeps_its_id_and_gets_its_speed() -> None:
    drive = Drive()
    for k in range(40):
        tracks = drive.step([(40 + 3 * k, 100)])  # 3 px × 0.2 m × 25 Hz = 15 m/s east
    assert tracks.ids.tolist() == [1]
    assert tracks.states == (TrackState.CONFIRMED,)
    np.testing.assert_allclose(tracks.velocity_mps, [[15.0, 0.0]], atol=0.1)
    assert tracks.length_m[0] == pytest.approx(4.8, abs=0.01)
    x = 40 + 3 * 39 + CAR[0] / 2
    np.testing.assert_allclose(tracks.enu[0], [(x - 320) * 0.2, (180 - 106) * 0.2], atol=0.01)


def test_time_is_taken_from_timestamps_not_from_frames() -> None:
    slow = Drive(rate_hz=12.5)
    for k in range(30):
        tracks = slow.step([(40 + 3 * k, 100)])
    np.testing.assert_allclose(tracks.velocity_mps, [[7.5, 0.0]], atol=0.1)


def test_an_object_is_no_car_before_its_time() -> None:
    drive = Drive()
    states = [drive.step([(40 + 3 * k, 100)]).states[0] for k in range(20)]
    assert set(states[: MIN_AGE_FRAMES - 1]) == {TrackState.TENTATIVE}
    assert states[-1] is TrackState.CONFIRMED


def test_what_never_moves_is_no_car() -> None:
    drive = Drive()
    for _ in range(60):
        tracks = drive.step([(100, 100)])
    assert set(tracks.states) == {TrackState.TENTATIVE}


@pytest.mark.parametrize("size_factor", [0.05, 20.0])
def test_what_has_not_a_cars_size_is_no_car(size_factor: float) -> None:
    """The same blobs from a twentieth and from twenty times the height."""
    pose = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, HEIGHT_M * size_factor, 0.0, -90.0, 0.0, LENS)
    mapping = mapping_from_pose(pose, ORIGIN)
    tracker = MeanShiftTracker(VIEW.locate)
    for k in range(40):
        now = scene(k / 25, [(40 + 3 * k, 100)])
        now = Scene(now.t_s, now.raster, mapping)
        boxes = Detections(np.array([[40.0 + 3 * k, 100.0, *CAR]]), np.array([288.0]))
        tracks = tracker.update(VIEW.locate(boxes, now.raster, mapping), now)
    assert TrackState.CONFIRMED not in tracks.states


def test_mean_shift_follows_without_blobs_for_a_while() -> None:
    drive = Drive()
    for k in range(40):
        drive.step([(40 + 3 * k, 100)])
    for k in range(40, 40 + MAX_MISSED_FRAMES):
        tracks = drive.step([(40 + 3 * k, 100)], seen=[])  # the mask lost it, its colours did not
    assert tracks.ids.tolist() == [1]
    assert tracks.states == (TrackState.TENTATIVE,)
    assert abs(tracks.px[0, 0] - (40 + 3 * 47 + 12)) < 4
    np.testing.assert_allclose(tracks.velocity_mps[0], [15.0, 0.0], atol=2.5)
    tracks = drive.step([(40 + 3 * 48, 100)], seen=[])  # what drives does not fade from the mask
    assert len(tracks) == 0


def test_mean_shift_holds_what_stops() -> None:
    drive = Drive()
    for k in range(40):
        drive.step([(40 + 3 * k, 100)])
    for _ in range(45):  # stopped, and still in the mask
        drive.step([(157, 100)])
    for _ in range(200):  # 8 s at a standstill, faded from the mask
        tracks = drive.step([(157, 100)], seen=[])
    assert tracks.ids.tolist() == [1]
    assert tracks.states == (TrackState.COASTING,)
    assert abs(tracks.px[0, 0] - (157 + 12)) < 4
    assert math.hypot(*tracks.velocity_mps[0]) < 0.5


def test_a_fragment_neither_blocks_nor_shrinks_the_whole_car() -> None:
    drive = Drive()
    drive.sees([(52, 104, 6, 4)], [(40, 100)])  # first only its window is seen, then all of it
    for k in range(1, 30):
        tracks = drive.step([(40 + 3 * k, 100)])
    assert TrackState.CONFIRMED in tracks.states
    whole = tracks.states.index(TrackState.CONFIRMED)
    assert tracks.length_m[whole] == pytest.approx(4.8, abs=0.01)
    tracks = drive.sees([(40 + 3 * 30 + 2, 104, 6, 4)], [(40 + 3 * 30, 100)])
    assert len(tracks) == 1
    assert tracks.length_m[0] == pytest.approx(4.8, abs=0.01)


def test_a_box_cut_by_the_pictures_edge_tells_no_speed() -> None:
    """A car that drives in at 10 m/s: its visible part's centre moves at half of that."""
    drive = Drive()
    believed = []
    for k in range(40):
        right = 2 + 2 * k  # 2 px × 0.2 m × 25 Hz
        shown = min(right, CAR[0])
        tracks = drive.sees([(right - shown, 100, shown, CAR[1])], [(right - CAR[0], 100)])
        if tracks.states and tracks.states[0] is TrackState.CONFIRMED:
            believed.append(float(tracks.velocity_mps[0, 0]))
    assert len(believed) > 10
    assert min(believed) > 9.5


def test_what_leaves_the_picture_is_dropped() -> None:
    drive = Drive()
    sizes = [len(drive.step([(500 + 4 * k, 100)] if 500 + 4 * k < 640 else [])) for k in range(70)]
    assert max(sizes) == 1
    assert sizes[-1] == 0


def test_what_vanishes_is_dropped() -> None:
    drive = Drive()
    for k in range(40):
        drive.step([(40 + 3 * k, 100)])
    for _ in range(15):
        tracks = drive.step([])
    assert len(tracks) == 0


def test_two_cars_stay_two_and_ids_are_never_used_again() -> None:
    drive = Drive()
    for k in range(40):
        tracks = drive.step([(40 + 3 * k, 100), (40 + 5 * k, 160)])
    assert tracks.ids.tolist() == [1, 2]
    np.testing.assert_allclose(tracks.velocity_mps[:, 0], [15.0, 25.0], atol=0.5)
    for _ in range(15):
        drive.step([])
    assert drive.step([(300, 300)]).ids.tolist() == [3]


def test_a_blob_above_the_horizon_harms_nobody() -> None:
    level = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, HEIGHT_M, 0.0, 0.0, 0.0, LENS)
    mapping = mapping_from_pose(level, ORIGIN)
    tracker = MeanShiftTracker(VIEW.locate)
    for k in range(20):
        now = Scene(k / 25, scene(0, [(100 + 3 * k, 40), (100 + 3 * k, 300)]).raster, mapping)
        boxes = np.array([[100.0 + 3 * k, 40.0, *CAR], [100.0 + 3 * k, 300.0, *CAR]])
        found = Detections(boxes, np.full(2, 288.0))
        tracks = tracker.update(VIEW.locate(found, now.raster, mapping), now)
    assert np.isnan(tracks.enu[0]).all()
    assert tracks.states[0] is TrackState.TENTATIVE
    assert np.isfinite(tracks.enu[1]).all()
