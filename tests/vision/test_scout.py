"""The scout finds the bundled flight's road from its vehicles, and nothing where nothing moves."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest

from queuetail.config import Site, read_site
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import enu_to_px, mapping_from_pose
from queuetail.mapping import camera_pose, site_origin
from queuetail.telemetry import read_telemetry
from queuetail.traffic.carriageways import discover
from queuetail.traffic.road import locate
from queuetail.types import Approach, CameraPose, GroundMapping, Image, Origin, TrackState
from queuetail.video import VideoFile
from queuetail.vision.foot import camera_above_ground
from queuetail.vision.scout import RoadScout

ORIGIN = Origin(48.0, 11.0)
SIZE = (640, 360)


def hover(pitch_deg: float = -60.0, height_m: float = 80.0) -> GroundMapping:
    lens = intrinsics_from_hfov(*SIZE, 70.0)
    return mapping_from_pose(CameraPose(48.0, 11.0, height_m, 30.0, pitch_deg, 0.0, lens), ORIGIN)


def street(mapping: GroundMapping, places: list[tuple[float, float]], noise: Image) -> Image:
    """A picture of textured ground with a bright 4.5 × 1.8 m plate at each place."""
    picture = noise.copy()
    for east, north in places:
        x, y = np.array([-2.25, 2.25, 2.25, -2.25]), np.array([-0.9, -0.9, 0.9, 0.9])
        corners = enu_to_px(mapping, np.column_stack([east + x, north + y]))
        cv2.fillConvexPoly(picture, np.round(corners * 8).astype(np.int32), 230, cv2.LINE_AA, 3)
    return picture


@pytest.fixture(scope="module")
def ground() -> Image:
    rng = np.random.default_rng(0)
    coarse = rng.integers(60, 120, (45, 80), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC), np.uint8)


def test_finds_the_bundled_road(flagger: Path) -> None:
    site = read_site(flagger / "site.toml")
    origin = site_origin(site)
    assert origin is not None
    with (flagger / "road.csv").open() as file:
        rows = list(csv.DictReader(file))
    lat, lon = (np.array([float(r[k]) for r in rows]) for k in ("lat", "lon"))
    true = Approach("true", enu_from_geodetic(lat, lon, origin))
    scout, log = RoadScout(), read_telemetry(flagger / "telemetry.csv")
    H_first = None
    with VideoFile(flagger / "flight.mp4") as video:
        for frame in video.frames():
            if frame.t_s > 16.0:
                break
            pose = camera_pose(log.at(frame.t_s), 1280, 720, Site().camera)
            assert isinstance(pose, CameraPose)
            mapping = mapping_from_pose(pose, origin)
            H_first = mapping.H_px_enu if H_first is None else H_first
            scout.update(frame.luma, mapping, H_first @ mapping.H_enu_px, frame.t_s)
    (found,) = discover(scout.trajectories)
    _, offset, course = locate(true, found.axis_enu)
    assert found.name == "SB"
    assert found.lanes == 2
    assert np.median(np.abs(offset)) < 0.7
    assert ((np.diff(found.axis_enu, axis=0) * course[1:]).sum(axis=1) > 0).all()
    confirmed = [s is TrackState.CONFIRMED for s in scout.tracks(16.0).states]
    assert sum(confirmed) >= 2
    assert (scout.tracks(16.0).sigma_m > 0).all()


def test_follows_plates_and_leaves_the_ground_alone(ground: Image) -> None:
    mapping, scout = hover(), RoadScout()
    east, north = 20.0, 30.0
    for i in range(80):
        t = i / 10
        places = [(east - 30 + 10 * t, north), (east + 30 - 8 * t, north + 6), (east, north - 9)]
        scout.update(street(mapping, places, ground), mapping, np.eye(3), t)
    assert len(scout.trajectories) == 2
    ends = sorted(t.enu[-1, 0] - t.enu[0, 0] for t in scout.trajectories)
    assert ends[0] < -30
    assert ends[1] > 30
    tracks = scout.tracks(8.0)
    speeds = sorted(np.linalg.norm(tracks.velocity_mps, axis=1))
    assert speeds[-2:] == pytest.approx([8.0, 10.0], abs=0.5)


def test_a_car_that_leaves_leaves_no_ghost(ground: Image) -> None:
    mapping, scout = hover(), RoadScout()
    for i in range(60):
        t = i / 8
        place = (20.0 + max(t - 1.0, 0.0) * 8.0, 30.0)
        scout.update(street(mapping, [place], ground), mapping, np.eye(3), t)
    tracks = scout.tracks(7.5)
    assert all(np.linalg.norm(e - [20.0, 30.0]) > 5 for e in tracks.enu)


def test_brightness_steps_and_other_scenes_move_nothing(ground: Image) -> None:
    mapping, scout = hover(), RoadScout()
    for i in range(40):
        picture = ground if i < 15 else (ground * 0.8).astype(np.uint8)
        picture = picture if i < 30 else 255 - picture
        scout.update(np.asarray(picture, np.uint8), mapping, np.eye(3), i / 8)
    assert scout.trajectories == ()
    assert len(scout.tracks(5.0)) == 0


def test_the_canvas_follows_a_drone_that_flies_on(ground: Image) -> None:
    wide = cv2.resize(ground, (1600, 360))
    mapping = hover(-89.9)
    scout = RoadScout()
    for i in range(100):
        shift = 6 * i
        H = np.array([[1.0, 0.0, shift], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        scout.update(np.ascontiguousarray(wide[:, shift : shift + 640]), mapping, H, i / 8)
    assert scout.trajectories == ()


@pytest.mark.parametrize("pitch_deg", [-25.0, -60.0])
def test_camera_foot_from_the_plane_mapping_alone(pitch_deg: float) -> None:
    mapping = hover(pitch_deg)
    lens = mapping.pose.intrinsics if mapping.pose else None
    bare = GroundMapping(mapping.H_enu_px, mapping.H_px_enu, ORIGIN, intrinsics=lens)
    foot, height_m = camera_above_ground(bare)
    assert foot == pytest.approx([0.0, 0.0], abs=0.01)
    assert height_m == pytest.approx(80.0, abs=0.01)
