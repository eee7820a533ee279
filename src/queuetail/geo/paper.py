"""The geolocation of Messenger et al. (2023), equations (1)–(8), in the readings that work.

Readings taken, each tested against exact projection:

* (1) and (4), the angles of a pixel's row and column: printed with the pixel index alone; they need
  its distance from the centre over the focal length, (n/2 − i)/f.
* (2), (3), forward ground distance: height over the tangent of the row's depression, as printed.
* (5), sideways distance: printed as the forward *ground* distance times the column's tangent, which
  is zero at nadir; we take the row's *slant* distance, which is exact for a level camera.
* (6), turning into north and east: printed as a reflection; we take the rotation by the heading.
* (7), (8), latitude and longitude on a flat earth: as printed, with the radius of the mean sphere.

The paper's camera has no roll and no lens distortion, so neither has this one.
"""

from __future__ import annotations

import math

import numpy as np

from queuetail.geo.earth import EARTH_RADIUS_M
from queuetail.types import CameraPose, Floats


def ground_offset_m(px: Floats, pose: CameraPose) -> Floats:
    """Return metres east and north of the camera, (n, 2) pixels -> (n, 2): equations (1)–(6).

    Pixels at or above the horizon give NaN.
    """
    lens = pose.intrinsics
    up_px = lens.cy_px - px[:, 1]
    across_px = px[:, 0] - lens.cx_px
    depression = -math.radians(pose.pitch_deg) - np.arctan(up_px / lens.fy_px)  # (1)
    depression = np.where(np.sin(depression) > 0, depression, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # of pixels next to the horizon
        slant_m = pose.height_agl_m / np.sin(depression)  # (2)
        forward_m = slant_m * np.cos(depression)  # (3)
        across = np.arctan(across_px / np.hypot(lens.fx_px, up_px))  # (4)
        sideways_m = slant_m * np.tan(across)  # (5)
        yaw = math.radians(pose.yaw_deg)
        east = forward_m * math.sin(yaw) + sideways_m * math.cos(yaw)  # (6)
        north = forward_m * math.cos(yaw) - sideways_m * math.sin(yaw)
    return np.column_stack([east, north])


def flat_earth_geodetic(offset_m: Floats, pose: CameraPose) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes in degrees of offsets from the camera: equations (7), (8)."""
    lat = pose.lat_deg + np.degrees(offset_m[:, 1] / EARTH_RADIUS_M)
    scale = EARTH_RADIUS_M * math.cos(math.radians(pose.lat_deg))
    return lat, pose.lon_deg + np.degrees(offset_m[:, 0] / scale)
