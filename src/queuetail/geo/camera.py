"""The exact pinhole camera: lens, orientation, projection and rays.

Camera axes are x right, y down, z forward; ENU axes are east, north, up.  Yaw is clockwise from
true north, pitch is positive upwards (-90 looks straight down), roll is clockwise about the optical
axis seen from behind the camera.
"""

from __future__ import annotations

import math

import numpy as np

from queuetail.types import Bools, CameraPose, Floats, Intrinsics

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
    """Undo :func:`distort` by Newton's method; NaN where the lens model does not invert.

    Plain fixed-point iteration is still wrong by pixels at the edge of a wide barrel lens.
    """
    guess = xy.copy()
    with np.errstate(all="ignore"):
        for _ in range(UNDISTORT_ITERATIONS):
            a, b, d = _distortion_jacobian(guess, coefficients)
            x, y = (xy - distort(guess, coefficients)).T
            step = np.column_stack([d * x - b * y, a * y - b * x]) / (a * d - b * b)[:, None]
            guess = guess + step
        settled = np.abs(distort(guess, coefficients) - xy).max(axis=1, initial=0.0) < 1e-9
        settled &= _is_unfolded(guess, coefficients)
    return np.where(settled[:, None], guess, np.nan)


def _distortion_jacobian(
    xy: Floats, coefficients: tuple[float, ...]
) -> tuple[Floats, Floats, Floats]:
    """Return a, b, d of the symmetric Jacobian [[a, b], [b, d]] of :func:`distort`."""
    k1, k2, p1, p2, k3 = (*coefficients, *([0.0] * (5 - len(coefficients))))
    x, y = xy[:, 0], xy[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))  # d radial / d x = slope * x
    return (
        radial + slope * x * x + 2 * p1 * y + 6 * p2 * x,
        slope * x * y + 2 * p1 * x + 2 * p2 * y,
        radial + slope * y * y + 6 * p1 * y + 2 * p2 * x,
    )


def _is_unfolded(xy: Floats, coefficients: tuple[float, ...]) -> Bools:
    """Return where the lens model still runs outwards; beyond, it folds back into the picture."""
    a, b, d = _distortion_jacobian(xy, coefficients)
    return np.asarray((a + d > 0) & (a * d - b * b > 0), np.bool_)


def undistort_px(px: Floats, lens: Intrinsics) -> Floats:
    """Return where an ideal pinhole of the same focal length would show `px`, (n, 2) -> (n, 2)."""
    if not lens.distortion:
        return px
    scale, centre = np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
    return undistort((px - centre) / scale, lens.distortion) * scale + centre


def distort_px(px: Floats, lens: Intrinsics) -> Floats:
    """Undo :func:`undistort_px`, (n, 2) -> (n, 2); NaN for what is too far aside for the lens."""
    if not lens.distortion:
        return px
    scale, centre = np.array([lens.fx_px, lens.fy_px]), np.array([lens.cx_px, lens.cy_px])
    xy = (px - centre) / scale
    with np.errstate(over="ignore", invalid="ignore"):  # of points next to the horizon
        shown = distort(xy, lens.distortion) * scale + centre
        return np.where(_is_unfolded(xy, lens.distortion)[:, None], shown, np.nan)


def project(points_m: Floats, pose: CameraPose) -> Floats:
    """Project ENU points relative to the ground below the camera, (n, 3) metres -> (n, 2) pixels.

    Points behind the camera, or too far aside for a lens with distortion, give NaN.
    """
    R = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    seen = (points_m - np.array([0.0, 0.0, pose.height_agl_m])) @ R
    depth = np.where(seen[:, 2] > 0, seen[:, 2], np.nan)
    lens = pose.intrinsics
    with np.errstate(over="ignore"):  # of points right beside the camera
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
