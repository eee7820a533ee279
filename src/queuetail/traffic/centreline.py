"""A smooth curve along the traffic: traced along its courses, then fitted to its places."""

from __future__ import annotations

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
NOISE_M = 0.5  # of a sample across the road
# Standard deviations of a correction's second difference over `NODE_M`: of a traced curve, and of
# one of uniform curvature, which roads nearly have as far as a camera sees.
TRACED_BEND_M, UNIFORM_BEND_M = 0.15, 0.02
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
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    middle = (at[1:] + at[:-1]) / 2
    heading = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
    slope, start = np.polyfit(middle, heading, 1) if len(legs) > 2 else (0.0, heading.mean())
    units = np.column_stack([np.cos(start + slope * middle), np.sin(start + slope * middle)])
    places = np.concatenate([[[0.0, 0.0]], np.cumsum(units * lengths[:, None], axis=0)])
    return np.asarray(places + (curve - places).mean(axis=0))


def shift_aside(curve: Floats, offset_m: Floats | float) -> Floats:
    """Return the curve (k, 2) moved to its left by an offset, one for all or one per point."""
    tangent = np.gradient(curve, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    left = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    return np.asarray(curve + left * np.reshape(offset_m, (-1, 1)))


def resample(curve: Floats, spacing_m: float) -> Floats:
    """Return points about `spacing_m` apart along a polyline, both ends kept, (k, 2) -> (m, 2)."""
    legs = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    station = np.concatenate([[0.0], np.cumsum(legs)])
    count = max(2, round(float(station[-1]) / spacing_m) + 1)
    wanted = np.linspace(0.0, station[-1], count)
    return np.column_stack([np.interp(wanted, station, curve[:, i]) for i in (0, 1)])


def fit(
    curve: Floats,
    samples: Samples,
    group: Ints,
    mean_m: Floats,
    sigma_m: Floats,
    bend_m: float = TRACED_BEND_M,
) -> tuple[Floats, float]:
    """Bend the curve until every group of samples keeps one offset; -> curve, misfit in metres.

    `group` (n,) says which samples belong together, and `mean_m` and `sigma_m` (groups,) what is
    known of their offsets before.  Robust least squares over the curve's lateral correction at
    nodes and the groups' offsets at once, the correction's second difference held small.
    """
    nodes = resample(curve, NODE_M)
    station, offset, _ = locate(Approach("", nodes), samples.enu)
    k, g = len(nodes), len(mean_m)
    lengths = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    at = np.interp(station, np.concatenate([[0.0], np.cumsum(lengths)]), np.arange(k))
    low = np.minimum(at.astype(np.int64), k - 2)
    A = np.zeros((len(station), k + g))
    rows = np.arange(len(station))
    A[rows, low], A[rows, low + 1], A[rows, k + group] = 1 - (at - low), at - low, 1.0
    normal0, rhs0 = _prior(k, mean_m, sigma_m, bend_m)
    solution = np.zeros(k + g)
    weight = np.full(len(station), NOISE_M**-2)
    for _ in range(FIT_ROUNDS):
        weighted = A * weight[:, None]
        solution = np.linalg.solve(weighted.T @ A + normal0, weighted.T @ offset + rhs0)
        r = np.abs(offset - A @ solution) / NOISE_M
        weight = NOISE_M**-2 * np.minimum(1.0, HUBER / np.maximum(r, 1e-9))
    misfit = float(np.minimum(np.abs(offset - A @ solution), 1.0).mean())
    return shift_aside(nodes, solution[:k]), misfit


def _prior(nodes: int, mean_m: Floats, sigma_m: Floats, bend_m: float) -> tuple[Floats, Floats]:
    """Return the normal equations of what is known without samples."""
    second = np.diff(np.eye(nodes), n=2, axis=0)
    normal = np.zeros((nodes + len(mean_m),) * 2)
    normal[:nodes, :nodes] = second.T @ second / bend_m**2 + np.eye(nodes) * 1e-4
    normal[nodes:, nodes:] = np.diag(sigma_m**-2.0)
    return normal, np.concatenate([np.zeros(nodes), mean_m / sigma_m**2])
