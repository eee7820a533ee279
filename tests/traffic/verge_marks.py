"""Verges of made-up roads, as they would be seen."""

from __future__ import annotations

import numpy as np

from queuetail.traffic.lane_evidence import NO_VEHICLE, WANDER_M, WINDOW_M, LaneEvidence
from queuetail.traffic.road import length_m, locate, place
from queuetail.traffic.verges import Verges
from queuetail.types import Approach, Floats


def verges(
    approach: Approach,
    left_m: float,
    right_m: float,
    rng: np.random.Generator,
    strays: int = 2,
    spread_m: float = 0.1,
) -> Verges:
    """Where the asphalt ends on both sides of an approach, with strays in every stretch."""
    stations = np.arange(WINDOW_M / 2, length_m(approach), WINDOW_M)
    width_m = approach.lanes * approach.lane_width_m
    rows: list[tuple[float, float, int, int]] = []
    for side, sign, edge_m, end_m in ((0, 1, 0.0, left_m), (1, -1, width_m, right_m)):
        for stretch, station in enumerate(stations.tolist()):
            out = [edge_m + end_m + rng.normal(0.0, spread_m)]
            out += (edge_m + rng.uniform(-3.0, 8.0, strays)).tolist()
            rows += [(station, sign * o, side, stretch) for o in out]
    station, offset, side, stretch = np.array(rows).T
    return at(approach, station, offset, side, stretch)


def at(
    approach: Approach, station_m: Floats, offset_m: Floats, side: Floats, stretch: Floats
) -> Verges:
    """Verges at stations and offsets."""
    enu = place(approach, station_m, offset_m)
    n = len(enu)
    seen = LaneEvidence(
        enu,
        locate(approach, enu)[2],
        np.full(n, NO_VEHICLE, np.int64),
        np.full(n, WINDOW_M / WANDER_M),
    )
    return Verges(seen, side.astype(np.int64), stretch.astype(np.int64))
