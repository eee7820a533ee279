"""The truth's axis: latitude and longitude ↔ the truth's own stations and offsets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from queuetail.geo.earth import enu_from_geodetic, haversine_m
from queuetail.traffic.road import locate, place
from queuetail.types import Approach, Floats, Origin

CHUNK = 20_000  # rows at a time: keeps the (rows, legs) arrays small


@dataclass(frozen=True, slots=True)
class Axis:
    """A polyline whose vertices have stations of their own, not quite the metres between them."""

    station_m: Floats  # (k,), increasing
    lat_deg: Floats  # (k,)
    lon_deg: Floats  # (k,)
    line: Approach  # the same vertices in ENU; its stations are metres along the polyline
    metres: Floats  # (k,) metres along the polyline at each vertex
    origin: Origin


def make_axis(station_m: Floats, lat_deg: Floats, lon_deg: Floats) -> Axis:
    """Return the axis through (k,) vertices, k >= 2, with ENU about its middle vertex.

    Raises ValueError where the stations do not increase or two vertices coincide.
    """
    if len(station_m) < 2:
        raise ValueError("an axis needs two points or more")
    if not (np.diff(station_m) > 0).all():
        raise ValueError("the stations of an axis must increase from row to row")
    middle = len(station_m) // 2
    origin = Origin(float(lat_deg[middle]), float(lon_deg[middle]))
    enu = enu_from_geodetic(lat_deg, lon_deg, origin)
    legs = np.linalg.norm(np.diff(enu, axis=0), axis=1)
    if not (legs > 0).all():
        raise ValueError("the axis has the same point twice in a row")
    metres = np.concatenate([[0.0], np.cumsum(legs)])
    return Axis(station_m, lat_deg, lon_deg, Approach("truth", enu), metres, origin)


def locate_geodetic(axis: Axis, lat_deg: Floats, lon_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Return stations (n,), offsets (n,) and ENU (n, 2) of places, NaN where there is none.

    Beyond its ends the axis goes on straight.
    """
    enu = enu_from_geodetic(lat_deg, lon_deg, axis.origin)
    station, offset = np.full(len(enu), np.nan), np.full(len(enu), np.nan)
    known = np.flatnonzero(np.isfinite(enu).all(axis=1))
    for start in range(0, len(known), CHUNK):
        rows = known[start : start + CHUNK]
        metres, offset[rows], _ = locate(axis.line, enu[rows])
        station[rows] = _interpolate(metres, axis.metres, axis.station_m)
    return station, offset, enu


def enu_at(axis: Axis, station_m: Floats, offset_m: Floats) -> Floats:
    """Return the points at stations and offsets, (n,), (n,) -> (n, 2); NaN where either is."""
    enu = np.full((len(station_m), 2), np.nan)
    known = np.isfinite(station_m) & np.isfinite(offset_m)
    metres = _interpolate(station_m[known], axis.station_m, axis.metres)
    enu[known] = place(axis.line, metres, offset_m[known])
    return enu


def nearest_m(axis: Axis, lat_deg: Floats, lon_deg: Floats) -> float:
    """Return how far the nearest of the places, (n,) with n >= 1, is from the nearest vertex."""
    away = haversine_m(lat_deg[:, None], lon_deg[:, None], axis.lat_deg, axis.lon_deg)
    return float(away.min())


def _interpolate(x: Floats, from_m: Floats, to_m: Floats) -> Floats:
    """Return `x` carried from one measure of the vertices to the other, linear beyond the ends."""
    i = np.clip(np.searchsorted(from_m, x, side="right") - 1, 0, len(from_m) - 2)
    share = (x - from_m[i]) / (from_m[i + 1] - from_m[i])
    return np.asarray(to_m[i] + share * (to_m[i + 1] - to_m[i]))
