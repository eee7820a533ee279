"""The pinhole camera: exact projection, rays, distortion; and the bundled flight as a witness."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from poses import ORIGIN, lenses, pixel_grid, poses

from queuetail.config import CameraOverride
from queuetail.geo.camera import (
    camera_matrix,
    distort,
    distort_px,
    intrinsics_from_hfov,
    project,
    rays,
    rotation_enu_camera,
    undistort,
    undistort_px,
)
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import enu_to_px, mapping_from_pose, px_to_enu
from queuetail.mapping import camera_pose
from queuetail.telemetry import read_telemetry
from queuetail.types import CameraPose, GroundMapping, Intrinsics, Origin

# A warning would reach the user's terminal in every frame.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

angles = st.floats(-360.0, 360.0)


@given(angles, angles, angles)
def test_the_rotation_is_a_rotation(yaw: float, pitch: float, roll: float) -> None:
    R = rotation_enu_camera(yaw, pitch, roll)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("angles_deg", "right", "down", "forward"),
    [
        ((0, 0, 0), (1, 0, 0), (0, 0, -1), (0, 1, 0)),  # level, to the north
        ((90, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0)),  # yaw is clockwise: east
        ((0, -90, 0), (1, 0, 0), (0, -1, 0), (0, 0, -1)),  # nadir: the picture's top is north
        ((0, 0, 90), (0, 0, -1), (-1, 0, 0), (0, 1, 0)),  # clockwise: its right side dips
    ],
)
def test_axes_point_where_a_pilot_expects(
    angles_deg: tuple[float, float, float],
    right: tuple[float, ...],
    down: tuple[float, ...],
    forward: tuple[float, ...],
) -> None:
    expected = np.column_stack([right, down, forward])
    np.testing.assert_allclose(rotation_enu_camera(*angles_deg), expected, atol=1e-12)


def test_a_nadir_camera_by_hand() -> None:
    """100 m up, 90° wide, 1000 px: one pixel is 0.2 m; yaw 90 puts east at the top."""
    lens = intrinsics_from_hfov(1000, 800, 90.0)
    pose = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, 100.0, 90.0, -90.0, 0.0, lens)
    px = project(np.array([[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [0.0, 20.0, 0.0]]), pose)
    np.testing.assert_allclose(px, [[500, 400], [500, 300], [400, 400]], atol=1e-9)


@pytest.mark.parametrize("hfov_deg", [0.0, -5.0, 180.0, math.nan])
def test_an_impossible_field_of_view_is_refused(hfov_deg: float) -> None:
    with pytest.raises(ValueError, match="between 0° and 180°"):
        intrinsics_from_hfov(1280, 720, hfov_deg)


def test_the_field_of_view_spans_the_picture() -> None:
    lens = intrinsics_from_hfov(1280, 720, 84.0)
    edges = np.array([[0.0, 360.0], [1280.0, 360.0]])
    pose = CameraPose(0.0, 0.0, 10.0, 0.0, 0.0, 0.0, lens)
    a, b = rays(edges, pose)
    assert math.degrees(math.acos(a @ b)) == pytest.approx(84.0)
    np.testing.assert_allclose(
        camera_matrix(lens) @ [0, 0, 1], [640, 360, 1]
    )  # the axis meets the centre


@settings(max_examples=100)
@given(poses())
def test_pixel_to_ray_to_ground_and_back_holds_to_a_millionth_of_a_pixel(pose: CameraPose) -> None:
    px = np.array(pixel_grid(pose.intrinsics))
    directions = rays(px, pose)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    below = directions[:, 2] < -1e-2  # grazing rays meet the ground beyond what doubles resolve
    if not below.any():
        return
    reach = pose.height_agl_m / -directions[below, 2]
    ground = directions[below] * reach[:, None] + [0, 0, pose.height_agl_m]
    assert np.abs(ground[:, 2]).max() < 1e-6
    assert np.abs(project(ground, pose) - px[below]).max() < 1e-6


@settings(max_examples=100)
@given(poses())
def test_the_plane_mapping_round_trips_to_a_millionth_of_a_pixel(pose: CameraPose) -> None:
    mapping = mapping_from_pose(pose, ORIGIN)
    px = np.array(pixel_grid(pose.intrinsics))
    below = rays(px, pose)[:, 2] < -1e-2
    if not below.any():
        return
    enu = px_to_enu(mapping, px[below])
    assert np.abs(enu_to_px(mapping, enu) - px[below]).max() < 1e-6


@settings(max_examples=100)
@given(poses(lenses(distorted=False)), st.floats(-50, 50), st.floats(-50, 50))
def test_the_plane_mapping_is_the_exact_projection(
    pose: CameraPose, east: float, north: float
) -> None:
    below_camera = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), ORIGIN)
    mapping = mapping_from_pose(pose, ORIGIN)
    by_plane = enu_to_px(mapping, below_camera + np.array([[east, north]]))
    exact = project(np.array([[east, north, 0.0]]), pose)
    near = np.abs(np.nan_to_num(exact, nan=np.inf)).max(axis=1) < 1e5
    np.testing.assert_allclose(by_plane[near], exact[near], atol=1e-5)


def test_what_lies_right_beside_the_camera_gives_no_warning() -> None:
    level = CameraPose(36.0, -97.0, 5.0, 0.0, 0.0, 0.0, intrinsics_from_hfov(640, 360, 20.0))
    px = project(np.array([[0.0, 1.4e-305, 0.0]]), level)
    assert not (np.abs(px) < 1e6).all()


@given(poses(pitch_deg=st.floats(-89.0, 0.0)))
def test_what_lies_behind_the_camera_has_no_pixel(pose: CameraPose) -> None:
    forward = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)[:, 2]
    behind = np.array([0, 0, pose.height_agl_m]) - 10 * forward
    assert np.isnan(project(behind[None], pose)).all()


@settings(max_examples=100)
@given(lenses(distorted=True))
def test_distortion_is_undone_over_the_whole_picture(lens: Intrinsics) -> None:
    px = np.array(pixel_grid(lens, 9))
    ideal = undistort_px(px, lens)
    assert np.isfinite(ideal).all()
    np.testing.assert_allclose(distort_px(ideal, lens), px, atol=1e-8)


@pytest.mark.parametrize("k1", [-0.3, -0.2, 0.3])
def test_distortion_is_undone_up_to_where_the_lens_folds(k1: float) -> None:
    fold = (1 / (3 * -k1)) ** 0.5 if k1 < 0 else 1.5
    xy = np.linspace(0, 0.98 * fold, 50)[:, None] * [[0.8, -0.6]]
    np.testing.assert_allclose(undistort(distort(xy, (k1,)), (k1,)), xy, atol=1e-9)


def test_what_is_too_far_aside_for_the_lens_does_not_fold_into_the_picture() -> None:
    """At 60° aside a barrel of k1 = -0.28 would put a point back near the centre."""
    lens = intrinsics_from_hfov(1280, 720, 80.0, (-0.28,))
    pose = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, 100.0, 0.0, -90.0, 0.0, lens)
    ground = np.array([[90.0, 0.0, 0.0], [173.0, 0.0, 0.0]])
    px = project(ground, pose)
    assert np.isfinite(px[0]).all()
    assert np.isnan(px[1]).all()
    assert np.isnan(enu_to_px(mapping_from_pose(pose, ORIGIN), ground[:, :2] + 1e4)).all()


def test_distortion_follows_the_order_that_opencv_uses() -> None:
    """k1, k2, p1, p2, k3 by hand at (0.5, 0.25): r² = 0.3125."""
    got = distort(np.array([[0.5, 0.25]]), (0.1, 0.01, 0.001, 0.002, 0.005))[0]
    radial = 1 + 0.1 * 0.3125 + 0.01 * 0.3125**2 + 0.005 * 0.3125**3
    x = 0.5 * radial + 2 * 0.001 * 0.125 + 0.002 * (0.3125 + 2 * 0.25)
    y = 0.25 * radial + 0.001 * (0.3125 + 2 * 0.0625) + 2 * 0.002 * 0.125
    np.testing.assert_allclose(got, [x, y], rtol=1e-14)


def test_a_lens_that_does_not_invert_gives_nan_not_a_wrong_place() -> None:
    """Strong barrel folds the picture over: nothing is seen beyond 0.38 of a radian or so."""
    coefficients = (-1.0,)
    xy = np.array([[0.1, 0.0], [0.9, 0.0], [5.0, 5.0], [np.nan, 0.0]])
    got = undistort(xy, coefficients)
    assert np.isfinite(got[0]).all()
    assert np.isnan(got[1:]).all()


def _vehicles(path: Path) -> dict[float, list[dict[str, str]]]:
    by_time: dict[float, list[dict[str, str]]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            by_time.setdefault(float(row["t_s"]), []).append(row)
    return by_time


def _lowered(mapping: GroundMapping, plane_m: float) -> GroundMapping:
    assert mapping.pose is not None
    assert mapping.origin is not None
    height = mapping.pose.height_agl_m - plane_m
    return mapping_from_pose(dataclasses.replace(mapping.pose, height_agl_m=height), mapping.origin)


def _farthest(flight: Path, plane_m: float) -> tuple[int, float, float]:
    """Return rows of vehicles.csv, and how far pixel and place lie apart at most: m and px.

    The flight's own telemetry at the row's time gives the camera; the plane is `plane_m` above the
    road.
    """
    log = read_telemetry(flight / "telemetry.csv")
    first = log.samples[0]
    assert first.lat_deg is not None
    assert first.lon_deg is not None
    origin = Origin(first.lat_deg, first.lon_deg)
    metres, pixels, rows_seen = 0.0, 0.0, 0
    for t_s, rows in _vehicles(flight / "vehicles.csv").items():
        pose = camera_pose(log.at(t_s), 1280, 720, CameraOverride())
        assert isinstance(pose, CameraPose), f"no pose at {t_s} s"
        mapping = _lowered(mapping_from_pose(pose, origin), plane_m)
        lat_lon = np.array([[float(r["lat"]), float(r["lon"])] for r in rows])
        px = np.array([[float(r["u_px"]), float(r["v_px"])] for r in rows])
        enu = enu_from_geodetic(lat_lon[:, 0], lat_lon[:, 1], origin)
        metres = max(metres, np.linalg.norm(px_to_enu(mapping, px) - enu, axis=1).max())
        pixels = max(pixels, np.linalg.norm(enu_to_px(mapping, enu) - px, axis=1).max())
        rows_seen += len(rows)
    print(f"{rows_seen} rows at {plane_m} m: {metres:.3f} m, {pixels:.3f} px")
    return rows_seen, metres, pixels


def test_the_bundled_flights_vehicles_lie_where_the_camera_model_says(flagger: Path) -> None:
    """Within what the log's rounding and its ten samples a second leave."""
    rows_seen, metres, pixels = _farthest(flagger, 0.0)
    assert rows_seen > 5000
    assert metres <= 0.05
    assert pixels <= 0.2


def test_another_flights_pixels_belong_to_points_above_its_road(shared: Path) -> None:
    """About half a metre (0.506 m fits best), so that on the road plane itself a pixel leads up to
    0.7 m beyond the vehicle and a vehicle's place projects up to 2.6 px below its pixel.
    """
    flight = shared / "flights" / "flagger"
    rows_seen, metres, pixels = _farthest(flight, 0.0)
    assert rows_seen > 5000
    assert 0.5 < metres <= 1.0
    assert 2.0 < pixels <= 3.0
    assert _farthest(flight, 0.506)[2] <= 0.5
