"""A site's road and the vehicles seen brought together: the bias of telemetry, from traffic.

Telemetry is off by metres and degrees, and so is everything that is located by it.  Vehicles keep
to the middles of lanes; the small motion of the plane that puts their trajectories there is the
correction.  Where it could be one lane to the side as well, a prior decides and sigma says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.traffic.paths import STEP_M, Samples, Trajectory, extent_m, sample
from queuetail.traffic.road import locate
from queuetail.types import Approach, Bools, Floats, Ints

MIN_VEHICLES, MIN_MOVED_M = 4, 25.0
MIN_AGREEING = 0.6  # of the vehicles that drive along the road at all
AGREES = 0.35  # of a lane's width from its centre
SHIFT_SIGMA_M, ROTATION_SIGMA_DEG, SCALE_SIGMA = 3.0, 2.0, 0.02
VEHICLE_SIGMA_M = 0.45  # lane keeping, and placing a vehicle's middle
WANDER_M = 40.0  # a vehicle's offset is one and the same over about this way
WORST = 9.0  # squared sigmas: a stray counts for no more
REACH_M = 12.0  # beside the lanes
SHIFTS_M = np.arange(-9.0, 9.01, 0.3)
ROTATIONS_DEG = np.arange(-5.0, 5.01, 0.25)
SEARCH_SAMPLES = 300
ROUNDS = 8
SAME_WAY_COS = float(np.cos(np.radians(30.0)))
OTHER_MODE_M = 1.5
FLOOR_M, FLOOR_DEG = 0.1, 0.05  # what lanes painted and driven are never surer of


@dataclass(frozen=True, slots=True)
class Alignment:
    """The correction of places: true ENU = A_true_enu @ (east, north, 1)."""

    A_true_enu: Floats  # (2, 3)
    rotation_deg: float  # anticlockwise
    rotation_sigma_deg: float
    shift_m: float  # of the traffic's middle, to the left of the road
    shift_sigma_m: float
    residual_m: float  # root mean square of the vehicles' distances to lane centres, after
    vehicles: int  # that agree

    def apply(self, enu: Floats) -> Floats:
        """Return points corrected, (n, 2) -> (n, 2)."""
        return np.asarray(enu @ self.A_true_enu[:, :2].T + self.A_true_enu[:, 2])


@dataclass(frozen=True, slots=True)
class _Lateral:
    """Where samples lie across the road: distance to the nearest lane centre, and what moves it."""

    miss_m: Floats  # (n,) to the left of the lane's centre; NaN for those on no approach
    left: Floats  # (n, 2) unit vectors across the road
    width_m: Floats  # (n,) of the lane


def align(
    approaches: Sequence[Approach],
    trajectories: Sequence[Trajectory],
    camera_enu: Floats | None = None,
) -> Alignment | None:
    """Return the motion that brings the trajectories into the lanes; None until enough agree.

    `camera_enu` is the ground point below the camera, which a wrong heading turns the picture
    about; without it the middle of the traffic is taken.
    """
    seen = sample(trajectories)
    far = extent_m(seen, len(trajectories)) >= MIN_MOVED_M
    seen = seen.where(far[seen.owner]) if len(seen) else seen
    if not approaches or int(far.sum()) < MIN_VEHICLES:
        return None
    pivot = seen.enu.mean(axis=0) if camera_enu is None else np.asarray(camera_enu, float)
    start, modes_m2 = _search(approaches, seen, pivot)
    if start is None:
        return None
    solution, covariance = _refine(approaches, seen, pivot, start)
    return _alignment(approaches, seen, pivot, solution, covariance, modes_m2)


def _alignment(
    approaches: Sequence[Approach],
    seen: Samples,
    pivot: Floats,
    solution: Floats,
    covariance: Floats,
    modes_m2: float,
) -> Alignment | None:
    A = _affine(solution, pivot, _across(seen))
    lateral = _lateral(approaches, _moved(seen, A), REACH_M)
    known = np.isfinite(lateral.miss_m)
    vehicles, owner = np.unique(seen.owner[known], return_inverse=True)
    count = np.bincount(owner)
    mean = np.bincount(owner, lateral.miss_m[known]) / count
    width = np.bincount(owner, lateral.width_m[known]) / count
    agree = np.abs(mean) < AGREES * width
    if agree.sum() < MIN_VEHICLES or agree.sum() < MIN_AGREEING * len(vehicles):
        return None
    middle = seen.enu.mean(axis=0)
    left = _across(seen)
    J = _jacobian(middle[None], left[None], pivot, left)[0]
    shift_m = float((A[:, :2] @ middle + A[:, 2] - middle) @ left)
    return Alignment(
        A_true_enu=A,
        rotation_deg=float(np.degrees(solution[0])),
        rotation_sigma_deg=float(np.hypot(np.degrees(np.sqrt(covariance[0, 0])), FLOOR_DEG)),
        shift_m=shift_m,
        shift_sigma_m=float(np.sqrt(J @ covariance @ J + modes_m2 + FLOOR_M**2)),
        residual_m=float(np.sqrt((mean[agree] ** 2).mean())),
        vehicles=int(agree.sum()),
    )


def _search(
    approaches: Sequence[Approach], seen: Samples, pivot: Floats
) -> tuple[Floats | None, float]:
    """Try shifts across the road and rotations; -> the best, and the variance by other modes."""
    some = seen.where(np.arange(len(seen)) % max(len(seen) // SEARCH_SAMPLES, 1) == 0)
    across = _across(seen)
    rotations = np.radians(ROTATIONS_DEG)
    shift, turn = (g.ravel() for g in np.meshgrid(SHIFTS_M, rotations, indexing="ij"))
    # Shifts are those at the traffic's middle, whatever the turn about the pivot does there.
    arm = _turned(seen.enu.mean(axis=0) - pivot) @ across
    at_pivot = shift - turn * arm
    best = np.full((len(shift), len(some)), WORST)
    for approach in approaches:
        offset, left, along = _offsets(approach, some)
        used = along & (np.abs(offset) < REACH_M + np.abs(SHIFTS_M).max() + _width(approach))
        if not used.any():
            continue
        lever = (_turned(some.enu - pivot) * left).sum(axis=1)
        moved = offset + at_pivot[:, None] * (left @ across) + turn[:, None] * lever
        cost = np.minimum((_miss(approach, moved) / VEHICLE_SIGMA_M) ** 2, WORST)
        best = np.where(used, np.minimum(best, cost), best)
    if (best == WORST).all():
        return None, 0.0
    evidence = STEP_M / WANDER_M * len(seen) / len(some)
    total = evidence * best.sum(axis=1) + (at_pivot / SHIFT_SIGMA_M) ** 2
    total += (np.degrees(turn) / ROTATION_SIGMA_DEG) ** 2
    chosen = int(np.argmin(total))
    likelihood = np.exp(-(total - total[chosen]) / 2)
    away = shift - shift[chosen]
    other = np.abs(away) > OTHER_MODE_M
    modes_m2 = float((likelihood * away**2)[other].sum() / likelihood.sum())
    return np.array([turn[chosen], *(at_pivot[chosen] * across), 0.0]), modes_m2


def _refine(
    approaches: Sequence[Approach], seen: Samples, pivot: Floats, start: Floats
) -> tuple[Floats, Floats]:
    """Gauss–Newton with Huber weights over turn, shift and scale across; -> them, covariance."""
    across = _across(seen)
    prior = np.diag(
        [
            np.radians(ROTATION_SIGMA_DEG) ** -2.0,
            SHIFT_SIGMA_M**-2.0,
            SHIFT_SIGMA_M**-2.0,
            SCALE_SIGMA**-2.0,
        ]
    )
    solution, normal = start, prior
    for _ in range(ROUNDS):
        moved = _moved(seen, _affine(solution, pivot, across))
        lateral = _lateral(approaches, moved, REACH_M)
        used = np.isfinite(lateral.miss_m) & (np.abs(lateral.miss_m) < 4 * VEHICLE_SIGMA_M)
        miss = lateral.miss_m[used]
        J = _jacobian(moved.enu[used], lateral.left[used], pivot, across)
        weight = np.minimum(1.0, 1.5 * VEHICLE_SIGMA_M / np.maximum(np.abs(miss), 1e-9))
        weight *= STEP_M / WANDER_M / VEHICLE_SIGMA_M**2
        normal = (J * weight[:, None]).T @ J + prior
        step = np.linalg.solve(normal, -(J * weight[:, None]).T @ miss - prior @ solution)
        solution = solution + step
    return solution, np.linalg.inv(normal)


def _lateral(approaches: Sequence[Approach], seen: Samples, reach_m: float) -> _Lateral:
    n = len(seen)
    miss, left, width = np.full(n, np.nan), np.zeros((n, 2)), np.full(n, np.nan)
    for approach in approaches:
        offset, here, along = _offsets(approach, seen)
        own = _miss(approach, offset)
        better = along & (np.abs(own) < reach_m)
        better &= ~(np.abs(own) >= np.abs(miss))  # NaN: nothing found before
        miss[better], left[better] = own[better], here[better]
        width[better] = approach.lane_width_m
    return _Lateral(miss, left, width)


def _offsets(approach: Approach, seen: Samples) -> tuple[Floats, Floats, Bools]:
    """Return offsets, unit vectors to the left, and who drives along the approach, its way."""
    station, offset, course = locate(approach, seen.enu)
    length = float(np.linalg.norm(np.diff(approach.axis_enu, axis=0), axis=1).sum())
    station = station - approach.start_station_m
    beside = (station > 0.0) & (station < length)
    same_way = (course * seen.course).sum(axis=1) > SAME_WAY_COS
    return offset, _turned(course), np.asarray(beside & same_way)


def _miss(approach: Approach, offset_m: Floats) -> Floats:
    """Return how far to the left of the nearest lane's centre offsets lie, of any shape."""
    lane: Ints = np.floor(-offset_m / approach.lane_width_m).astype(np.int64)
    lane = np.clip(lane, 0, approach.lanes - 1)
    return np.asarray(offset_m + (lane + 0.5) * approach.lane_width_m)


def _width(approach: Approach) -> float:
    return approach.lanes * approach.lane_width_m


def _across(seen: Samples) -> Floats:
    """Return the unit vector across the road most went along, to the left of its first vehicle."""
    axis = np.linalg.eigh(seen.course.T @ seen.course)[1][:, -1]
    sign = 1.0 if seen.course[0] @ axis > 0 else -1.0
    return _turned(sign * axis)


def _turned(vectors: Floats) -> Floats:
    """Return vectors (..., 2) turned 90° to the left."""
    return np.stack([-vectors[..., 1], vectors[..., 0]], axis=-1)


def _affine(solution: Floats, pivot: Floats, across: Floats) -> Floats:
    turn, shift, scale = solution[0], solution[1:3], solution[3]
    c, s = np.cos(turn), np.sin(turn)
    linear = np.array([[c, -s], [s, c]]) @ (np.eye(2) + scale * np.outer(across, across))
    return np.column_stack([linear, pivot + shift - linear @ pivot])


def _moved(seen: Samples, A: Floats) -> Samples:
    return Samples(seen.enu @ A[:, :2].T + A[:, 2], seen.course @ A[:, :2].T, seen.owner)


def _jacobian(enu: Floats, left: Floats, pivot: Floats, across: Floats) -> Floats:
    """Return what moves points (n, 2) along `left` (n, 2): turn, shift east and north, scale."""
    arm = enu - pivot
    scaled = (arm @ across) * (left @ across)
    return np.column_stack([(_turned(arm) * left).sum(axis=1), left, scaled])
