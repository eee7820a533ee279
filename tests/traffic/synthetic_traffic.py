"""Made traffic on roads of known geometry."""

from __future__ import annotations

import math

import numpy as np

from queuetail.traffic.paths import Trajectory
from queuetail.traffic.road import place
from queuetail.types import Approach, Floats


def road(
    radius_m: float = math.inf,
    length_m: float = 250.0,
    lanes: int = 2,
    width_m: float = 3.5,
    course_deg: float = 40.0,
    start: tuple[float, float] = (12.0, -30.0),
) -> Approach:
    """An approach of constant curvature (positive radius turns left), true to the millimetre."""
    s = np.arange(0.0, length_m + 0.5, 1.0)
    heading = math.radians(90.0 - course_deg) + (0 * s if math.isinf(radius_m) else s / radius_m)
    steps = np.column_stack([np.cos(heading), np.sin(heading)])
    axis = np.concatenate([[[0.0, 0.0]], np.cumsum((steps[1:] + steps[:-1]) / 2, axis=0)])
    return Approach("true", axis + np.array(start), 0.0, lanes, width_m)


def opposite(approach: Approach, median_m: float) -> Approach:
    """The carriageway that comes the other way, `median_m` to the left."""
    axis = approach.axis_enu
    tangent = np.gradient(axis, axis=0)
    left = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    other = (axis + median_m * left)[::-1]
    return Approach("other", other, 0.0, approach.lanes, approach.lane_width_m)


def drive(
    approach: Approach,
    rng: np.random.Generator,
    vehicles: int = 12,
    noise_m: float = 0.4,
    from_to_m: tuple[float, float] | None = None,
    fragment: float = 1.0,
    changing: float = 0.0,
) -> list[Trajectory]:
    """Vehicles in all lanes in turn, keeping to them within 0.3 m, seen six times a second."""
    length = float(np.linalg.norm(np.diff(approach.axis_enu, axis=0), axis=1).sum())
    low, high = from_to_m or (0.0, length)
    seen = []
    for i in range(vehicles):
        part = (high - low) * rng.uniform(fragment, 1.0)
        begin = low + rng.uniform(0.0, high - low - part)
        speed = rng.uniform(6.0, 25.0)
        t = np.arange(0.0, part / speed, 1 / 6)
        station = begin + speed * t
        lane = i % approach.lanes
        target = lane
        if approach.lanes > 1 and rng.uniform() < changing:
            target = lane + 1 if lane + 1 < approach.lanes else lane - 1
        share = np.clip((station - begin - part * 0.4) / 60.0, 0.0, 1.0)
        across = lane + (target - lane) * (3 * share**2 - 2 * share**3) + 0.5
        offset = -across * approach.lane_width_m + rng.normal(0.0, 0.25)
        points = place(approach, station, offset) + rng.normal(0.0, noise_m, (len(t), 2))
        seen.append(Trajectory(t + i * 2.0, points))
    return seen


def strays(rng: np.random.Generator, count: int, around: Floats) -> list[Trajectory]:
    """Things that go somewhere of their own, slowly and crookedly."""
    out = []
    for _ in range(count):
        heading = rng.uniform(0, 2 * math.pi) + np.cumsum(rng.normal(0.0, 0.15, 60))
        steps = 1.0 * np.column_stack([np.cos(heading), np.sin(heading)])
        start = around[rng.integers(len(around))] + rng.normal(0.0, 15.0, 2)
        out.append(Trajectory(np.arange(60) / 6.0, start + np.cumsum(steps, axis=0)))
    return out
