"""Every carriageway and direction found from how vehicles went, with its lanes.

The longest trajectory is the seed: from it a curve is traced along the traffic's courses, bent
until the vehicles beside it keep their offsets, and the offsets are sorted into lanes.  What the
lanes explain is taken out, and the next longest trajectory is the next seed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.traffic.axis_ends import AXIS_POINT_M, LINED_ONWARD_M, lengthened, spanned
from queuetail.traffic.centreline import (
    TRACED_BEND_M,
    UNIFORM_BEND_M,
    Kept,
    fit,
    onward,
    resample,
    shift_aside,
    stations,
    together,
    trace,
    uniform,
)
from queuetail.traffic.discovery import course_name
from queuetail.traffic.lane_evidence import NO_MARKS, LineMarks
from queuetail.traffic.lanes import IN_LANE, Lanes, fit_lanes
from queuetail.traffic.paths import Samples, Trajectory, extent_m, sample
from queuetail.traffic.road import length_m, locate
from queuetail.types import Approach, Bools, Floats, Ints

__all__ = ["Trajectory", "discover"]

LEAST_MOVED_M = 10.0
TOTAL_M, TOTAL_OF_TWO_M = 60.0, 150.0  # of three vehicles together, or of two, without lines
REACH_ASIDE_M = 25.0  # of the trace: who may be on the same carriageway
SAME_WAY_COS = float(np.cos(np.radians(25.0)))
VOTE_SAMPLES = 5  # a vehicle's mean offset over these is one vote for a lane
MAX_DRIFT = 0.08  # metres aside per metre along: more is a change of lanes or another course
LANE_KEEPING_M = 0.3
NOISE_M, LINE_NOISE_M = 0.5, 0.15  # of a vehicle's place across the road, and of a mark
LINES_APART_M, LINE_FITS_M = 0.6, 0.5  # at the least, and how near a lane's edge a line lies
MIN_LINES = 12  # marks on the edges of lanes, for two vehicles to be enough
# How far the ends of a curve may be off, turned and bent, and how closely lines then gather.
TURNS_M, SAGS_M = np.arange(-8.0, 8.1, 0.25), np.arange(-4.0, 4.1, 0.5)
LINE_BIN_M, UNTURNED = 0.2, 0.03
FIT_ROUNDS = 3
MISFIT_RATIO, MISFIT_M = 1.1, 0.02  # a plain curve may fit so much worse than a traced one
FREE_M = 10.0  # an offset before anything is known of it
MAX_SEEDS = 60


@dataclass(frozen=True, slots=True)
class _Found:
    approach: Approach
    way_m: float  # that all vehicles on it went
    onward_m: tuple[float, float]  # how far it goes on before its first point, and after its last


@dataclass(frozen=True, slots=True)
class _Seen:
    """What a carriageway is found from, beside the vehicles that none explains yet."""

    owners: int  # trajectories, of which samples are
    lines: LineMarks
    doubt_m: float
    known: Sequence[Approach]  # roads that were found before
    suspect: bool  # rather than be sure


@dataclass(frozen=True, slots=True)
class _Votes:
    """Mean offsets of runs of samples; `vote` says which of them each sample is in (-1: none)."""

    offset_m: Floats  # (v,)
    owner: Ints  # (v,)
    vote: Ints  # (n,)


def discover(
    trajectories: Sequence[Trajectory],
    lines: LineMarks = NO_MARKS,
    doubt_m: float = 0.0,
    known: Sequence[Approach] = (),
    suspect: bool = False,
) -> tuple[Approach, ...]:
    """Return the carriageways that the vehicles used, most traffic first; () until it is sure.

    Sure means three vehicles that moved 10 m the same way and 60 m together, or two with 150 m, or
    two that moved 10 m between painted lines.  An axis spans where traffic or its lines were seen
    and a bit onward, as far as no other lies there; a ramp is an approach of its own from where it
    diverges.  `doubt_m` is how far aside shadows may set all vehicles, `known` what was found
    before; to `suspect` a road, one vehicle that moved 10 m is enough.
    """
    free = sample(trajectories)
    seen = _Seen(len(trajectories), lines, doubt_m, known, suspect)
    found: list[_Found] = []
    for _ in range(MAX_SEEDS):
        extents = extent_m(free, seen.owners)
        if not len(extents) or extents.max() < LEAST_MOVED_M:
            break
        seed = int(np.argmax(extents))
        carriageway = _carriageway(free, seed, seen)
        taken = free.owner == seed
        if carriageway is not None:
            found.append(carriageway)
            taken |= _explained(free, carriageway.approach)
        free = _whole_runs(free, ~taken)
    found.sort(key=lambda f: -f.way_m)
    return _named(lengthened([f.approach for f in found], [f.onward_m for f in found]))


def _carriageway(free: Samples, seed: int, seen: _Seen) -> _Found | None:
    """Find the carriageway that one trajectory is on, if enough others went its way."""
    path = free.where(free.owner == seed)
    middle = len(path) // 2
    curve = trace(free, path.enu[middle], path.course[middle])
    if len(curve) < 3:
        return None
    near = free.where(_beside(free, curve))
    if not _sure(near, seen, MIN_LINES):
        return None
    curve, bend_m = _simplest(curve, near)
    known = [a.axis_enu for a in seen.known if _is_along(a, path)]
    curve = _along_lines([_both_ways(curve), *known], seen.lines)
    near = free.where(_beside(free, curve))
    members, lines = near, NO_MARKS
    for _ in range(FIT_ROUNDS):
        votes = _votes(near, curve)
        if not len(votes.offset_m):
            return None
        lines, line_m = _lines_along(seen.lines, curve)
        lanes = fit_lanes(votes.offset_m, votes.owner, line_m, seen.doubt_m)
        on_edge = np.abs(line_m[:, None] - lanes.edges_m).min(axis=1) < LINE_FITS_M
        miss = votes.offset_m - lanes.driven_m[lanes.index(votes.offset_m)]
        used = (votes.vote >= 0) & (np.abs(miss) < lanes.width_m / 2)[votes.vote]
        members = near.where(used)
        if not _sure(members, seen, int(on_edge.sum())):
            return None
        kept = together((_in_lanes(members, votes, used, lanes), _parallel(lines, line_m)))
        curve, lines = fit(curve, kept, bend_m)[0], lines.where(on_edge)
    lanes = _lanes_of(members, seen, curve, lanes)
    edge = resample(shift_aside(curve, lanes.left_edge_m), AXIS_POINT_M)
    axis, onward_m = spanned(edge, members, lines)
    approach = Approach("", axis, 0.0, lanes.count, lanes.width_m)
    return _Found(approach, float(extent_m(members, seen.owners).sum()), onward_m)


def _sure(samples: Samples, seen: _Seen, lines: int) -> bool:
    """Tell whether enough vehicles went here, beside so many marks of lines."""
    extents = extent_m(samples, seen.owners)
    moved = extents[extents >= LEAST_MOVED_M]
    if seen.suspect:
        return len(moved) > 0
    between = len(seen.lines) > 0 and lines >= MIN_LINES
    enough_m = 0.0 if between else TOTAL_OF_TWO_M if len(moved) == 2 else TOTAL_M
    return len(moved) >= 2 and float(moved.sum()) >= enough_m


def _simplest(curve: Floats, near: Samples) -> tuple[Floats, float]:
    """Fit every vehicle's own offset to a curve of one curvature, or as traced if that is no fit.

    Returns the curve, and how much it may still bend.
    """
    group = np.unique(near.owner, return_inverse=True)[1]
    n = group.max() + 1
    noise_m = np.full(len(near), NOISE_M)
    kept = Kept(near.enu, group, noise_m, np.zeros(n), np.full(n, FREE_M))
    plain, plain_m = fit(uniform(curve), kept, UNIFORM_BEND_M)
    traced, traced_m = fit(curve, kept, TRACED_BEND_M)
    if plain_m < traced_m * MISFIT_RATIO + MISFIT_M:
        return plain, UNIFORM_BEND_M
    return traced, TRACED_BEND_M


def _both_ways(curve: Floats) -> Floats:
    """Return a curve that goes on at both ends as it ends there."""
    before, beyond = (onward(c, LINED_ONWARD_M, AXIS_POINT_M) for c in (curve[::-1], curve))
    return np.concatenate([before[::-1], curve, beyond])


def _in_lanes(members: Samples, votes: _Votes, used: Bools, lanes: Lanes) -> Kept:
    """Return every vehicle, held near the centre of the lane that it is in.

    One that keeps between two lanes, as merged vehicles do, is held by nothing.
    """
    lane = lanes.index(votes.offset_m)
    vote = votes.vote[used]
    pairs, group = np.unique(members.owner * lanes.count + lane[vote], return_inverse=True)
    driven_m = lanes.driven_m[pairs % lanes.count]
    miss = np.bincount(group, votes.offset_m[vote]) / np.bincount(group) - driven_m
    sigma_m = np.where(np.abs(miss) < IN_LANE * lanes.width_m, LANE_KEEPING_M, FREE_M)
    noise_m = np.full(len(members), NOISE_M)
    return Kept(members.enu, group, noise_m, driven_m, sigma_m)


def _parallel(lines: LineMarks, line_m: Floats) -> Kept:
    """Return the marks of each line, held at one offset, whichever that is."""
    order = np.argsort(line_m)
    line = np.zeros(len(lines), np.int64)
    line[order] = np.cumsum(np.diff(line_m[order], prepend=line_m[order[:1]]) > LINES_APART_M)
    count = line.max() + 1 if len(line) else 0
    mean_m = np.bincount(line, line_m, count) / np.maximum(np.bincount(line, minlength=count), 1)
    noise_m = np.full(len(lines), LINE_NOISE_M)
    return Kept(lines.enu, line, noise_m, mean_m, np.full(count, FREE_M))


def _lines_along(lines: LineMarks, curve: Floats) -> tuple[LineMarks, Floats]:
    """Return the marks that lie along a curve, and their offsets from it."""
    along = Approach("", curve)
    station, offset, course = locate(along, lines.enu)
    inside = (station > 0.0) & (station < length_m(along))
    parallel = np.abs((course * lines.course).sum(axis=1)) > SAME_WAY_COS
    near = inside & parallel & (np.abs(offset) < REACH_ASIDE_M)
    return lines.where(near), offset[near]


def _is_along(approach: Approach, path: Samples) -> bool:
    """Tell whether a vehicle went beside an approach, its way."""
    return bool(_beside(path, approach.axis_enu).mean() > 0.5)


def _along_lines(curves: Sequence[Floats], lines: LineMarks) -> Floats:
    """Return one of the curves, turned and bent until the marks beside it gather closest.

    A few short trajectories say less well than lines how the road runs.
    """
    tried = [_gathered(curve, lines) for curve in curves]
    return max(tried, key=lambda t: t[0])[1]


def _gathered(curve: Floats, lines: LineMarks) -> tuple[float, Floats]:
    """Return how closely marks beside a curve gather, and the curve turned and bent for that."""
    lines, offset = _lines_along(lines, curve)
    if len(lines) < MIN_LINES:
        return 0.0, curve
    at_m = stations(curve)
    middle_m = float(at_m[-1]) / 2
    at = at_m / middle_m - 1
    along = locate(Approach("", curve), lines.enu)[0] / middle_m - 1
    ends, sags = (g.ravel() for g in np.meshgrid(TURNS_M, SAGS_M, indexing="ij"))
    moved = offset - ends[:, None] * along - sags[:, None] * (along**2 - 0.5)
    bins = np.floor(moved / LINE_BIN_M).astype(np.int64)
    bins -= bins.min()
    width = int(bins.max()) + 2
    rows = np.arange(len(ends))[:, None] * width
    counts = np.bincount((rows + bins).ravel(), minlength=len(ends) * width)
    counts = counts.reshape(-1, width)
    near = counts[:, :-1] + counts[:, 1:]  # a line may lie on the border of two bins
    closeness = (near**2).sum(axis=1) / len(lines) - UNTURNED * (np.abs(ends) + np.abs(sags))
    best = int(np.argmax(closeness))
    return float(closeness[best]), shift_aside(curve, ends[best] * at + sags[best] * (at**2 - 0.5))


def _lanes_of(members: Samples, seen: _Seen, curve: Floats, lanes: Lanes) -> Lanes:
    """Return the lanes again, on the fitted curve."""
    votes = _votes(members, curve)
    if not len(votes.offset_m):
        return lanes
    line_m = _lines_along(seen.lines, curve)[1]
    return fit_lanes(votes.offset_m, votes.owner, line_m, seen.doubt_m)


def _beside(samples: Samples, curve: Floats) -> Bools:
    along = Approach("", curve)
    station, offset, course = locate(along, samples.enu)
    inside = (station > -AXIS_POINT_M) & (station < length_m(along) + AXIS_POINT_M)
    same_way = (course * samples.course).sum(axis=1) > SAME_WAY_COS
    return np.asarray(inside & same_way & (np.abs(offset) < REACH_ASIDE_M))


def _votes(samples: Samples, curve: Floats) -> _Votes:
    """Return the mean offsets of runs of samples that keep to the curve's course."""
    station, offset, _ = locate(Approach("", curve), samples.enu)
    vote = np.full(len(samples), -1, np.int64)
    means: list[float] = []
    owners: list[int] = []
    bounds = np.flatnonzero(np.diff(samples.owner, prepend=-1, append=-1))
    for first, end in itertools.pairwise(bounds.tolist()):
        runs = max(1, (end - first) // VOTE_SAMPLES)
        for rows in np.array_split(np.arange(first, end), runs):
            along = station[rows] - station[rows].mean()
            spread = along @ along
            if len(rows) < 3 or not spread > 0:
                continue
            if abs(along @ offset[rows]) < MAX_DRIFT * spread:
                vote[rows] = len(means)
                means.append(float(sorted(offset[rows])[len(rows) // 2]))
                owners.append(int(samples.owner[first]))
    return _Votes(np.array(means), np.array(owners, np.int64), vote)


def _explained(samples: Samples, approach: Approach) -> Bools:
    """Return which samples the approach accounts for: on its lanes, or along them close by."""
    station, offset, course = locate(approach, samples.enu)
    outside = np.maximum(offset, -approach.lanes * approach.lane_width_m - offset)
    same_way = (course * samples.course).sum(axis=1)
    inside = (station > -AXIS_POINT_M) & (station < length_m(approach) + AXIS_POINT_M)
    on = (outside < approach.lane_width_m / 2) & (same_way > SAME_WAY_COS)
    along = (outside < approach.lane_width_m) & (same_way > np.cos(MAX_DRIFT))
    return np.asarray(inside & (on | along))


def _whole_runs(samples: Samples, mask: Bools) -> Samples:
    """Keep the longest unbroken run of each trajectory, so that no one is in two places."""
    keep = np.zeros(len(samples), np.bool_)
    key = np.where(mask, samples.owner, -1)
    bounds = np.flatnonzero(np.diff(key, prepend=-2, append=-2))
    longest: dict[int, tuple[int, int]] = {}
    for first, end in itertools.pairwise(bounds.tolist()):
        owner = int(key[first])
        old = longest.get(owner, (0, 0))
        if owner >= 0 and end - first > old[1] - old[0]:
            longest[owner] = (first, end)
    for first, end in longest.values():
        keep[first:end] = True
    return samples.where(keep)


def _named(approaches: list[Approach]) -> tuple[Approach, ...]:
    """Name approaches by the compass at the middle of their axes, each name once."""
    named: list[Approach] = []
    used: dict[str, int] = {}
    for a in approaches:
        middle = len(a.axis_enu) // 2
        name = course_name(a.axis_enu[middle] - a.axis_enu[middle - 1])
        used[name] = used.get(name, 0) + 1
        unique = name if used[name] == 1 else f"{name} {used[name]}"
        named.append(Approach(unique, a.axis_enu, a.start_station_m, a.lanes, a.lane_width_m))
    return tuple(named)
