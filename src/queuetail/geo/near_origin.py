"""Many small conversions to latitude and longitude per frame, ten times cheaper than exact ones."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from queuetail.geo.earth import geodetic_from_enu
from queuetail.types import Floats, Origin

REACH_M = 2000.0


def fast_geodetic(enu: Floats, origin: Origin) -> tuple[Floats, Floats]:
    """Return latitudes and longitudes of ground points, (n, 2) -> (n,), (n,).

    Within REACH_M of the origin a cubic fitted to the exact conversion is used (1 mm up to 80°
    of latitude); farther out, the exact conversion itself.
    """
    if abs(origin.lat_deg) > 80 or not (np.abs(enu) <= REACH_M).all():
        with np.errstate(all="ignore"):  # a place that is not finite has no latitude
            return geodetic_from_enu(enu, origin)
    terms = _powers(enu)
    lat, lon = terms @ _coefficients(origin)[0], terms @ _coefficients(origin)[1]
    return origin.lat_deg + lat, (origin.lon_deg + lon + 180) % 360 - 180


@lru_cache(maxsize=16)
def _coefficients(origin: Origin) -> tuple[Floats, Floats]:
    steps = np.linspace(-REACH_M, REACH_M, 9)
    enu = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    lat, lon = geodetic_from_enu(enu, origin)
    lon_offset = (lon - origin.lon_deg + 180) % 360 - 180
    target = np.column_stack([lat - origin.lat_deg, lon_offset])
    solution = np.linalg.lstsq(_powers(enu), target)[0].astype(float)
    return solution[:, 0], solution[:, 1]


def _powers(enu: Floats) -> Floats:
    e, n = enu[:, 0] / REACH_M, enu[:, 1] / REACH_M
    return np.column_stack([e, n, e * e, e * n, n * n, e**3, e * e * n, e * n * n, n**3])
