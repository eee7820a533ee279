"""Where the camera stands above the ground, from its pose or from the plane mapping alone."""

from __future__ import annotations

import math

import numpy as np

from queuetail.geo.earth import enu_from_geodetic
from queuetail.types import Floats, GroundMapping


def camera_above_ground(mapping: GroundMapping) -> tuple[Floats, float]:
    """Return the ENU point below the camera and its height above it, in metres.

    Without a pose the lens is taken as one of square pixels whose centre is that of the
    intrinsics; where the mapping says too little the height is infinite: nothing leans.
    """
    pose = mapping.pose
    if pose is not None and mapping.origin is not None:
        place = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), mapping.origin)
        return place, pose.height_agl_m
    if mapping.intrinsics is None:
        return np.zeros(2), math.inf
    return _from_homography(mapping.H_px_enu, mapping.intrinsics.cx_px, mapping.intrinsics.cy_px)


def _from_homography(H_px_enu: Floats, cx_px: float, cy_px: float) -> tuple[Floats, float]:
    """Split K [r1 r2 t]: r1 and r2 are of one length and square to each other.

    Source: Zhang, A flexible new technique for camera calibration (2000), section 3.1.
    """
    H = np.array([[1.0, 0.0, -cx_px], [0.0, 1.0, -cy_px], [0.0, 0.0, 1.0]]) @ H_px_enu
    a, b = H[:, 0], H[:, 1]
    image = np.array([a[0] * b[0] + a[1] * b[1], a[0] ** 2 + a[1] ** 2 - b[0] ** 2 - b[1] ** 2])
    depth = np.array([a[2] * b[2], a[2] ** 2 - b[2] ** 2])
    squared = -(image @ image) / (image @ depth) if image @ depth else -1.0
    if not 0.0 < squared < math.inf:
        return np.zeros(2), math.inf
    scaled = H / np.array([[math.sqrt(squared)], [math.sqrt(squared)], [1.0]])
    scaled /= np.sqrt(np.linalg.norm(scaled[:, 0]) * np.linalg.norm(scaled[:, 1]))
    r1, r2, t = scaled.T
    camera = -np.array([r1 @ t, r2 @ t, np.cross(r1, r2) @ t])
    return camera[:2], abs(float(camera[2]))
