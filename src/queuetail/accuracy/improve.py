"""Offsets of heading, pitch and height that put known points where they are.

Robust weighted least squares: residuals on the ground, each divided by what a click and a true
place of usual care leave of uncertainty there; Huber's weights (Huber 1964) with the scale of the
median; an offset that the points do not determine is left at zero, and said to be.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.accuracy.points import Errors, KnownPoint, measure
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import apply_homography, enu_to_px, mapping_from_pose, px_to_enu
from queuetail.types import Bools, CameraPose, Floats, GroundMapping, Ints, Origin

CLICK_PX = 2.0  # one standard deviation of a click, at the picture's own size
PLACE_M = 0.5  # of a true place, read from a map or measured with a good receiver
HUBER = 1.345  # 95 % efficiency for normal errors
MISFIT = 4.0  # a point so many scales off does not fit the others
ITERATIONS = 30
STEP = np.array([1e-3, 1e-3, 1e-3])  # degrees, degrees, metres: for numeric derivatives
LARGEST = np.array([185.0, 30.0, 500.0])  # of an offset that is still believed
STRIDE = np.array([20.0, 8.0, 30.0])  # of one iteration at most
HEADINGS_DEG = (0.0, 30.0, -30.0, 60.0, -60.0, 90.0, -90.0, 120.0, -120.0, 150.0, -150.0, 180.0)
# An offset is determined where its standard deviation is below this (height: share of the height).
DETERMINED_DEG = {"heading_deg": 2.0, "pitch_deg": 1.0}
DETERMINED_HEIGHT = 0.04


@dataclass(frozen=True, slots=True)
class Offset:
    """What is to be added to one quantity, with one standard deviation; or why it is not known."""

    value: float
    sigma: float
    is_determined: bool


@dataclass(frozen=True, slots=True)
class Improvement:
    """The offsets, and the errors before and after."""

    heading_deg: Offset
    pitch_deg: Offset
    height_m: Offset
    before: Errors
    after: Errors
    held_out_m: float  # mean error of each point by offsets that the others gave; NaN below 3
    misfits: tuple[int, ...]  # which points do not fit the others

    @property
    def offsets(self) -> tuple[Offset, Offset, Offset]:
        """Heading, pitch and height."""
        return self.heading_deg, self.pitch_deg, self.height_m

    @property
    def helps(self) -> bool:
        """Whether the offsets are worth applying: unseen points, too, come out better."""
        if not any(o.is_determined for o in self.offsets):
            return False
        judged = self.after.mean_m if np.isnan(self.held_out_m) else self.held_out_m
        return bool(judged < self.before.mean_m)


@dataclass(frozen=True, slots=True)
class _Problem:
    """Points as rows: ideal pixels of their pose, true places, whitening of the residuals."""

    origin: Origin
    poses: tuple[CameraPose, ...]
    mappings: tuple[GroundMapping, ...]
    px: Floats  # (n, 2) where the pose alone would show what the mapping places
    true_enu: Floats  # (n, 2)
    whiten: Floats  # (n, 2, 2)

    def without(self, i: int) -> _Problem:
        """Leave one point out."""
        keep = np.arange(len(self.poses)) != i
        return _Problem(
            self.origin,
            tuple(p for j, p in enumerate(self.poses) if j != i),
            tuple(m for j, m in enumerate(self.mappings) if j != i),
            self.px[keep],
            self.true_enu[keep],
            self.whiten[keep],
        )


def improve(points: Sequence[KnownPoint], mappings: Sequence[GroundMapping]) -> Improvement:
    """Find the offsets from known points, one mapping each, all with poses and one origin.

    Raises ValueError where there is no point below the horizon, or a mapping has no pose.
    """
    before = measure(points, mappings)
    seen = [i for i, p in enumerate(before.placed) if np.isfinite(p.error_m)]
    if any(m.pose is None for m in mappings):
        raise ValueError("control points place the picture: there is no pose to correct")
    if not seen:
        raise ValueError("no point lies below the horizon")
    problem = _problem([points[i] for i in seen], [mappings[i] for i in seen])
    offsets, sigma, free = _determined(problem)
    scale = _scale(_whitened(problem, offsets))
    distances = np.linalg.norm(_whitened(problem, offsets).reshape(-1, 2), axis=1)
    misfits = tuple(
        seen[i] for i in np.flatnonzero(distances > MISFIT * max(scale, 1.0)) if len(seen) > 3
    )
    found = [
        Offset(float(v), float(s), bool(f)) for v, s, f in zip(offsets, sigma, free, strict=True)
    ]
    return Improvement(
        heading_deg=found[0],
        pitch_deg=found[1],
        height_m=found[2],
        before=before,
        after=measure(points, [shifted(m, offsets) for m in mappings]),
        held_out_m=_held_out_m(problem, points, seen),
        misfits=misfits,
    )


def shifted(mapping: GroundMapping, offsets: Floats) -> GroundMapping:
    """Return the mapping with its pose's heading, pitch and height offset.

    What registration or averaging changed against the plain pose stays as it is.
    """
    pose, origin = mapping.pose, mapping.origin
    assert pose is not None
    assert origin is not None
    plain = mapping_from_pose(pose, origin)
    other = mapping_from_pose(_offset_pose(pose, offsets), origin)
    move = other.H_enu_px @ plain.H_px_enu
    H_enu_px = move @ mapping.H_enu_px
    return dataclasses.replace(
        mapping,
        H_enu_px=H_enu_px,
        H_px_enu=mapping.H_px_enu @ plain.H_enu_px @ other.H_px_enu,
        pose=other.pose,
    )


def _offset_pose(pose: CameraPose, offsets: Floats) -> CameraPose:
    return dataclasses.replace(
        pose,
        yaw_deg=pose.yaw_deg + float(offsets[0]),
        pitch_deg=pose.pitch_deg + float(offsets[1]),
        height_agl_m=max(pose.height_agl_m + float(offsets[2]), 1.0),
    )


def _problem(points: Sequence[KnownPoint], mappings: Sequence[GroundMapping]) -> _Problem:
    px, true, whiten, poses = [], [], [], []
    for point, mapping in zip(points, mappings, strict=True):
        assert mapping.pose is not None
        assert mapping.origin is not None
        plain = mapping_from_pose(mapping.pose, mapping.origin)
        clicked = np.array([point.px], float)
        placed = px_to_enu(mapping, clicked)
        # Ideal pixels of the plain pose, so that its lens need not be undone at every iteration.
        px.append(apply_homography(plain.H_px_enu, placed)[0])
        lat, lon = np.array([point.lat_deg]), np.array([point.lon_deg])
        true.append(enu_from_geodetic(lat, lon, mapping.origin)[0])
        whiten.append(_whitening(mapping, clicked, placed, true[-1]))
        poses.append(mapping.pose)
    assert mappings[0].origin is not None
    return _Problem(
        mappings[0].origin,
        tuple(poses),
        tuple(mappings),
        np.array(px),
        np.array(true),
        np.array(whiten),
    )


def _whitening(mapping: GroundMapping, px: Floats, placed: Floats, true: Floats) -> Floats:
    """Return W with W Wᵀ the inverse covariance of a click's place, as seen at the true place.

    Judged at the true place: where a wrong pose puts a far point says little of how it is seen.
    """
    at = enu_to_px(mapping, true[None, :])
    if not np.isfinite(at).all():
        at = px
    base = px_to_enu(mapping, at)
    J = np.stack(
        [(px_to_enu(mapping, at + d) - base)[0] * CLICK_PX for d in ([1.0, 0.0], [0.0, 1.0])],
        axis=-1,
    )
    if not np.isfinite(J).all():
        return np.eye(2) / PLACE_M
    covariance = J @ J.T + PLACE_M**2 * np.eye(2)
    return np.asarray(np.linalg.cholesky(np.linalg.inv(covariance)).T)


def _whitened(problem: _Problem, offsets: Floats) -> Floats:
    """Return the residuals over their standard deviations, (2n,); what sees no ground counts much.

    The Cholesky factor L of the inverse covariance gives |Lᵀ r|² = rᵀ C⁻¹ r.
    """
    H = {
        pose: mapping_from_pose(_offset_pose(pose, offsets), problem.origin).H_enu_px
        for pose in set(problem.poses)  # points of one moment share theirs
    }
    rows = [
        W @ (apply_homography(H[pose], px[None, :])[0] - true)
        for pose, px, true, W in zip(
            problem.poses, problem.px, problem.true_enu, problem.whiten, strict=True
        )
    ]
    return np.nan_to_num(np.concatenate(rows), nan=1e4, posinf=1e4, neginf=-1e4)


def _determined(problem: _Problem) -> tuple[Floats, Floats, Bools]:
    """Solve for as many offsets as the points determine; the least certain is left out first."""
    height_m = float(np.median([p.height_agl_m for p in problem.poses]))
    limits = np.array([*DETERMINED_DEG.values(), DETERMINED_HEIGHT * height_m])
    free = np.ones(3, bool)
    sigma = np.full(3, np.inf)
    while free.any():
        offsets, now = _solve(problem, free)
        sigma[free] = now[free]
        ratio = np.where(free, now / limits, 0.0)
        beyond = free & (np.abs(offsets) > LARGEST)
        if (ratio <= 1.0).all() and not beyond.any():
            return offsets, sigma, free
        free[int(np.argmax(np.where(beyond, np.inf, ratio)))] = False
    return np.zeros(3), sigma, free


def _solve(problem: _Problem, free: Bools) -> tuple[Floats, Floats]:
    """Return the offsets, zero where not free, and their standard deviations (inf where none)."""
    offsets, damping = _start(problem, free), 1e-3
    columns = np.flatnonzero(free)
    for _ in range(ITERATIONS):
        r = _whitened(problem, offsets)
        J = _jacobian(problem, offsets, columns)
        w = _weights(r)
        normal = (J.T * w) @ J
        step = np.zeros(3)
        step[columns] = -np.linalg.lstsq(
            normal + damping * np.diag(np.diag(normal)), (J.T * w) @ r, rcond=None
        )[0]
        step /= max(float(np.max(np.abs(step) / STRIDE)), 1.0)
        trial = _whitened(problem, offsets + step)
        if _cost(trial, r) <= _cost(r, r):
            offsets, damping = offsets + step, damping / 5
        else:
            damping = min(max(damping, 1e-6) * 10, 1e6)
        if np.all(np.abs(step) < 1e-5):
            break
    r = _whitened(problem, offsets)
    J = _jacobian(problem, offsets, columns)
    normal = (J.T * _weights(r)) @ J
    spare = max(len(r) - len(columns), 1)
    # Points that fit better than a click can are luck; ones that fit worse tell of their care.
    spread = max(float((_weights(r) * r**2).sum()) / spare, 1.0)
    sigma = np.full(3, np.inf)
    with np.errstate(all="ignore"):
        values, vectors = np.linalg.eigh(normal)
        inverse = vectors / np.maximum(values, 1e-12) @ vectors.T
        sigma[columns] = np.sqrt(np.diag(inverse) * spread)
    return offsets, sigma


def _start(problem: _Problem, free: Bools) -> Floats:
    """Return the best of some headings all around: a compass may be half a turn off."""
    starts = np.zeros((len(HEADINGS_DEG), 3))
    starts[:, 0] = HEADINGS_DEG if free[0] else 0.0
    costs = [float(_lengths(_whitened(problem, s)).sum()) for s in starts]
    return np.asarray(starts[int(np.argmin(costs))])


def _jacobian(problem: _Problem, offsets: Floats, columns: Ints) -> Floats:
    steps = []
    for column in columns:
        delta = np.zeros(3)
        delta[column] = STEP[column]
        ahead, behind = _whitened(problem, offsets + delta), _whitened(problem, offsets - delta)
        steps.append((ahead - behind) / (2 * STEP[column]))
    return np.stack(steps, axis=-1)


def _lengths(residuals: Floats) -> Floats:
    """Return each residual's point's length, twice: both parts of a point share its weight."""
    return np.repeat(np.linalg.norm(residuals.reshape(-1, 2), axis=1), 2)


def _scale(residuals: Floats) -> float:
    """Return the typical length of a residual, in its expected ones; at least 1."""
    # The median length of a two-dimensional unit normal is 1.18.
    return max(float(np.median(_lengths(residuals))) / 1.1774, 1.0)


def _weights(residuals: Floats) -> Floats:
    lengths, scale = _lengths(residuals), _scale(residuals)
    return np.asarray(np.minimum(1.0, HUBER * scale / np.maximum(lengths, 1e-12)))


def _cost(residuals: Floats, scaled_by: Floats) -> float:
    """Return Huber's cost with the scale of other residuals, so that two can be compared."""
    limit = HUBER * _scale(scaled_by)
    lengths = _lengths(residuals)[::2]
    inside = lengths <= limit
    return float(np.where(inside, 0.5 * lengths**2, limit * (lengths - 0.5 * limit)).sum())


def _held_out_m(problem: _Problem, points: Sequence[KnownPoint], seen: Sequence[int]) -> float:
    """Return the mean error of points by the offsets that the others determine."""
    if len(seen) < 3:
        return float("nan")
    errors = []
    for i, index in enumerate(seen):
        offsets, _, _ = _determined(problem.without(i))
        moved = shifted(problem.mappings[i], offsets)
        errors.append(measure([points[index]], [moved]).placed[0].error_m)
    return float(np.mean(errors))
