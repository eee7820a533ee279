"""The paper's equations, in the readings taken, against exact projection."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from poses import ORIGIN, lenses, pixel_grid, poses

from queuetail.geo.camera import rays
from queuetail.geo.earth import EARTH_RADIUS_M, enu_from_geodetic
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.geo.paper import flat_earth_geodetic, ground_offset_m
from queuetail.types import CameraPose, Origin
from queuetail.vision.view import paper_px_to_enu

# A warning would reach the user's terminal in every frame.
pytestmark = pytest.mark.filterwarnings("error::RuntimeWarning")

level_poses = poses(
    lenses(distorted=False), roll_deg=st.just(0.0), pitch_deg=st.floats(-90.0, 20.0)
)


@given(level_poses)
def test_the_papers_equations_are_exact_for_a_camera_without_roll(pose: CameraPose) -> None:
    """At any pitch, nadir among them, and up to one degree from the horizon."""
    px = np.array(pixel_grid(pose.intrinsics))
    at_camera = Origin(pose.lat_deg, pose.lon_deg)
    exact = px_to_enu(mapping_from_pose(pose, at_camera), px)
    got = ground_offset_m(px, pose)
    near = np.linalg.norm(exact, axis=1) < 57 * pose.height_agl_m
    np.testing.assert_allclose(got[near], exact[near], rtol=1e-8, atol=1e-7)


@given(level_poses)
def test_pixels_above_the_horizon_have_no_place(pose: CameraPose) -> None:
    px = np.array(pixel_grid(pose.intrinsics))
    up = rays(px, pose)[:, 2]
    certain = np.abs(up) > 1e-9  # at the horizon itself rounding decides
    placed = np.isfinite(ground_offset_m(px, pose)).all(axis=1)
    np.testing.assert_array_equal(placed[certain], up[certain] < 0)


@given(level_poses, st.floats(-60.0, 60.0))
def test_the_flat_earth_is_good_to_a_thousandth_near_the_camera(
    pose: CameraPose, lat_deg: float
) -> None:
    """Sphere against ellipsoid: up to 0.7 % of the distance, the paper's own error."""
    pose = dataclasses.replace(pose, lat_deg=lat_deg)
    offset = np.array([[200.0, 0.0], [0.0, 200.0], [-150.0, 150.0]])
    lat, lon = flat_earth_geodetic(offset, pose)
    enu = enu_from_geodetic(lat, lon, Origin(pose.lat_deg, pose.lon_deg))
    np.testing.assert_allclose(enu, offset, atol=0.007 * 200)
    assert math.isclose(math.radians(lat[1] - lat_deg) * EARTH_RADIUS_M, 200.0, rel_tol=1e-6)


@given(level_poses)
def test_the_view_places_pixels_by_the_papers_equations(pose: CameraPose) -> None:
    mapping = mapping_from_pose(pose, ORIGIN)
    px = np.array(pixel_grid(pose.intrinsics, 5))
    exact = px_to_enu(mapping, px)
    camera = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), ORIGIN)
    near = np.linalg.norm(exact - camera, axis=1) < 57 * pose.height_agl_m
    np.testing.assert_allclose(paper_px_to_enu(mapping, px)[near], exact[near], atol=1e-3)
