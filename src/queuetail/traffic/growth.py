"""How fast the end of a queue moves upstream."""

from __future__ import annotations

from collections import deque

import numpy as np

WINDOW_S = 20.0  # the end jumps by a vehicle's length and gap at every arrival, and creeps between
MIN_SPAN_S = 5.0


class Growth:
    """The slope of the end's station over the last seconds; positive while the queue grows."""

    def __init__(self) -> None:
        self._past: deque[tuple[float, float]] = deque()

    def update(self, t_s: float, station_m: float | None) -> float | None:
        """Take in where the end is now (None: nowhere) and return the growth in m/s once known."""
        if station_m is None:
            self._past.clear()
            return None
        self._past.append((t_s, station_m))
        while t_s - self._past[0][0] > WINDOW_S:
            self._past.popleft()
        if t_s - self._past[0][0] < MIN_SPAN_S:
            return None
        times, stations = np.array(self._past).T
        centred = times - times.mean()
        return float(-(centred @ (stations - stations.mean())) / (centred @ centred))
