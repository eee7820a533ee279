"""Rays × ground plane: pixels ↔ ENU metres, and how well they are known."""

from __future__ import annotations

import dataclasses

import numpy as np

from queuetail.geo.camera import camera_matrix, distort_px, rotation_enu_camera, undistort_px
from queuetail.geo.earth import enu_from_geodetic
from queuetail.types import CameraPose, Floats, GroundMapping, Intrinsics, Origin, PoseSigma

MIN_ASPECT = 1e-3  # of the spread of control points: a road 2 m wide and 2 km long


def apply_homography(H: Floats, points: Floats) -> Floats:
    """Map points by a homography, (n, 2) -> (n, 2); NaN where they lie on its far side (w <= 0)."""
    xyw = points @ H[:, :2].T + H[:, 2]
    w = xyw[..., 2:]
    with np.errstate(over="ignore"):  # of points next to the horizon
        return np.asarray(xyw[..., :2] / np.where(w > 0, w, np.nan))


def mapping_from_pose(
    pose: CameraPose, origin: Origin, sigma: PoseSigma | None = None
) -> GroundMapping:
    """Return the exact plane mapping of a pinhole camera above level ground.

    A pixel's ray d = R K⁻¹ (u, v, 1) meets the ground at camera + d·h/(−d_up), a homography with
    w = −d_up: positive exactly where the pixel looks below the horizon.
    """
    R = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
    D = R @ np.linalg.inv(camera_matrix(pose.intrinsics))
    camera = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), origin)
    H = np.stack(
        [
            pose.height_agl_m * D[0] - camera[0] * D[2],
            pose.height_agl_m * D[1] - camera[1] * D[2],
            -D[2],
        ]
    )
    # Its inverse in closed form, so that a far origin costs no digits; w is the depth in metres.
    to_camera = np.array([[1, 0, -camera[0]], [0, 1, -camera[1]], [0, 0, -pose.height_agl_m]])
    return GroundMapping(
        H_enu_px=H,
        H_px_enu=camera_matrix(pose.intrinsics) @ R.T @ to_camera,
        origin=origin,
        intrinsics=pose.intrinsics if pose.intrinsics.distortion else None,
        pose=pose,
        pose_sigma=sigma or PoseSigma(),
    )


def mapping_from_control_points(
    px: Floats, enu: Floats, origin: Origin | None, lens: Intrinsics | None = None
) -> GroundMapping:
    """Fit the plane mapping to four or more pairs of pixels and ground metres, (n, 2) each.

    Raises ValueError when there are fewer than four pairs or they are nearly on a line.
    Source: normalised direct linear transform, Hartley & Zisserman (2004), algorithm 4.2.
    """
    if len(px) < 4:
        raise ValueError(f"{len(px)} control points given, at least 4 are needed")
    ideal = undistort_px(px, lens) if lens else px
    if not np.isfinite(ideal).all():
        raise ValueError("a control point lies where the lens, by its distortion, sees nothing")
    if _on_a_line(ideal) or _on_a_line(enu):
        raise ValueError("the control points are nearly on a line; spread them over the road")
    H = _direct_linear_transform(ideal, enu)
    w = ideal @ H[2, :2] + H[2, 2]
    if not (np.all(w > 0) or np.all(w < 0)):
        raise ValueError("the control points cannot all lie on one plane in front of the camera")
    H = H * np.sign(w[0])
    inverse = np.linalg.inv(H)
    inverse = inverse * np.sign((enu @ inverse[2, :2] + inverse[2, 2])[0])
    residual = apply_homography(H, ideal) - enu
    spare = max(2 * len(px) - 8, 1)
    sigma_m = float(np.sqrt((residual**2).sum() / spare))
    return GroundMapping(H, inverse, origin, intrinsics=lens, sigma_m=sigma_m)


def px_to_enu(mapping: GroundMapping, px: Floats) -> Floats:
    """Return the ground metres under pixels, (n, 2) -> (n, 2); NaN at and above the horizon."""
    ideal = undistort_px(px, mapping.intrinsics) if mapping.intrinsics else px
    return apply_homography(mapping.H_enu_px, ideal)


def enu_to_px(mapping: GroundMapping, enu: Floats) -> Floats:
    """Return the pixels of ground points, (n, 2) -> (n, 2); NaN behind the camera."""
    ideal = apply_homography(mapping.H_px_enu, enu)
    return distort_px(ideal, mapping.intrinsics) if mapping.intrinsics else ideal


def covariance(mapping: GroundMapping, px: Floats) -> Floats:
    """Return the covariance of ground positions in m², (n, 2) pixels -> (n, 2, 2).

    First-order propagation of the pose's standard deviations and of the pixel's own.
    """
    base = px_to_enu(mapping, px)
    sigma = mapping.pose_sigma
    steps = [
        (px_to_enu(mapping, px + delta) - base) * sigma.pixel_px for delta in ([1.0, 0], [0, 1.0])
    ]
    pose = mapping.pose
    fixed = mapping.sigma_m**2
    if pose is not None and mapping.origin is not None:
        fixed += sigma.horizontal_m**2
        for name, value in (
            ("height_agl_m", sigma.height_m),
            ("yaw_deg", sigma.yaw_deg),
            ("pitch_deg", sigma.pitch_deg),
            ("roll_deg", sigma.roll_deg),
        ):
            moved = dataclasses.replace(pose, **{name: getattr(pose, name) + value})
            steps.append(px_to_enu(mapping_from_pose(moved, mapping.origin), px) - base)
    J = np.stack(steps, axis=-1)
    return np.asarray(J @ np.swapaxes(J, -1, -2) + fixed * np.eye(2))


def _direct_linear_transform(source: Floats, target: Floats) -> Floats:
    S, T = _normalising(source), _normalising(target)
    a, b = apply_homography(S, source), apply_homography(T, target)
    one, zero = np.ones(len(a)), np.zeros(len(a))
    x, y, u, v = a[:, 0], a[:, 1], b[:, 0], b[:, 1]
    rows = np.concatenate(
        [
            np.stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u], axis=1),
            np.stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v], axis=1),
        ]
    )
    _, singular, Vt = np.linalg.svd(rows)
    if singular[7] < 1e-6 * singular[0]:
        raise ValueError("three of four control points are nearly on a line; spread them more")
    return np.asarray(np.linalg.inv(T) @ Vt[-1].reshape(3, 3) @ S)


def _on_a_line(points: Floats) -> bool:
    """True where points (n, 2) spread a thousand times less across than along."""
    centred = points - points.mean(axis=0)
    if not centred.any():
        raise ValueError("the control points are all at the same place")
    along, across = np.linalg.svd(centred, compute_uv=False)
    return bool(across < MIN_ASPECT * along)


def _normalising(points: Floats) -> Floats:
    centre = points.mean(axis=0)
    spread = np.linalg.norm(points - centre, axis=1).mean()
    s = np.sqrt(2) / spread
    return np.array([[s, 0, -s * centre[0]], [0, s, -s * centre[1]], [0, 0, 1.0]])
