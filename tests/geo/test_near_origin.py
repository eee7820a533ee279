"""Conversions near an origin: as good as the exact ones, and those themselves farther out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.near_origin import fast_geodetic
from queuetail.types import Origin


@pytest.mark.parametrize("lat_deg", [0.0, 36.1, -70.0, 79.9, 85.0])
def test_fast_geodetic_is_exact_to_a_millimetre(lat_deg: float) -> None:
    origin = Origin(lat_deg, 179.999)
    enu = np.random.default_rng(1).uniform(-2000, 2000, (500, 2))
    lat, lon = fast_geodetic(enu, origin)
    true_lat, true_lon = geodetic_from_enu(enu, origin)
    metres = 111_320.0
    east_m = ((lon - true_lon + 180) % 360 - 180) * metres * math.cos(math.radians(lat_deg))
    assert np.abs(lat - true_lat).max() * metres < 1e-3
    assert np.abs(east_m).max() < 1e-3
    assert np.abs(lon).max() <= 180


def test_fast_geodetic_takes_over_far_out_and_empty() -> None:
    origin = Origin(50.0, 8.0)
    far = np.array([[90_000.0, -3.0]])
    assert np.allclose(fast_geodetic(far, origin), geodetic_from_enu(far, origin), atol=0)
    assert fast_geodetic(np.empty((0, 2)), origin)[0].shape == (0,)
