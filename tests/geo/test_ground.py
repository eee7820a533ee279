"""Ground mappings: control points, horizon and covariance."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from poses import ORIGIN, lenses, pixel_grid, poses

from queuetail.geo.camera import intrinsics_from_hfov, rays
from queuetail.geo.ground import (
    apply_homography,
    covariance,
    enu_to_px,
    mapping_from_control_points,
    mapping_from_pose,
    px_to_enu,
)
from queuetail.types import CameraPose, Floats, Origin, PoseSigma

# A warning would reach the user's terminal in every frame.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

LENS = intrinsics_from_hfov(1280, 720, 84.0)
OBLIQUE = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, 110.0, 75.0, -55.0, 2.0, LENS)
SPREAD = np.array([[100.0, 700.0], [1200.0, 650.0], [1100.0, 90.0], [150.0, 60.0], [640.0, 400.0]])


def test_pixels_at_and_above_the_horizon_have_no_place() -> None:
    level = dataclasses.replace(OBLIQUE, pitch_deg=0.0, roll_deg=0.0)
    mapping = mapping_from_pose(level, ORIGIN)
    enu = px_to_enu(mapping, np.array([[640.0, 360.0], [640.0, 100.0], [640.0, 361.0]]))
    assert np.isnan(enu[:2]).all()
    assert np.isfinite(enu[2]).all()


@given(poses())
def test_the_horizon_is_where_rays_stop_falling(pose: CameraPose) -> None:
    px = np.array(pixel_grid(pose.intrinsics))
    up = rays(px, pose)[:, 2]
    clear = np.abs(up) > 1e-9
    placed = np.isfinite(px_to_enu(mapping_from_pose(pose, ORIGIN), px)).all(axis=1)
    np.testing.assert_array_equal(placed[clear], up[clear] < 0)


@settings(max_examples=60)
@given(poses(lenses(), pitch_deg=st.floats(-90.0, -20.0)))
def test_control_points_recover_the_mapping_of_a_known_pose(pose: CameraPose) -> None:
    px = np.array(pixel_grid(pose.intrinsics, 4))
    true = mapping_from_pose(pose, ORIGIN)
    enu = px_to_enu(true, px)
    near = np.linalg.norm(enu - enu[len(enu) // 2], axis=1) < 20 * pose.height_agl_m
    if near.sum() < 8:
        return
    lens = pose.intrinsics if pose.intrinsics.distortion else None
    fitted = mapping_from_control_points(px[near], enu[near], ORIGIN, lens)
    scale = pose.height_agl_m
    np.testing.assert_allclose(px_to_enu(fitted, px[near]), enu[near], atol=1e-5 * scale)
    np.testing.assert_allclose(enu_to_px(fitted, enu[near]), px[near], atol=1e-3)
    assert fitted.sigma_m < 1e-4 * scale


def test_four_exact_control_points_are_enough_and_extrapolate() -> None:
    true = mapping_from_pose(OBLIQUE, ORIGIN)
    fitted = mapping_from_control_points(SPREAD[:4], px_to_enu(true, SPREAD[:4]), None)
    np.testing.assert_allclose(px_to_enu(fitted, SPREAD), px_to_enu(true, SPREAD), atol=1e-6)
    assert fitted.origin is None
    assert fitted.pose is None


def test_the_horizon_of_control_points_is_respected() -> None:
    low = dataclasses.replace(OBLIQUE, pitch_deg=-10.0, roll_deg=0.0)
    true = mapping_from_pose(low, ORIGIN)
    px = np.array([[100.0, 700.0], [1200.0, 700.0], [1100.0, 450.0], [150.0, 430.0]])
    fitted = mapping_from_control_points(px, px_to_enu(true, px), None)
    assert np.isnan(px_to_enu(fitted, np.array([[640.0, 5.0]]))).all()


def test_the_residual_of_control_points_is_their_sigma() -> None:
    true = mapping_from_pose(OBLIQUE, ORIGIN)
    generator = np.random.default_rng(1)
    px = np.array(pixel_grid(LENS, 6))
    sigmas = [
        mapping_from_control_points(
            px, px_to_enu(true, px) + generator.normal(0, 0.5, px.shape), ORIGIN
        ).sigma_m
        for _ in range(10)
    ]
    assert np.mean(sigmas) == pytest.approx(0.5, rel=0.15)


LINE = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0], [4.0, 4.0]])
SAME = np.zeros((5, 2))
CROSSED = np.array([[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]])


@pytest.mark.parametrize(
    ("px", "enu", "says"),
    [
        (SPREAD[:3], SPREAD[:3], "3 control points given, at least 4 are needed"),
        (SPREAD[:0], SPREAD[:0], "0 control points"),
        (LINE * 100, SPREAD, "nearly on a line"),
        (SPREAD, LINE, "nearly on a line"),
        (SAME, SPREAD, "same place"),
        (SPREAD, SAME, "same place"),
        (LINE * 100 + [[0, 0], [0, 0], [0, 0.3], [0, 0], [0, 0]], SPREAD, "nearly on a line"),
        (SPREAD[[0, 1, 2, 0]], CROSSED, "nearly on a line|one plane"),
        (SPREAD[:4], CROSSED, "one plane in front of the camera"),
    ],
)
def test_degenerate_control_points_are_refused(px: Floats, enu: Floats, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        mapping_from_control_points(px, enu, None)


def test_three_of_four_control_points_on_a_line_are_refused() -> None:
    """Four points with three on a line leave the homography undetermined."""
    px = np.array([[0.0, 0.0], [100.0, 100.0], [200.0, 200.0], [500.0, 20.0]])
    with pytest.raises(ValueError, match="nearly on a line"):
        mapping_from_control_points(px, px * 0.1, None)


def test_uncertainty_grows_with_distance() -> None:
    mapping = mapping_from_pose(dataclasses.replace(OBLIQUE, roll_deg=0.0), ORIGIN)
    down_the_picture = np.column_stack([np.full(8, 640.0), np.linspace(10, 710, 8)])
    largest = np.linalg.eigvalsh(covariance(mapping, down_the_picture))[:, -1]
    assert (np.diff(largest) < 0).all()  # nearer towards the bottom


def test_uncertainty_is_symmetric_and_nan_above_the_horizon() -> None:
    mapping = mapping_from_pose(dataclasses.replace(OBLIQUE, pitch_deg=-5.0), ORIGIN)
    both = covariance(mapping, np.array([[640.0, 700.0], [640.0, 5.0]]))
    np.testing.assert_allclose(both[0], both[0].T)
    assert np.isnan(both[1]).all()
    assert covariance(mapping, np.empty((0, 2))).shape == (0, 2, 2)


@pytest.mark.parametrize("pitch_deg", [-90.0, -60.0, -35.0])
@pytest.mark.parametrize("px", [(640.0, 360.0), (1200.0, 600.0), (200.0, 500.0)])
def test_uncertainty_agrees_with_monte_carlo(pitch_deg: float, px: tuple[float, float]) -> None:
    pose = dataclasses.replace(OBLIQUE, pitch_deg=pitch_deg)
    sigma = PoseSigma()
    mapping = mapping_from_pose(pose, ORIGIN, sigma)
    stated = covariance(mapping, np.array([px]))[0]
    generator = np.random.default_rng(7)
    drawn = []
    for _ in range(3000):
        g = generator.normal(size=8)
        moved = dataclasses.replace(
            pose,
            height_agl_m=pose.height_agl_m + sigma.height_m * g[0],
            yaw_deg=pose.yaw_deg + sigma.yaw_deg * g[1],
            pitch_deg=pose.pitch_deg + sigma.pitch_deg * g[2],
            roll_deg=pose.roll_deg + sigma.roll_deg * g[3],
        )
        at = px_to_enu(
            mapping_from_pose(moved, ORIGIN), np.array([px]) + sigma.pixel_px * g[None, 4:6]
        )
        drawn.append(at[0] + sigma.horizontal_m * g[6:8])
    sampled = np.cov(np.array(drawn).T)
    ratio = np.sqrt(np.linalg.eigvalsh(stated) / np.linalg.eigvalsh(sampled))
    np.testing.assert_allclose(ratio, 1.0, atol=0.1)


def test_a_homography_maps_single_points_and_lists() -> None:
    H = np.diag([2.0, 3.0, 1.0])
    np.testing.assert_allclose(apply_homography(H, np.array([1.0, 1.0])), [2.0, 3.0])
    np.testing.assert_allclose(apply_homography(H, np.ones((2, 4, 2)))[..., 1], 3.0)
    assert apply_homography(H, np.empty((0, 2))).shape == (0, 2)


def test_the_origin_only_moves_the_metres() -> None:
    elsewhere = Origin(36.12, -97.06)
    a, b = (px_to_enu(mapping_from_pose(OBLIQUE, o), SPREAD) for o in (ORIGIN, elsewhere))
    gap = a - b
    np.testing.assert_allclose(gap, np.broadcast_to(gap[0], gap.shape), atol=1e-9)


def test_a_control_point_outside_the_lens_is_refused() -> None:
    lens = dataclasses.replace(LENS, distortion=(-0.5,))
    with pytest.raises(ValueError, match="the lens, by its distortion, sees nothing"):
        mapping_from_control_points(np.vstack([SPREAD, [[0.0, 0.0]]]), np.ones((6, 2)), None, lens)
