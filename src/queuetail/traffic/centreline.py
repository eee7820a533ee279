"""A smooth curve along the traffic: traced along its courses, then fitted to its places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.traffic.paths import Samples
from queuetail.traffic.road import locate
from queuetail.types import Approach, Floats, Ints

TRACE_STEP_M = 5.0
TRACE_REACH_M = 15.0  # whose courses count at a place, along the road
TRACE_ASIDE_M = 10.0  # and across it
TURN_COS = float(np.cos(np.radians(30.0)))
MAX_GAP_M = 40.0  # of traffic-free road that the trace crosses straight on
MAX_STEPS = 2000
NODE_M = 10.0
# Standard deviations of a correction's second difference over `NODE_M`: of a traced curve, and of
# one of uniform curvature, which roads nearly have as far as a camera sees.
TRACED_BEND_M, UNIFORM_BEND_M = 0.15, 0.02
END_M, TIGHTEST_M = 75.0, 120.0  # of a curve, that say how it goes on, and its radius there
HUBER = 1.5
FIT_ROUNDS = 4


def trace(samples: Samples, start: Floats, course: Floats) -> Floats:
    """Follow the traffic's course both ways from a place, -> (k, 2) in the direction of travel."""
    ahead = _follow(samples, start, course, 1.0)
    behind = _follow(samples, start, course, -1.0)
    return np.array([*behind[::-1], start, *ahead])


def _follow(samples: Samples, start: Floats, course: Floats, sign: float) -> list[Floats]:
    points: list[Floats] = []
    place, unit, barren = start, course, 0
    for _ in range(MAX_STEPS):
        # The course half a step on is that of the chord: no lag in a bend.
        local = _course_at(samples, place + sign * unit * TRACE_STEP_M / 2, unit)
        barren = barren + 1 if local is None else 0
        unit = unit if local is None else local
        if barren * TRACE_STEP_M > MAX_GAP_M:
            break
        place = place + sign * unit * TRACE_STEP_M
        points.append(place)
    return points[: len(points) - barren]


def _course_at(samples: Samples, place: Floats, unit: Floats) -> Floats | None:
    """Return the median course near `place` of those who go about `unit`'s way, if any."""
    gap = samples.enu - place
    along = gap @ unit
    aside = unit[0] * gap[:, 1] - unit[1] * gap[:, 0]
    turn_sin = unit[0] * samples.course[:, 1] - unit[1] * samples.course[:, 0]
    near = (np.abs(along) < TRACE_REACH_M) & (np.abs(aside) < TRACE_ASIDE_M)
    near &= samples.course @ unit > TURN_COS
    if not near.any() or not (np.abs(along[near]) < TRACE_STEP_M).any():
        return None
    angle = float(np.median(np.arcsin(turn_sin[near])))
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * unit[0] - s * unit[1], s * unit[0] + c * unit[1]])


def uniform(curve: Floats) -> Floats:
    """Return the curve of one curvature that fits a traced one best, (k, 2) -> (k, 2)."""
    legs = np.diff(curve, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    at = stations(curve)
    middle = (at[1:] + at[:-1]) / 2
    heading = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    slope, start = np.polyfit(middle, heading, 1) if len(legs) > 2 else (0.0, heading.mean())
    units = np.column_stack([np.cos(start + slope * middle), np.sin(start + slope * middle)])
    places = np.concatenate([[[0.0, 0.0]], np.cumsum(units * lengths[:, None], axis=0)])
    return np.asarray(places + (curve - places).mean(axis=0))


def stations(curve: Floats) -> Floats:
    """Return how far along a polyline each of its points lies, (k, 2) -> (k,)."""
    legs = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(legs)])


def shift_aside(curve: Floats, offset_m: Floats | float) -> Floats:
    """Return the curve (k, 2) moved to its left by an offset, one for all or one per point."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    left = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    return np.asarray(curve + left * np.reshape(offset_m, (-1, 1)))


def resample(curve: Floats, spacing_m: float) -> Floats:
    """Return points about `spacing_m` apart along a polyline, both ends kept, (k, 2) -> (m, 2)."""
    station = stations(curve)
    count = max(2, round(float(station[-1]) / spacing_m) + 1)
    wanted = np.linspace(0.0, station[-1], count)
    return np.column_stack([np.interp(wanted, station, curve[:, i]) for i in (0, 1)])


def onward(curve: Floats, length_m: float, spacing_m: float) -> Floats:
    """Return points beyond the last of a polyline, turning as its end does, (k, 2) -> (m, 2)."""
    legs = np.diff(curve, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    to_end = np.cumsum(lengths[::-1])[::-1] - lengths / 2
    end = to_end <= max(END_M, float(to_end[-2:].max()))
    heading = np.unwrap(np.arctan2(legs[end, 1], legs[end, 0]))
    turn = float(np.polyfit(-to_end[end], heading, 1)[0]) if end.sum() > 1 else 0.0
    turn = float(np.clip(turn, -1 / TIGHTEST_M, 1 / TIGHTEST_M))
    last = float(heading.mean() + turn * to_end[end].mean())
    at = spacing_m * (np.arange(round(length_m / spacing_m)) + 0.5)
    units = np.column_stack([np.cos(last + turn * at), np.sin(last + turn * at)])
    return np.asarray(curve[-1] + np.cumsum(spacing_m * units, axis=0))


@dataclass(frozen=True, slots=True)
class Kept:
    """Places in groups that keep one offset along the road each: vehicles in lanes, and lines."""

    enu: Floats  # (n, 2)
    group: Ints  # (n,)
    noise_m: Floats  # (n,) of a place across the road
    mean_m: Floats  # (groups,) what is known of their offsets before,
    sigma_m: Floats  # (groups,) and how well


def together(parts: Sequence[Kept]) -> Kept:
    """Return the groups of several as one."""
    before = np.cumsum([0, *(len(p.mean_m) for p in parts)])
    return Kept(
        np.concatenate([p.enu for p in parts]),
        np.concatenate([p.group + n for p, n in zip(parts, before, strict=False)]),
        np.concatenate([p.noise_m for p in parts]),
        np.concatenate([p.mean_m for p in parts]),
        np.concatenate([p.sigma_m for p in parts]),
    )


def fit(curve: Floats, kept: Kept, bend_m: float = TRACED_BEND_M) -> tuple[Floats, float]:
    """Bend the curve until every group of places keeps one offset; -> curve, misfit in metres.

    Robust least squares over the curve's lateral correction at nodes and the groups' offsets at
    once, the correction's second difference held small.
    """
    nodes = resample(curve, NODE_M)
    station, offset, _ = locate(Approach("", nodes), kept.enu)
    k, g = len(nodes), len(kept.mean_m)
    at = np.interp(station, stations(nodes), np.arange(k))
    low = np.minimum(at.astype(np.int64), k - 2)
    share = at - low
    second = np.diff(np.eye(k), n=2, axis=0)
    stiff = second.T @ second / bend_m**2 + np.eye(k) * 1e-4
    bend: Floats = np.zeros(k)
    r: Floats = np.zeros(len(station))
    for _ in range(FIT_ROUNDS):
        noise_m = kept.noise_m
        weight = noise_m**-2 * np.minimum(1.0, HUBER * noise_m / np.maximum(np.abs(r), 1e-9))
        cells = _Cells(low, share, kept.group, weight, k, g)
        # The groups' offsets are eliminated (Schur): theirs is a diagonal block.
        diagonal = cells.own + kept.sigma_m**-2.0
        right_own = np.bincount(kept.group, weight * offset, g) + kept.mean_m / kept.sigma_m**2
        scaled = cells.mixed / diagonal
        normal = cells.bend + stiff - scaled @ cells.mixed.T
        rhs = cells.spread(weight * offset) - scaled @ right_own
        bend = np.asarray(np.linalg.solve(normal, rhs), np.float64)
        own = (right_own - cells.mixed.T @ bend) / diagonal
        r = offset - (1 - share) * bend[low] - share * bend[low + 1] - own[kept.group]
    return shift_aside(nodes, bend), float(np.minimum(np.abs(r), 1.0).mean())


class _Cells:
    """Blocks of the normal equations of hat functions at nodes and one constant per group."""

    def __init__(
        self, low: Ints, share: Floats, group: Ints, weight: Floats, nodes: int, groups: int
    ) -> None:
        self._low, self._share, self._nodes = low, share, nodes
        left, right = 1 - share, share
        self.own: Floats = np.asarray(np.bincount(group, weight, groups))  # its diagonal
        self.mixed: Floats = np.zeros((nodes, groups))
        np.add.at(self.mixed, (low, group), weight * left)
        np.add.at(self.mixed, (low + 1, group), weight * right)
        self.bend: Floats = np.diag(self._sum(weight * left**2, weight * right**2))
        beside = np.bincount(low, weight * left * right, nodes)[:-1]
        self.bend += np.diag(beside, 1) + np.diag(beside, -1)

    def spread(self, values: Floats) -> Floats:
        """Return the samples' values summed at the nodes on both sides of each, (nodes,)."""
        return self._sum(values * (1 - self._share), values * self._share)

    def _sum(self, left: Floats, right: Floats) -> Floats:
        below = np.bincount(self._low, left, self._nodes)
        return np.asarray(below + np.bincount(self._low + 1, right, self._nodes))
