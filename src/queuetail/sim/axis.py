"""The road's axis: straight, or straight – arc – straight; exact both ways."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from queuetail.sim.scenario import Road
from queuetail.types import Floats

VIEW_STATION_M = 900.0  # of ENU (0, 0): the middle of what the drone watches
ROAD_LENGTH_M = 2200.0  # where vehicles exist: station 0 … here
ARC_HALF_LENGTH_M = 500.0
ARC_HALF_TURN_RAD = 1.2


@dataclass(frozen=True, slots=True)
class Axis:
    """Left edge of the left lane; passes ENU (0, 0) at VIEW_STATION_M on the given course."""

    course_deg: float
    curvature_per_m: float = 0.0  # positive bends left
    arc_half_m: float = 0.0

    @classmethod
    def of(cls, road: Road) -> Axis:
        """Return the axis of a scenario's road."""
        if not road.bend_radius_m:
            return cls(road.course_deg)
        half_m = min(ARC_HALF_LENGTH_M, ARC_HALF_TURN_RAD * abs(road.bend_radius_m))
        return cls(road.course_deg, 1.0 / road.bend_radius_m, half_m)

    def enu(self, station_m: Floats, offset_m: Floats) -> Floats:
        """Return ENU metres of road places, (n,), (n,) -> (n, 2)."""
        along = np.asarray(station_m, float) - VIEW_STATION_M
        angle = self._turn(along)
        inside = np.clip(along, -self.arc_half_m, self.arc_half_m)
        rest = along - inside
        k = self.curvature_per_m
        if k:
            x, y = np.sin(k * inside) / k, (1 - np.cos(k * inside)) / k
        else:
            x, y = inside, np.zeros_like(inside)
        x = x + rest * np.cos(angle) - offset_m * np.sin(angle)
        y = y + rest * np.sin(angle) + offset_m * np.cos(angle)
        return self._to_enu(x, y)

    def heading_rad(self, station_m: Floats) -> Floats:
        """Return the direction of travel as an angle from east, counter-clockwise, (n,) -> (n,)."""
        along = np.asarray(station_m, float) - VIEW_STATION_M
        return math.radians(90.0 - self.course_deg) + self._turn(along)

    def locate(self, enu: Floats) -> tuple[Floats, Floats]:
        """Return station and offset of ENU points, (n, 2) -> (n,), (n,): the inverse of `enu`."""
        base = math.radians(90.0 - self.course_deg)
        x = enu[..., 0] * math.cos(base) + enu[..., 1] * math.sin(base)
        y = -enu[..., 0] * math.sin(base) + enu[..., 1] * math.cos(base)
        k, half = self.curvature_per_m, self.arc_half_m
        if not k:
            return x + VIEW_STATION_M, y
        turn = np.arctan2(x * np.sign(k), (1 / k - y) * np.sign(k))
        arc_along, arc_offset = turn / k, 1 / k - np.sign(k) * np.hypot(x, 1 / k - y)
        along, offset = arc_along, arc_offset
        for side in (-1.0, 1.0):
            angle = k * half * side
            ex, ey = math.sin(angle) / k, (1 - math.cos(angle)) / k
            dx, dy = x - ex, y - ey
            rest = dx * math.cos(angle) + dy * math.sin(angle)
            beyond = (arc_along * side > half) & (rest * side > 0)
            along = np.where(beyond, side * half + rest, along)
            offset = np.where(beyond, -dx * math.sin(angle) + dy * math.cos(angle), offset)
        return along + VIEW_STATION_M, offset

    def _turn(self, along: Floats) -> Floats:
        clipped = np.clip(along, -self.arc_half_m, self.arc_half_m)
        return np.asarray(self.curvature_per_m * clipped)

    def _to_enu(self, x: Floats, y: Floats) -> Floats:
        base = math.radians(90.0 - self.course_deg)
        return np.stack(
            [x * math.cos(base) - y * math.sin(base), x * math.sin(base) + y * math.cos(base)],
            axis=-1,
        )
