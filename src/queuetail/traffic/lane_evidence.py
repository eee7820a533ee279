"""What shows where the lanes are: vehicles keep to their middles, painted lines are their edges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from queuetail.traffic.paths import STEP_M, Trajectory, extent_m, sample
from queuetail.traffic.road import length_m, locate
from queuetail.types import Approach, Bools, Floats, Ints

MIN_MOVED_M = 25.0
VEHICLE_SIGMA_M = 0.45  # lane keeping, and placing a vehicle's middle
WANDER_M = 40.0  # a vehicle's offset, and what disturbs a line, is the same over about this way
WINDOW_M = 12.0  # of road for a mark: a dash and its gap
SAME_WAY_COS = float(np.cos(np.radians(30.0)))
NO_VEHICLE = -1
MAD_SIGMA = 1.4826  # sigmas to a median absolute deviation


@dataclass(frozen=True, slots=True)
class LineMarks:
    """Places where a painted line was seen, one for each `WINDOW_M` that it runs through."""

    enu: Floats  # (n, 2)
    course: Floats  # (n, 2) unit vectors along the road

    def __len__(self) -> int:
        return len(self.enu)

    def where(self, chosen: Bools) -> LineMarks:
        """Return what is chosen, (n,)."""
        return LineMarks(self.enu[chosen], self.course[chosen])


NO_MARKS = LineMarks(np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True, slots=True)
class LaneEvidence:
    """Samples of vehicles' paths, which belong in lanes, and marks, which belong on their edges."""

    enu: Floats  # (n, 2)
    course: Floats  # (n, 2) unit vectors
    owner: Ints  # (n,) which vehicle; NO_VEHICLE for a mark
    weight: Floats  # (n,) how many independent observations it is worth

    def __len__(self) -> int:
        return len(self.owner)

    @property
    def is_mark(self) -> Bools:
        """Tell which are painted lines, (n,)."""
        return np.asarray(self.owner == NO_VEHICLE)

    @property
    def vehicles(self) -> int:
        """Return how many vehicles there are."""
        return len(np.unique(self.owner[~self.is_mark]))

    def where(self, chosen: Bools) -> LaneEvidence:
        """Return what is chosen, (n,)."""
        return LaneEvidence(
            self.enu[chosen], self.course[chosen], self.owner[chosen], self.weight[chosen]
        )

    def thinned(self, most: int) -> LaneEvidence:
        """Return at most so many of each kind, evenly chosen, that together weigh the same."""
        weight, chosen = self.weight.copy(), np.zeros(len(self), np.bool_)
        for kind in (self.is_mark, ~self.is_mark):
            rows = np.flatnonzero(kind)
            kept = rows[:: max(-(-len(rows) // most), 1)]
            chosen[kept] = True
            weight[kept] *= len(rows) / max(len(kept), 1)
        return replace(self, weight=weight).where(chosen)


@dataclass(frozen=True, slots=True)
class Lateral:
    """Where evidence lies across the road."""

    miss_m: Floats  # (n,) to the left of where it belongs; NaN where no approach is near
    left: Floats  # (n, 2) unit vectors across the road
    width_m: Floats  # (n,) of the lane


def gather(trajectories: Sequence[Trajectory], marks: LineMarks) -> LaneEvidence:
    """Return vehicles that moved far enough, and marks, weighted by the way that they cover."""
    paths = sample(trajectories)
    if len(paths):
        far = extent_m(paths, len(trajectories)) >= MIN_MOVED_M
        paths = paths.where(far[paths.owner])
    return LaneEvidence(
        np.concatenate([paths.enu, marks.enu]),
        np.concatenate([paths.course, marks.course]),
        np.concatenate([paths.owner, np.full(len(marks), NO_VEHICLE, np.int64)]),
        np.repeat([STEP_M / WANDER_M, WINDOW_M / WANDER_M], [len(paths), len(marks)]),
    )


def lateral(approaches: Sequence[Approach], seen: LaneEvidence, reach_m: float) -> Lateral:
    """Return how far everything is from the nearest place where it belongs, within reach."""
    n = len(seen)
    miss, left, width = np.full(n, np.nan), np.zeros((n, 2)), np.full(n, np.nan)
    for approach in approaches:
        offset, here, along = offsets(approach, seen)
        own = miss_m(approach, offset, seen.is_mark)
        better = along & (np.abs(own) < reach_m)
        better &= ~(np.abs(own) >= np.abs(miss))  # NaN: nothing found before
        miss[better], left[better] = own[better], here[better]
        width[better] = approach.lane_width_m
    return Lateral(miss, left, width)


def offsets(approach: Approach, seen: LaneEvidence) -> tuple[Floats, Floats, Bools]:
    """Return offsets, unit vectors to the left, and what may belong to the approach.

    That is what lies beside it: vehicles that drive its way, and lines along it.
    """
    station, offset, course = locate(approach, seen.enu)
    station = station - approach.start_station_m
    beside = (station > 0.0) & (station < length_m(approach))
    cos = (course * seen.course).sum(axis=1)
    cos = np.where(seen.is_mark, np.abs(cos), cos)
    return offset, turned(course), np.asarray(beside & (cos > SAME_WAY_COS))


def ways(approach: Approach, seen: LaneEvidence, beside_m: float = 0.0) -> tuple[int, int]:
    """Return how many vehicles drive along the approach and against it, in or near its lanes."""
    station, offset, course = locate(approach, seen.enu)
    station = station - approach.start_station_m
    width_m = approach.lanes * approach.lane_width_m
    near = (offset < beside_m) & (offset > -width_m - beside_m) & ~seen.is_mark
    near &= (station > 0.0) & (station < length_m(approach))
    cos = (course * seen.course).sum(axis=1)
    along, against = (near & (way * cos > SAME_WAY_COS) for way in (1, -1))
    return len(np.unique(seen.owner[along])), len(np.unique(seen.owner[against]))


def miss_m(approach: Approach, offset_m: Floats, is_mark: Bools) -> Floats:
    """Return how far to the left of a lane's middle, or of its edge, offsets (..., n) lie."""
    width = approach.lane_width_m
    middle = np.clip(np.floor(-offset_m / width), 0, approach.lanes - 1) + 0.5
    edge = np.clip(np.round(-offset_m / width), 0, approach.lanes)
    return np.asarray(offset_m + np.where(is_mark, edge, middle) * width)


def turned(vectors: Floats) -> Floats:
    """Return vectors (..., 2) turned 90° to the left."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)
