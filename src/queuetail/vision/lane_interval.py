"""Foreground along one lane, in the road view's raster."""

from __future__ import annotations

from dataclasses import dataclass

MIN_LENGTH_M = 2.0


@dataclass(slots=True)
class Interval:
    """Foreground along one lane, in raster columns and rows."""

    band: int
    lane: int
    rear: float
    front: float
    row: float
    cut: tuple[bool, bool]  # at the rear and front, by the end of what is seen
    contrast: float
    body: float
    roof: bool = False
    shadow: bool = False
    astride: bool = False  # on the edge between its lane and the next
    bodies: tuple[tuple[float, float], ...] = ()  # rears and fronts of what is no cast shadow
