"""Points whose true place is known, and how far off they are measured.

Source: Messenger et al. (2023), its test of the GPS position: the haversine distance between where
a clicked pixel is placed and where it truly is, its mean and its worst.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu, haversine_m
from queuetail.geo.ground import px_to_enu
from queuetail.types import Floats, GroundMapping


@dataclass(frozen=True, slots=True)
class KnownPoint:
    """A pixel of one moment, and the true place of what it shows."""

    t_s: float
    px: tuple[float, float]
    lat_deg: float
    lon_deg: float
    name: str = ""


@dataclass(frozen=True, slots=True)
class PlacedPoint:
    """A known point, and where a mapping puts it; NaN at and above the horizon."""

    point: KnownPoint
    lat_deg: float
    lon_deg: float
    error_m: float
    along_m: float  # of the error: away from the camera's foot where the pose is known, else north
    across_m: float  # to the right of that, else east


@dataclass(frozen=True, slots=True)
class Errors:
    """The errors of some points; mean and worst over those that lie below the horizon."""

    placed: tuple[PlacedPoint, ...]

    @property
    def mean_m(self) -> float:
        """The mean error; NaN without any."""
        found = self._found()
        return float(found.mean()) if len(found) else float("nan")

    @property
    def worst_m(self) -> float:
        """The largest error; NaN without any."""
        found = self._found()
        return float(found.max()) if len(found) else float("nan")

    @property
    def unseen(self) -> int:
        """How many points look at or above the horizon."""
        return len(self.placed) - len(self._found())

    def _found(self) -> Floats:
        errors = np.array([p.error_m for p in self.placed], float)
        return errors[np.isfinite(errors)]


def measure(points: Sequence[KnownPoint], mappings: Sequence[GroundMapping]) -> Errors:
    """Place each point by its moment's mapping, which has an origin; its errors by haversine."""
    return Errors(tuple(_placed(p, m) for p, m in zip(points, mappings, strict=True)))


def _placed(point: KnownPoint, mapping: GroundMapping) -> PlacedPoint:
    origin = mapping.origin
    assert origin is not None, "a mapping without an origin has no latitude to compare"
    enu = px_to_enu(mapping, np.array([point.px], float))
    lat, lon = geodetic_from_enu(enu, origin)
    true_lat, true_lon = np.array([point.lat_deg]), np.array([point.lon_deg])
    error = haversine_m(lat, lon, true_lat, true_lon)
    true = enu_from_geodetic(true_lat, true_lon, origin)[0]
    foot = true - np.array([0.0, 1.0])
    if mapping.pose is not None:
        pose = mapping.pose
        foot = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), origin)
    sight = true - foot
    sight = sight / max(float(np.linalg.norm(sight)), 1e-9)
    off = enu[0] - true
    return PlacedPoint(
        point,
        float(lat[0]),
        float(lon[0]),
        float(error[0]),
        along_m=float(off @ sight),
        across_m=float(off @ np.array([sight[1], -sight[0]])),
    )
