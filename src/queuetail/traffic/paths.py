"""Trajectories thinned to samples with a course: what the discovery of roads works on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.types import Bools, Floats, Ints

STEP_M = 5.0  # along the path; a standing vehicle adds no samples
COURSE_REACH = 2  # samples on both sides whose chord gives the course


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Ground points of one vehicle over time; it may begin and end anywhere."""

    times_s: Floats  # (k,)
    enu: Floats  # (k, 2)


@dataclass(frozen=True, slots=True)
class Samples:
    """Places and courses along all trajectories, each about `STEP_M` after the one before."""

    enu: Floats  # (n, 2)
    course: Floats  # (n, 2) unit vectors
    owner: Ints  # (n,) which trajectory

    def __len__(self) -> int:
        return len(self.owner)

    def where(self, mask: Bools) -> Samples:
        """Return the samples for which `mask` (n,) is true."""
        return Samples(self.enu[mask], self.course[mask], self.owner[mask])


def sample(trajectories: Sequence[Trajectory]) -> Samples:
    """Thin every trajectory to the means of its points over each `STEP_M` of way."""
    enu, course, owner = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    for index, trajectory in enumerate(trajectories):
        path = thin(trajectory.enu)
        if len(path) < 2:
            continue
        rows = np.arange(len(path))
        ahead = path[np.minimum(rows + COURSE_REACH, len(path) - 1)]
        chord = ahead - path[np.maximum(rows - COURSE_REACH, 0)]
        length = np.linalg.norm(chord, axis=1)
        kept = length > STEP_M / 2  # a path that turns back on itself has no course there
        enu.append(path[kept])
        course.append(chord[kept] / length[kept, None])
        owner.append(np.full(int(kept.sum()), index, np.int64))
    return Samples(np.concatenate(enu), np.concatenate(course), np.concatenate(owner))


def thin(points: Floats, step_m: float = STEP_M) -> Floats:
    """Return the means of consecutive points that lie within `step_m`, (k, 2) -> (m, 2)."""
    finite = points[np.isfinite(points).all(axis=1)]
    means: list[Floats] = []
    start = 0
    for i in range(1, len(finite)):
        dx, dy = finite[i] - finite[start]
        if dx * dx + dy * dy >= step_m * step_m:
            means.append(finite[start:i].mean(axis=0))
            start = i
    if len(finite):
        means.append(finite[start:].mean(axis=0))
    return np.array(means).reshape(-1, 2)


def extent_m(samples: Samples, owners: int) -> Floats:
    """Return how far each trajectory got from end to end of its samples, (owners,)."""
    lengths = np.zeros(owners)
    if not len(samples):
        return lengths
    bounds = np.flatnonzero(np.diff(samples.owner, prepend=-1, append=-1))
    for first, last in zip(bounds[:-1], bounds[1:] - 1, strict=True):
        moved = np.linalg.norm(samples.enu[last] - samples.enu[first])
        lengths[samples.owner[first]] = moved
    return lengths
