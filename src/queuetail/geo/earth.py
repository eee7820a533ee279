"""Geodetic ↔ ENU on the WGS84 ellipsoid (pymap3d), and distances."""

from __future__ import annotations

import numpy as np
import pymap3d
from pymap3d.vincenty import vdist

from queuetail.types import Floats, Origin

EARTH_RADIUS_M = 6_371_008.8  # mean radius, IUGG


def enu_from_geodetic(lat_deg: Floats, lon_deg: Floats, origin: Origin) -> Floats:
    """Return metres east and north of `origin`, all at height 0: (n,), (n,) -> (n, 2)."""
    east, north, _ = pymap3d.geodetic2enu(
        lat_deg, lon_deg, 0.0, origin.lat_deg, origin.lon_deg, 0.0
    )
    return np.stack([np.asarray(east, float), np.asarray(north, float)], axis=-1)


def geodetic_from_enu(enu: Floats, origin: Origin) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes in degrees of ground points, (n, 2) -> (n,), (n,)."""
    lat, lon, _ = pymap3d.enu2geodetic(
        enu[..., 0], enu[..., 1], 0.0, origin.lat_deg, origin.lon_deg, 0.0
    )
    return np.asarray(lat, float), np.asarray(lon, float)


def haversine_m(lat1_deg: Floats, lon1_deg: Floats, lat2_deg: Floats, lon2_deg: Floats) -> Floats:
    """Return the great-circle distance in metres on the mean sphere (the paper's speed formula)."""
    lat1, lon1, lat2, lon2 = (np.radians(a) for a in (lat1_deg, lon1_deg, lat2_deg, lon2_deg))
    a = np.sin((lat2 - lat1) / 2) ** 2
    a = a + np.cos(lat1) * np.cos(lat2) * np.sin((lon2 - lon1) / 2) ** 2
    return np.asarray(2 * EARTH_RADIUS_M * np.arcsin(np.sqrt(np.clip(a, 0, 1))))


def distance_m(lat1_deg: float, lon1_deg: float, lat2_deg: float, lon2_deg: float) -> float:
    """Return the geodesic distance in metres on WGS84 (Vincenty, by pymap3d)."""
    if (lat1_deg, lon1_deg) == (lat2_deg, lon2_deg):
        return 0.0
    return float(vdist(lat1_deg, lon1_deg, lat2_deg, lon2_deg)[0])
