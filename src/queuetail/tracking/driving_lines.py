"""Where across its lane the traffic drives: what stands beside that line stands beside the road.

A site's lanes may lie a metre or two aside until they are aligned to what is seen, and cars that
are parked on the shoulder then seem to stand in a lane.
"""

from __future__ import annotations

from collections.abc import Iterable

from queuetail.tracking.lane_vehicle import DRIVING_MPS, LaneVehicle

RATE, MEASUREMENTS = 0.02, 40  # how fast a line is learnt, and after how many it is known
ASIDE_M = 1.4  # from the line: half of a lane's width is about 1.8 m


class DrivingLines:
    """The mean offset of those who drive in each lane."""

    def __init__(self) -> None:
        self._offset_m: dict[tuple[int, int], tuple[float, int]] = {}

    def learn(self, vehicles: Iterable[LaneVehicle], t_s: float) -> None:
        """Take in where those vehicles are that were seen driving at `t_s`."""
        for v in vehicles:
            if not (v.confirmed and v.moved and v.seen_s == t_s) or v.astride:
                continue
            if v.speed_mps > DRIVING_MPS:
                offset_m, count = self._offset_m.get((v.approach, v.lane), (0.0, 0))
                rate = max(RATE, 1.0 / (count + 1))
                offset_m += rate * (v.offset_m - offset_m)
                self._offset_m[v.approach, v.lane] = offset_m, count + 1

    def is_aside(self, thing: LaneVehicle) -> bool:
        """Tell whether something is beside where the traffic of its lane is known to drive."""
        offset_m, count = self._offset_m.get((thing.approach, thing.lane), (0.0, 0))
        return count >= MEASUREMENTS and abs(thing.offset_m - offset_m) > ASIDE_M
