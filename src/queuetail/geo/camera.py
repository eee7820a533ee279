"""The exact pinhole camera: lens, orientation, projection and rays.

Camera axes are x right, y down, z forward; ENU axes are east, north, up.  Yaw is clockwise from
true north, pitch is positive upwards (-90 looks straight down), roll is clockwise about the optical
axis seen from behind the camera.
"""

from __future__ import annotations

import math

import numpy as np

from queuetail.types import CameraPose, Floats, Intrinsics

UNDISTORT_ITERATIONS = 20


def intrinsics_from_hfov(
    width_px: int, height_px: int, hfov_deg: float, distortion: tuple[float, ...] = ()
) -> Intrinsics:
    """Return the square-pixel lens whose picture is `width_px` wide and `hfov_deg` across.

    Raises ValueError unless 0 < hfov_deg < 180.
    """
    if not 0.0 < hfov_deg < 180.0:
        raise ValueError(f"a horizontal field of view of {hfov_deg:g}° is not between 0° and 180°")
    f_px = 0.5 * width_px / math.tan(math.radians(hfov_deg) / 2)
    cx_px, cy_px = width_px / 2, height_px / 2
    return Intrinsics(width_px, height_px, f_px, f_px, cx_px, cy_px, distortion)


def camera_matrix(lens: Intrinsics) -> Floats:
    """Return the 3×3 matrix K that maps camera axes to homogeneous pixels."""
    return np.array([[lens.fx_px, 0.0, lens.cx_px], [0.0, lens.fy_px, lens.cy_px], [0.0, 0.0, 1.0]])


def rotation_enu_camera(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Return the 3×3 rotation whose columns are the camera's x, y and z axes in ENU."""
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    sin_yaw, cos_yaw = math.sin(yaw), math.cos(yaw)
    sin_pitch, cos_pitch = math.sin(pitch), math.cos(pitch)
    forward = np.array([sin_yaw * cos_pitch, cos_yaw * cos_pitch, sin_pitch])
    right = np.array([cos_yaw, -sin_yaw, 0.0])
    down = np.cross(forward, right)
    sin_roll, cos_roll = math.sin(roll), math.cos(roll)
    return np.column_stack(
        [cos_roll * right + sin_roll * down, cos_roll * down - sin_roll * right, forward]
    )


def distort(xy: Floats, coefficients: tuple[float, ...]) -> Floats:
    """Apply Brown–Conrady distortion to normalised image coordinates, (n, 2) -> (n, 2).

    Source: D. C. Brown (1966), in the order (k1, k2, p1, p2, k3) that OpenCV uses.
    """
    k1, k2, p1, p2, k3 = (*coefficients, *([0.0] * (5 - len(coefficients))))
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.column_stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def undistort(xy: Floats, coefficients: tuple[float, ...]) -> Floats:
    """Undo :func:`distort` by fixed-point iteration; NaN where the lens model does not invert."""
    guess = xy.copy()
    with np.errstate(all="ignore"):
        for _ in range(UNDISTORT_ITERATIONS):
            guess = guess + (xy - distort(guess, coefficients))
        settled = np.abs(distort(guess, coefficients) - xy).max(axis=1, initial=0.0) < 1e-6
    return np.where(settled[:, None], guess, np.nan)


def undistort_px(px: Floats, lens: Intrinsics) -> Floats:
    """Return where an ideal pinhole of the same focal length would show `px`, (n, 2) -> (n, 2)."""
    if not lens.distortion:
        return px
    scale, centre = np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
    return undistort((px - centre) / scale, lens.distortion) * scale + centre


def distort_px(px: Floats, lens: Intrinsics) -> Floats:
    """Undo :func:`undistort_px`, (n, 2) -> (n, 2)."""
    if not lens.distortion:
        return px
    scale, centre = np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
    return distort((px - centre) / scale, lens.distortion) * scale + centre


def project(points_m: Floats, pose: CameraPose) -> Floats:
    """Project ENU points relative to the ground below the camera, (n, 3) metres -> (n, 2) pixels.

    Points behind the camera give NaN.
    """
    R = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    seen = (points_m - np.array([0.0, 0.0, pose.height_agl_m])) @ R
    depth = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
    lens = pose.intrinsics
    xy = seen[:, :2] / depth[:, None]
    ideal = xy * [lens.fx_px, lens.fy_px] + [lens.cx_px, lens.cy_px]
    return distort_px(ideal, lens)


def rays(px: Floats, pose: CameraPose) -> Floats:
    """Return the unit direction in ENU through each pixel, (n, 2) -> (n, 3)."""
    lens = pose.intrinsics
    ideal = undistort_px(px, lens)
    xy = (ideal - [lens.cx_px, lens.cy_px]) / [lens.fx_px, lens.fy_px]
    R = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    directions = np.column_stack([xy, np.ones(len(xy))]) @ R.T
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
