"""One height above the ground from a lidar that loses its echo and an altitude that drifts."""

from __future__ import annotations

import math
import statistics
from collections import deque

from queuetail.link.messages import Altitude, Attitude, Height, HeightSource, Lidar, Quantity

FRESH_S = 1.0
TILT_LIMIT_DEG = 45.0  # beyond it the beam's slant says little of the height
OTHER_S = 2.0  # a height of a worse source waits for so long for a better one
PAIRS = 21  # of the lidar's and the altitude's height, for the offset between them
MIN_RANGE_M = 0.2  # the LW20/C reads nothing nearer


class HeightFinder:
    """Takes quantities in order of time and says the height, best source first.

    The lidar looks straight down from the airframe, so its range counts times the cosines of the
    drone's roll and pitch.  While it has no echo, the height above take-off goes on from there.
    """

    def __init__(self) -> None:
        self._tilt: tuple[float, float] | None = None  # time, cosine of the tilt
        self._altitude: tuple[float, float] | None = None  # time, metres above take-off
        self._lidar_s = -math.inf
        self._offsets: deque[float] = deque(maxlen=PAIRS)
        self._best: tuple[float, HeightSource] | None = None
        self._told_s = -math.inf

    def add(self, quantity: Quantity, t_s: float) -> Height | None:
        """Take a quantity measured at `t_s`; return the height to go by now, if it gives one.

        A height that somebody else found counts before ours; of sources that differ only the best
        one counts while it is heard, or the height would jump to and fro.
        """
        if isinstance(quantity, Height):
            self._told_s = t_s
            found: Height | None = quantity
        else:
            found = self._found(quantity, t_s)
            if t_s - self._told_s <= OTHER_S:
                return None
        if found is None:
            return None
        if self._best is not None:
            best_s, source = self._best
            if found.source > source and t_s - best_s <= OTHER_S:
                return None
        self._best = t_s, found.source
        return found

    def _found(self, quantity: Quantity, t_s: float) -> Height | None:
        if isinstance(quantity, Attitude):
            cosine = math.cos(math.radians(quantity.roll_deg))
            cosine *= math.cos(math.radians(quantity.pitch_deg))
            self._tilt = t_s, cosine
        elif isinstance(quantity, Lidar):
            return self._from_lidar(quantity, t_s)
        elif isinstance(quantity, Altitude) and quantity.above_takeoff_m is not None:
            self._altitude = t_s, quantity.above_takeoff_m
            if t_s - self._lidar_s <= FRESH_S:
                return None  # the lidar knows better
            if self._offsets:
                agl_m = quantity.above_takeoff_m + statistics.median(self._offsets)
                return Height(agl_m, HeightSource.LIDAR_AND_ALTITUDE)
            return Height(quantity.above_takeoff_m, HeightSource.TAKEOFF)
        return None

    def _from_lidar(self, lidar: Lidar, t_s: float) -> Height | None:
        if lidar.range_m is None or lidar.range_m < MIN_RANGE_M:
            return None
        cosine = 1.0
        if self._tilt is not None and abs(t_s - self._tilt[0]) <= FRESH_S:
            cosine = self._tilt[1]
        if cosine < math.cos(math.radians(TILT_LIMIT_DEG)):
            return None
        agl_m = lidar.range_m * cosine
        self._lidar_s = t_s
        if self._altitude is not None and abs(t_s - self._altitude[0]) <= FRESH_S:
            self._offsets.append(agl_m - self._altitude[1])
        return Height(agl_m, HeightSource.LIDAR)
