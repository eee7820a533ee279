"""The pictures: vehicles are drawn where the truth says, the ground moves as the camera does."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from queuetail.config import parse_settings
from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.bodies import BODIES, BODY_INDEX
from queuetail.sim.flight import TruePath
from queuetail.sim.log import flight_log
from queuetail.sim.occluder import Occluder
from queuetail.sim.render import Renderer
from queuetail.sim.scenario import Road, Scenario
from queuetail.sim.simulate import frame_ticks, simulate
from queuetail.sim.traffic import Traffic

PLAIN = {"noise": 0.0, "shadow": 0.0, "haze": 0.0, "width_px": 640, "height_px": 360}


def one_vehicle(station_m: float, offset_m: float, kind: str = "suv") -> Traffic:
    """Return traffic of a single vehicle that stands still."""
    ticks = np.array([-1.0, 0.0, 1.0, 2.0])
    still = np.full((4, 1), 0.0)
    return Traffic(
        tick_s=ticks,
        ids=("e.1",),
        body=np.array([BODY_INDEX[kind]]),
        paint=np.array([0]),
        opposite=np.array([False]),
        parked=np.array([False]),
        front_m=still + station_m,
        offset_m=still + offset_m,
        speed_mps=still,
    )


def nobody(traffic: Traffic) -> Traffic:
    return dataclasses.replace(traffic, front_m=np.full_like(traffic.front_m, np.nan))


@pytest.mark.parametrize(
    ("pitch_deg", "bend_radius_m"), [(-90.0, 0.0), (-55.0, -200.0), (-30.0, 150.0)]
)
def test_a_vehicle_covers_exactly_its_projected_corners(
    pitch_deg: float, bend_radius_m: float
) -> None:
    raw = {
        "road": {"bend_radius_m": bend_radius_m, "course_deg": 40.0, "grade_percent": 3.0},
        "flight": {"pitch_deg": pitch_deg, "height_m": 50.0, "heading_to_road_deg": -70.0},
        "picture": PLAIN,
    }
    scenario = parse_settings(Scenario, raw, "one")
    traffic = one_vehicle(VIEW_STATION_M + 12.0, -2.0)
    path = TruePath(scenario, 1)
    drawn = Renderer(scenario, traffic, path, 1).frame_yuv(0, 0.5)[:360].astype(int)
    empty = Renderer(scenario, nobody(traffic), path, 1).frame_yuv(0, 0.5)[:360].astype(int)
    rows, columns = np.nonzero(np.abs(drawn - empty) > 4)
    expected = _corners_by_hand(scenario, path, VIEW_STATION_M + 12.0, -2.0)
    assert abs(columns.min() - expected[:, 0].min()) < 1.6
    assert abs(columns.max() + 1 - expected[:, 0].max()) < 1.6
    assert abs(rows.min() - expected[:, 1].min()) < 1.6
    assert abs(rows.max() + 1 - expected[:, 1].max()) < 1.6


def _corners_by_hand(
    scenario: Scenario, path: TruePath, front_m: float, offset_m: float
) -> np.ndarray:
    """Project the outer corners of the body's shell and roof with a rotation written out here."""
    body = BODIES[BODY_INDEX["suv"]]
    road, view = scenario.road, path.view(0.5)
    pose, camera = view.pose, view.camera_enu
    course = math.radians(road.course_deg)
    along = front_m - body.length_m / 2 - VIEW_STATION_M
    x, y, turn = along, offset_m, 0.0
    if road.bend_radius_m:
        r = road.bend_radius_m
        turn = along / r
        x, y = (r - offset_m) * math.sin(turn), r - (r - offset_m) * math.cos(turn)
    found = []
    for part in body.parts[1:]:
        for cx, cy, cz in part.corners():
            dx, dy = cx - body.length_m / 2, cy
            px = x + dx * math.cos(turn) - dy * math.sin(turn)  # along the course
            py = y + dx * math.sin(turn) + dy * math.cos(turn)  # to its left
            east = px * math.sin(course) - py * math.cos(course)
            north = px * math.cos(course) + py * math.sin(course)
            up = cz + road.grade_percent / 100 * px
            e, n, h = east - camera[0], north - camera[1], up - camera[2]
            yaw, pitch = math.radians(pose.yaw_deg), math.radians(pose.pitch_deg)
            ahead, right = (
                e * math.sin(yaw) + n * math.cos(yaw),
                e * math.cos(yaw) - n * math.sin(yaw),
            )
            depth = ahead * math.cos(pitch) + h * math.sin(pitch)
            down = ahead * math.sin(pitch) - h * math.cos(pitch)
            roll = math.radians(pose.roll_deg)
            sx = right * math.cos(roll) + down * math.sin(roll)
            sy = down * math.cos(roll) - right * math.sin(roll)
            f = 320.0 / math.tan(math.radians(scenario.flight.hfov_deg / 2))
            found.append((320.0 + f * sx / depth, 180.0 + f * sy / depth))
    return np.array(found)


def test_the_ground_moves_as_the_camera_says() -> None:
    """Register two frames of an empty road by optical flow and compare with exact projection."""
    raw = {
        "flight": {"gust_m": 1.0, "gust_deg": 1.0, "jitter_deg": 0.3},
        "picture": PLAIN | {"noise": 2.0},
    }
    scenario = parse_settings(Scenario, raw, "shaken")
    path = TruePath(scenario, 2)
    renderer = Renderer(scenario, nobody(one_vehicle(900.0, -2.0)), path, 2)
    times = (3.0, 9.0)
    a, b = (renderer.frame_yuv(i, t)[:360] for i, t in enumerate(times))
    points = cv2.goodFeaturesToTrack(a, 300, 0.01, 8)
    moved, status, _ = cv2.calcOpticalFlowPyrLK(a, b, points, None, winSize=(21, 21))
    old, new = (p.reshape(-1, 2).astype(float) + 0.5 for p in (points, moved))
    views = [path.view(t) for t in times]
    H = views[1].ground_homography() @ np.linalg.inv(views[0].ground_homography())
    exact = np.column_stack([old, np.ones(len(old))]) @ H.T
    exact = exact[:, :2] / exact[:, 2:]
    kept = status.ravel() == 1
    error = np.linalg.norm(new - exact, axis=1)[kept]
    assert kept.sum() > 150
    assert np.linalg.norm(exact - old, axis=1).max() > 2.0
    assert np.median(error) < 0.15


@pytest.mark.parametrize("radius_m", [0.0, 80.0, -250.0])
def test_axis_locates_what_it_places(radius_m: float) -> None:
    axis = Axis.of(Road(bend_radius_m=radius_m, course_deg=12.0))
    station, offset = np.meshgrid(np.linspace(100, 2100, 81), [-14.0, -3.0, 0.0, 20.0])
    found_station, found_offset = axis.locate(axis.enu(station.ravel(), offset.ravel()))
    near = np.abs(station.ravel() - VIEW_STATION_M) < 700
    assert np.abs(found_station - station.ravel())[near].max() < 1e-6
    assert np.abs(found_offset - offset.ravel())[near].max() < 1e-6
    step = axis.enu(np.array([900.0, 900.001]), np.zeros(2))
    course = math.degrees(math.atan2(*(step[1] - step[0])))
    assert course == pytest.approx(12.0, abs=0.01)


def test_frame_times_are_uneven_with_drops_only_when_asked() -> None:
    even = frame_ticks(Scenario(), 1)
    assert len(even) == 75 * 30
    assert set(np.diff(even)) == {3000}
    raw = {"picture": {"interval_jitter": 0.3, "dropped_share": 0.2}}
    uneven = frame_ticks(parse_settings(Scenario, raw, "vfr"), 1)
    assert uneven[0] == 0
    assert (np.diff(uneven) > 0).all()
    assert 0.7 < len(uneven) / len(even) < 0.9
    assert len(set(np.diff(uneven))) > 100


def test_log_holds_rates_biases_and_gaps() -> None:
    told = {"position_rate_hz": 2, "attitude_rate_hz": 5, "heading_bias_deg": 2.0}
    raw = {"telemetry": told | {"gaps": [[10, 13]], "height_error_m": -1.5}}
    scenario = parse_settings(Scenario, raw, "log")
    path = TruePath(scenario, 1)
    samples = flight_log(scenario, path, 1)
    times = np.array([s.t_s for s in samples])
    assert not ((times >= 10) & (times < 13)).any()
    assert sum(s.lat_deg is not None and s.t_s < 10 for s in samples) == 20
    assert sum(s.heading_deg is not None and s.t_s < 10 for s in samples) == 50
    for sample in samples[:40]:
        pose = path.view(sample.t_s).pose
        if sample.heading_deg is not None:
            assert (sample.heading_deg - pose.yaw_deg) % 360 == pytest.approx(2.0)
        if sample.height_agl_m is not None:
            assert sample.height_agl_m - pose.height_agl_m == pytest.approx(-1.5)


def test_a_bridge_hides_what_is_under_it() -> None:
    raw = {"picture": PLAIN | {"occluder": "bridge"}, "flight": {"pitch_deg": -90.0}}
    scenario = parse_settings(Scenario, raw, "bridge")
    bridge = Occluder.of(scenario)
    assert bridge is not None
    view = TruePath(scenario, 1).view(0.0)
    axis = Axis.of(scenario.road)
    station = np.array([VIEW_STATION_M, VIEW_STATION_M + 30])
    px = view.ground_px(axis.enu(station, np.full(2, -2.0)))
    assert bridge.hides(view, px).tolist() == [True, False]


def test_video_has_the_truth_times_and_klv(tmp_path: Path) -> None:
    pytest.importorskip("libsumo", reason="the extra `sim` is not installed")
    raw = {
        "scenario": {"duration_s": 2.0},
        "picture": PLAIN | {"interval_jitter": 0.3, "codec": "h265", "tree_shadows": 3},
        "opposite": {"lanes": 1, "demand_vph": 900},
        "telemetry": {"klv": True},
    }
    simulate(parse_settings(Scenario, raw, "tiny"), tmp_path, seed=3)
    lines = (tmp_path / "truth.csv").read_text(encoding="utf-8").splitlines()[1:]
    truth = [float(line.split(",")[0]) for line in lines]
    with av.open(str(tmp_path / "flight.mp4")) as video:
        shown = [float(frame.time) for frame in video.decode(video=0)]
    assert shown == pytest.approx(truth, abs=6e-4)
    with av.open(str(tmp_path / "flight.ts")) as stream:
        packets = [bytes(p) for p in stream.demux() if p.stream.type == "data" and p.size]
    assert len(packets) >= 15
    assert all(p.startswith(bytes.fromhex("060e2b34020b0101")) for p in packets)
