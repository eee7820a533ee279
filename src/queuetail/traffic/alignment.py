"""A site's road and what is seen of it brought together: the bias of telemetry.

Telemetry is off by metres and degrees, and so is everything that is located by it.  Vehicles keep
to the middles of lanes, paint lies on their edges, and the asphalt ends as far out all along them;
the small motion of the camera that puts all of them there is the correction.  Where it could be one
lane to the side as well, sigma says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from queuetail.geo.ground import apply_homography
from queuetail.traffic.lane_evidence import (
    MAD_SIGMA,
    VEHICLE_SIGMA_M,
    LaneEvidence,
    Lateral,
    lateral,
    miss_m,
    offsets,
    turned,
    ways,
)
from queuetail.traffic.verges import (
    NO_VERGES,
    SHOULDER_M,
    SHOULDER_SIGMA_M,
    SIGMA_M,
    Trials,
    Verges,
    beside_cost,
    misses,
)
from queuetail.types import Approach, Floats

MIN_VEHICLES, MIN_MARKS = 4, 6  # of either one or the other
MIN_AGREEING = 0.6  # of the vehicles that are on the road at all
MIN_MARKS_AGREEING = 0.55  # the other carriageway and the shoulders have lines of their own,
MARKS_AGREEING_IN_VERGES = 0.3  # fewer will do where most of the asphalt's ends agree
MIN_VERGES, MIN_VERGES_AGREEING, VERGE_AGREES_M = 6, 0.5, 0.3  # stretches of an approach
FEW = 4  # vehicles and marks together, which will do with them
MANY_VEHICLES, NEARLY_ALL = 12, 0.85  # of the vehicles
MIN_WRONG_WAY = 3  # vehicles, for lines to lie on other lanes than they fit
VEHICLE_AGREES, MARK_AGREES = 0.35, 0.12  # of a lane's width from where it belongs
SHIFT_SIGMA_M, ROTATION_SIGMA_DEG, SCALE_SIGMA, TILT_SIGMA = 2.5, 1.2, 0.01, 0.015
VEHICLES_SHARE_M = 0.2  # how far aside all vehicles may seem to be, for shadow or lean
MARK_SIGMA_M = (0.35, 0.35, 0.35, 0.25, 0.15, 0.1)  # from the search, on to the last round
WORST = 9.0  # squared sigmas: a stray counts for no more
REACH_M = 12.0  # beside the lanes
SHIFTS_M = np.arange(-9.0, 9.01, 0.3)
ROTATIONS_DEG = np.arange(-5.0, 5.01, 0.25)
SAMPLES, SEARCH_SAMPLES = 600, 150  # of each kind, at the most
SEARCH_VEHICLES = 6.0  # what many vehicles are worth that share a bias
SHARPEST_M = 0.1  # sigma of where asphalt ends
ROUNDS = 10
OTHER_MODE_M = 1.5
FLOOR_M, FLOOR_DEG = 0.1, 0.05  # what lanes painted and driven are never surer of
MOST = 0.95  # of the evidence
TURN, SHIFT, SCALE, TILT, SHARED, ENDS = 0, slice(1, 3), 3, slice(4, 6), slice(6, 8), slice(8, None)


@dataclass(frozen=True, slots=True)
class Camera:
    """Where the camera is by telemetry: what a wrong heading and pitch turn the picture about."""

    foot_enu: Floats  # (2,) the ground below it
    height_m: float


@dataclass(frozen=True, slots=True)
class Alignment:
    """The correction of places: true ENU = H_true_enu applied to ENU."""

    H_true_enu: Floats  # (3, 3)
    rotation_deg: float  # anticlockwise
    rotation_sigma_deg: float
    tilt_deg: float  # of the ground against the camera: pitch and roll, or the road's own slope
    shift_m: float  # of the evidence's middle, to the left of the first approach
    shift_sigma_m: float
    move_m: float  # across the road, as far as most of the evidence moves
    move_sigma_m: float
    residual_m: float  # root mean square of the vehicles' distances to lane centres, after
    vehicles: int  # that agree
    marks: int  # that agree
    verges: int  # stretches of the asphalt's ends that agree

    def apply(self, enu: Floats) -> Floats:
        """Return points corrected, (n, 2) -> (n, 2)."""
        return apply_homography(self.H_true_enu, enu)


def align(
    approaches: Sequence[Approach],
    everything: LaneEvidence,
    camera: Camera,
    doubt_m: float = 0.0,
    verges: Verges = NO_VERGES,
) -> Alignment | None:
    """Return the motion that brings the evidence to the lanes; None until enough of it agrees.

    `doubt_m` is by how much shadows may set all vehicles aside; `verges` are where the asphalt may
    end, by the same mapping as the evidence.
    """
    seen = _beside(approaches, everything).thinned(SAMPLES)
    marks = int(seen.is_mark.sum())
    few = seen.vehicles + marks >= FEW and len(verges) > 0
    if not few and seen.vehicles < MIN_VEHICLES and marks < MIN_MARKS:
        return None
    start, modes_m2 = _search(approaches, seen, verges, camera)
    share_m = float(np.hypot(VEHICLES_SHARE_M, doubt_m))
    solution, covariance = _refine(approaches, seen, verges, camera, start, share_m)
    if _is_wrong_way(approaches, _moved(everything, solution, camera)):
        return None
    return _alignment(approaches, seen, verges, camera, solution, covariance, modes_m2)


def _beside(approaches: Sequence[Approach], seen: LaneEvidence) -> LaneEvidence:
    """Return what may belong to one of the approaches, however far telemetry is off."""
    near = np.zeros(len(seen), np.bool_)
    for approach in approaches:
        offset, _, along = offsets(approach, seen)
        reach_m = REACH_M + float(SHIFTS_M[-1]) + approach.lanes * approach.lane_width_m
        near |= along & (np.abs(offset) < reach_m)
    return seen.where(near)


def _alignment(
    approaches: Sequence[Approach],
    seen: LaneEvidence,
    verges: Verges,
    camera: Camera,
    solution: Floats,
    covariance: Floats,
    modes_m2: float,
) -> Alignment | None:
    placed = _moved(seen, solution, camera)
    found = lateral(approaches, placed, REACH_M)
    on_it = np.isfinite(found.miss_m)
    J = _jacobian(placed, found.left, solution, camera)
    found = replace(found, miss_m=found.miss_m + J[:, SHARED] @ solution[SHARED])
    vehicles, residual_m = _vehicles_that_agree(seen, found)
    marks = _marks_that_agree(seen, found)
    beside = replace(verges, seen=_moved(verges.seen, solution, camera))
    agreeing, in_verges = _verges_that_agree(approaches, beside, solution[ENDS])
    if not _is_believable(seen.where(on_it), vehicles, marks, in_verges):
        return None
    J[:, SHARED] = 0.0
    move = ((placed.enu - seen.enu) * found.left).sum(axis=1)[on_it]
    variance = np.einsum("ni,ij,nj->n", J[on_it], covariance, J[on_it]) + modes_m2 + FLOOR_M**2
    middle, left = _middle(approaches, seen)
    H = _homography(solution, camera)
    shift = apply_homography(H, middle[None])[0] - middle
    return Alignment(
        H_true_enu=H,
        rotation_deg=float(np.degrees(solution[TURN])),
        rotation_sigma_deg=float(np.hypot(np.degrees(np.sqrt(covariance[0, 0])), FLOOR_DEG)),
        tilt_deg=float(np.degrees(np.linalg.norm(solution[TILT]))),
        shift_m=float(shift @ left),
        shift_sigma_m=float(np.sqrt(np.median(variance))),
        move_m=float(np.quantile(np.abs(move), MOST)),
        move_sigma_m=float(np.sqrt(np.quantile(variance, MOST))),
        residual_m=residual_m,
        vehicles=vehicles,
        marks=marks,
        verges=agreeing,
    )


def _is_believable(on_road: LaneEvidence, vehicles: int, marks: int, in_verges: bool) -> bool:
    """Tell whether enough agrees, and of each kind most, where it is more than a few strays."""
    shown = int(on_road.is_mark.sum())
    enough = vehicles >= MIN_VEHICLES or marks >= MIN_MARKS
    enough |= in_verges and vehicles + marks >= FEW
    most_vehicles = vehicles >= MIN_AGREEING * on_road.vehicles
    least = MARKS_AGREEING_IN_VERGES if in_verges else MIN_MARKS_AGREEING
    most_marks = shown < MIN_MARKS or marks >= least * shown
    # Lines of other roads and of repairs lie anywhere; so many vehicles in lanes are no chance.
    surely = vehicles >= max(MANY_VEHICLES, NEARLY_ALL * on_road.vehicles)
    return enough and most_vehicles and (most_marks or surely)


def _is_wrong_way(approaches: Sequence[Approach], placed: LaneEvidence) -> bool:
    """Tell whether more vehicles drive against the approaches, in their lanes, than along them."""
    along, against = np.sum([ways(a, placed) for a in approaches], axis=0)
    return bool(against >= MIN_WRONG_WAY and against > along)


def _vehicles_that_agree(seen: LaneEvidence, found: Lateral) -> tuple[int, float]:
    """Return how many vehicles keep to a lane's middle, and how well."""
    used = np.isfinite(found.miss_m) & ~seen.is_mark
    if not used.any():
        return 0, 0.0
    _, owner = np.unique(seen.owner[used], return_inverse=True)
    count = np.bincount(owner)
    mean = np.bincount(owner, found.miss_m[used]) / count
    width = np.bincount(owner, found.width_m[used]) / count
    agree = np.abs(mean) < VEHICLE_AGREES * width
    return int(agree.sum()), float(np.sqrt((mean[agree] ** 2).mean())) if agree.any() else 0.0


def _marks_that_agree(seen: LaneEvidence, found: Lateral) -> int:
    with np.errstate(invalid="ignore"):
        agree = seen.is_mark & (np.abs(found.miss_m) < MARK_AGREES * found.width_m)
    return int(agree.sum())


def _verges_that_agree(
    approaches: Sequence[Approach], placed: Verges, ends_m: Floats
) -> tuple[int, bool]:
    """Return how many stretches end where their side does; whether most of an approach do."""
    miss, _, _ = misses(approaches, placed, ends_m)
    nearest = np.isfinite(miss)
    sides = placed.side[nearest]
    agree = np.abs(miss[nearest]) < VERGE_AGREES_M
    by_approach = sides // 2
    shown = np.bincount(by_approach, minlength=len(approaches))
    fit = np.bincount(by_approach, agree, minlength=len(approaches))
    good = (fit >= MIN_VERGES) & (fit >= MIN_VERGES_AGREEING * shown)
    return int(fit.sum()), bool(good.any())


def _search(
    approaches: Sequence[Approach], seen: LaneEvidence, verges: Verges, camera: Camera
) -> tuple[Floats, float]:
    """Try shifts across the road and rotations; -> the best, and the variance by other modes."""
    some = seen.thinned(SEARCH_SAMPLES)
    vehicles = some.weight[~some.is_mark].sum()
    share = min(SEARCH_VEHICLES / vehicles, 1.0) if vehicles > 0 else 1.0
    weight = np.where(some.is_mark, some.weight, share * some.weight)
    middle, across = _middle(approaches, seen)
    turn, shift = (
        g.ravel() for g in np.meshgrid(np.radians(ROTATIONS_DEG), SHIFTS_M, indexing="ij")
    )
    # Shifts are those at the evidence's middle, whatever the turn about the camera does there.
    at_foot = shift - turn * (turned(middle - camera.foot_enu) @ across)
    sigma_m = np.where(some.is_mark, MARK_SIGMA_M[0], VEHICLE_SIGMA_M)
    best = np.full((len(shift), len(some)), WORST)
    for approach in approaches:
        offset, left, along = offsets(approach, some)
        lever = (turned(some.enu - camera.foot_enu) * left).sum(axis=1)
        moved = offset + at_foot[:, None] * (left @ across) + turn[:, None] * lever
        cost = np.minimum((miss_m(approach, moved, some.is_mark) / sigma_m) ** 2, WORST)
        best = np.where(along, np.minimum(best, cost), best)
    total = best @ weight + (at_foot / SHIFT_SIGMA_M) ** 2
    total += (np.degrees(turn) / ROTATION_SIGMA_DEG) ** 2
    trials = Trials(np.radians(ROTATIONS_DEG), SHIFTS_M, camera.foot_enu, middle, across)
    beside, ends = beside_cost(approaches, verges, trials)
    total += beside.ravel()
    chosen = int(np.argmin(total))
    likelihood = np.exp(-(total - total[chosen]) / 2)
    away = shift - shift[chosen]
    other = np.abs(away) > OTHER_MODE_M
    modes_m2 = float((likelihood * away**2)[other].sum() / likelihood.sum())
    start = np.zeros(ENDS.start + 2 * len(approaches))
    start[TURN], start[SHIFT] = turn[chosen], at_foot[chosen] * across
    start[ENDS] = ends.reshape(len(total), -1)[chosen]
    return start, modes_m2


def _refine(
    approaches: Sequence[Approach],
    seen: LaneEvidence,
    verges: Verges,
    camera: Camera,
    start: Floats,
    share_m: float,
) -> tuple[Floats, Floats]:
    """Gauss–Newton with Huber weights; -> the solution, its covariance."""
    sigmas, expected = np.full(len(start), SHOULDER_SIGMA_M), np.zeros(len(start))
    expected[ENDS] = SHOULDER_M
    sigmas[TURN], sigmas[SHIFT] = np.radians(ROTATION_SIGMA_DEG), SHIFT_SIGMA_M
    sigmas[SCALE], sigmas[TILT], sigmas[SHARED] = SCALE_SIGMA, TILT_SIGMA, share_m
    prior = np.diag(sigmas**-2.0)
    solution, normal = start, prior
    worth = np.concatenate([seen.weight, verges.seen.weight])
    for n in range(ROUNDS):
        J, miss, sigma_m = _rows(approaches, seen, verges, camera, solution, n)
        used = np.abs(miss) < 4 * sigma_m  # NaN is not
        J, miss = J[used], miss[used]
        weight = np.minimum(1.0, 1.5 * sigma_m[used] / np.maximum(np.abs(miss), 1e-9))
        weight *= worth[used] / sigma_m[used] ** 2
        normal = (J * weight[:, None]).T @ J + prior
        pull = prior @ (solution - expected)
        solution = solution - np.linalg.solve(normal, (J * weight[:, None]).T @ miss + pull)
    return solution, np.asarray(np.linalg.inv(normal))


def _rows(
    approaches: Sequence[Approach],
    seen: LaneEvidence,
    verges: Verges,
    camera: Camera,
    solution: Floats,
    n: int,
) -> tuple[Floats, Floats, Floats]:
    """Return what round `n` fits: derivatives (k, parameters), misses and their sigmas (k,)."""
    placed = _moved(seen, solution, camera)
    found = lateral(approaches, placed, REACH_M)
    J = _jacobian(placed, found.left, solution, camera)
    miss = found.miss_m + J[:, SHARED] @ solution[SHARED]
    mark_m, verge_m = (s[min(n, len(s) - 1)] for s in (MARK_SIGMA_M, SIGMA_M))
    vehicle_m = _spread_m(miss[~seen.is_mark], VEHICLE_SIGMA_M)
    sigma_m = np.where(seen.is_mark, mark_m, vehicle_m)
    beside = replace(verges, seen=_moved(verges.seen, solution, camera))
    out_m, left, J_ends = misses(approaches, beside, solution[ENDS])
    J_beside = _jacobian(beside.seen, left, solution, camera)
    J_beside[:, ENDS] = J_ends
    return (
        np.concatenate([J, J_beside]),
        np.concatenate([miss, out_m]),
        np.concatenate([sigma_m, np.full(len(out_m), _spread_m(out_m, SHARPEST_M, verge_m))]),
    )


def _spread_m(miss_m: Floats, least_m: float, most_m: float = np.inf) -> float:
    """Return how well evidence of one kind (n,) keeps to where it belongs, as it is seen."""
    known = miss_m[np.isfinite(miss_m)]
    if not len(known):
        return least_m
    return float(np.clip(MAD_SIGMA * np.median(np.abs(known)), least_m, most_m))


def _homography(solution: Floats, camera: Camera) -> Floats:
    """Return the plane's motion (3, 3): turned, scaled and tilted about the foot, then shifted.

    A slope t puts the point q from the foot at q / (1 - t q / height).
    """
    c, s = np.cos(solution[TURN]), np.sin(solution[TURN])
    H = np.eye(3)
    H[:2, :2] = (1.0 + solution[SCALE]) * np.array([[c, -s], [s, c]])
    H[2, :2] = -solution[TILT] / camera.height_m
    there, back = np.eye(3), np.eye(3)
    there[:2, 2], back[:2, 2] = camera.foot_enu + solution[SHIFT], -camera.foot_enu
    return np.asarray(there @ H @ back)


def _moved(seen: LaneEvidence, solution: Floats, camera: Camera) -> LaneEvidence:
    H = _homography(solution, camera)
    enu = apply_homography(H, seen.enu)
    ahead = apply_homography(H, seen.enu + seen.course) - enu
    course = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return LaneEvidence(enu, course, seen.owner, seen.weight)


def _jacobian(placed: LaneEvidence, left: Floats, solution: Floats, camera: Camera) -> Floats:
    """Return what moves evidence along `left` (n, 2), to the first order: (n, parameters)."""
    arm = placed.enu - camera.foot_enu - solution[SHIFT]
    aside = (arm * left).sum(axis=1)
    shared = np.where(placed.is_mark[:, None], 0.0, left)
    return np.column_stack(
        [
            (turned(arm) * left).sum(axis=1),
            left,
            aside,
            aside[:, None] * arm / camera.height_m,
            shared,
            np.zeros((len(placed), len(solution) - ENDS.start)),
        ]
    )


def _middle(approaches: Sequence[Approach], seen: LaneEvidence) -> tuple[Floats, Floats]:
    """Return the middle of the evidence, and the unit vector to the left of the road there."""
    axis = np.linalg.eigh(seen.course.T @ seen.course)[1][:, -1]
    first = approaches[0].axis_enu[-1] - approaches[0].axis_enu[0]
    return seen.enu.mean(axis=0), turned(axis if first @ axis >= 0 else -axis)
