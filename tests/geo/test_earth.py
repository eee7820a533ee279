"""Geodetic ↔ ENU against closed-form ECEF; distances against known values."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.geo.earth import distance_m, enu_from_geodetic, geodetic_from_enu, haversine_m
from queuetail.types import Origin

A_M, F = 6_378_137.0, 1 / 298.257_223_563  # WGS84
origins = st.builds(Origin, st.floats(-85.0, 85.0), st.floats(-180.0, 180.0))
metres = st.floats(-3000.0, 3000.0)


def _ecef(lat_deg: float, lon_deg: float) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    lat, lon, e2 = math.radians(lat_deg), math.radians(lon_deg), F * (2 - F)
    n = A_M / math.sqrt(1 - e2 * math.sin(lat) ** 2)
    return np.array(
        [
            n * math.cos(lat) * math.cos(lon),
            n * math.cos(lat) * math.sin(lon),
            n * (1 - e2) * math.sin(lat),
        ]
    )


def _enu_by_ecef(lat_deg: float, lon_deg: float, origin: Origin) -> tuple[float, float]:
    gap = _ecef(lat_deg, lon_deg) - _ecef(origin.lat_deg, origin.lon_deg)
    lat, lon = math.radians(origin.lat_deg), math.radians(origin.lon_deg)
    east = [-math.sin(lon), math.cos(lon), 0]
    north = [-math.sin(lat) * math.cos(lon), -math.sin(lat) * math.sin(lon), math.cos(lat)]
    return float(gap @ east), float(gap @ north)


@given(origins, metres, metres)
def test_enu_round_trips(origin: Origin, east: float, north: float) -> None:
    """The tangent plane leaves the ellipsoid by d²/2R: 1.4 m at 4.2 km, and 0.3 mm sideways."""
    lat, lon = geodetic_from_enu(np.array([[east, north]]), origin)
    again = enu_from_geodetic(lat, lon, origin)
    np.testing.assert_allclose(again, [[east, north]], atol=2e-3)


@given(origins, metres, metres)
def test_enu_agrees_with_closed_form_ecef(origin: Origin, east: float, north: float) -> None:
    lat, lon = geodetic_from_enu(np.array([[east, north]]), origin)
    got = enu_from_geodetic(lat, lon, origin)[0]
    np.testing.assert_allclose(got, _enu_by_ecef(lat[0], lon[0], origin), atol=1e-6)


def test_the_origin_is_at_zero_and_scalars_keep_their_shape() -> None:
    origin = Origin(36.11, -97.057)
    one = enu_from_geodetic(np.array(36.11), np.array(-97.057), origin)
    assert one.shape == (2,)
    np.testing.assert_allclose(one, 0.0, atol=1e-9)
    none = enu_from_geodetic(np.empty(0), np.empty(0), origin)
    assert none.shape == (0, 2)


def test_the_date_line_is_no_edge() -> None:
    east, north = enu_from_geodetic(np.array([0.0]), np.array([-179.9999]), Origin(0.0, 179.9999))[
        0
    ]
    assert east == pytest.approx(2e-4 * math.pi / 180 * A_M, rel=1e-6)
    assert north == pytest.approx(0.0, abs=1e-6)


def test_haversine_known_values() -> None:
    """A degree of a great circle on the mean sphere is 111 195.08 m; a quarter is 10 007 557 m."""
    along_meridian = haversine_m(np.array([10.0]), np.array([5.0]), np.array([11.0]), np.array([5]))
    assert along_meridian[0] == pytest.approx(111_195.08, abs=0.01)
    quarter = haversine_m(np.array([0.0]), np.array([0.0]), np.array([90.0]), np.array([30.0]))
    assert quarter[0] == pytest.approx(10_007_557.2, abs=1.0)
    opposite = haversine_m(np.array([0.0]), np.array([0.0]), np.array([0.0]), np.array([180.0]))
    assert opposite[0] == pytest.approx(2 * 10_007_557.2, abs=1.0)


def test_geodesic_known_values() -> None:
    """Flinders Peak to Buninyong, the standard check of Vincenty's formulae: 54 972.271 m (GRS80).

    WGS84 differs from GRS80 by less than a tenth of a millimetre over that distance.
    """
    peak = (-(37 + 57 / 60 + 3.72030 / 3600), 144 + 25 / 60 + 29.52440 / 3600)
    buninyong = (-(37 + 39 / 60 + 10.15610 / 3600), 143 + 55 / 60 + 35.38390 / 3600)
    assert distance_m(*peak, *buninyong) == pytest.approx(54_972.271, abs=0.001)
    assert distance_m(0.0, 0.0, 0.0, 1.0) == pytest.approx(111_319.491, abs=0.001)
    assert distance_m(36.1, -97.0, 36.1, -97.0) == 0.0


@given(origins, metres, metres)
def test_both_distances_agree_with_enu_nearby(origin: Origin, east: float, north: float) -> None:
    lat, lon = geodetic_from_enu(np.array([[east, north]]), origin)
    flat = math.hypot(east, north)
    here = (origin.lat_deg, origin.lon_deg, float(lat[0]), float(lon[0]))
    assert distance_m(*here) == pytest.approx(flat, abs=2e-3)
    sphere = float(haversine_m(*(np.array([v]) for v in here))[0])
    assert sphere == pytest.approx(flat, rel=0.006, abs=1e-6)  # the ellipsoid's flattening
