"""Every carriageway and direction found from how vehicles went, with its lanes.

The longest trajectory is the seed: from it a curve is traced along the traffic's courses, bent
until the vehicles beside it keep their offsets, and the offsets are sorted into lanes.  What the
lanes explain is taken out, and the next longest trajectory is the next seed.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from queuetail.traffic.centreline import (
    TRACED_BEND_M,
    UNIFORM_BEND_M,
    fit,
    onward,
    resample,
    shift_aside,
    trace,
    uniform,
)
from queuetail.traffic.discovery import course_name
from queuetail.traffic.lanes import IN_LANE, Lanes, fit_lanes
from queuetail.traffic.paths import Samples, Trajectory, extent_m, sample
from queuetail.traffic.road import length_m, locate
from queuetail.types import Approach, Bools, Floats, Ints

__all__ = ["Trajectory", "discover"]

MIN_MOVED_M = 20.0
MIN_VEHICLES = 3
MIN_TOTAL_M = 150.0  # of two vehicles together: as good as a third one
REACH_ASIDE_M = 25.0  # of the trace: who may be on the same carriageway
SAME_WAY_COS = float(np.cos(np.radians(25.0)))
VOTE_SAMPLES = 5  # a vehicle's mean offset over these is one vote for a lane
MAX_DRIFT = 0.08  # metres aside per metre along: more is a change of lanes or another course
LANE_KEEPING_M = 0.3
MISFIT_RATIO, MISFIT_M = 1.1, 0.02  # a plain curve may fit so much worse than a traced one
FREE_M = 10.0  # an offset before anything is known of it
AXIS_POINT_M = 15.0
ONWARD_M = 45.0  # beyond the traffic that was seen
MAX_SEEDS = 60


@dataclass(frozen=True, slots=True)
class _Found:
    approach: Approach
    way_m: float  # that all vehicles on it went


@dataclass(frozen=True, slots=True)
class _Votes:
    """Mean offsets of runs of samples; `vote` says which of them each sample is in (-1: none)."""

    offset_m: Floats  # (v,)
    owner: Ints  # (v,)
    vote: Ints  # (n,)


def discover(trajectories: Sequence[Trajectory]) -> tuple[Approach, ...]:
    """Return the carriageways that the vehicles used, most traffic first; () until it is sure.

    Sure means three vehicles that moved 20 m the same way, or two with 150 m together.  An axis
    spans where traffic was seen and a bit onward, as far as no other lies there; a ramp is an
    approach of its own from where it diverges.
    """
    free = sample(trajectories)
    found: list[_Found] = []
    for _ in range(MAX_SEEDS):
        extents = extent_m(free, len(trajectories))
        if not len(extents) or extents.max() < MIN_MOVED_M:
            break
        seed = int(np.argmax(extents))
        carriageway = _carriageway(free, seed, len(trajectories))
        taken = free.owner == seed
        if carriageway is not None:
            found.append(carriageway)
            taken |= _explained(free, carriageway.approach)
        free = _whole_runs(free, ~taken)
    found.sort(key=lambda f: -f.way_m)
    return _named(_lengthened([f.approach for f in found]))


def _carriageway(free: Samples, seed: int, owners: int) -> _Found | None:
    """Find the carriageway that one trajectory is on, if enough others went its way."""
    path = free.where(free.owner == seed)
    middle = len(path) // 2
    curve = trace(free, path.enu[middle], path.course[middle])
    if len(curve) < 3:
        return None
    near = free.where(_beside(free, curve))
    if not _sure(near, owners):
        return None
    curve, bend_m = _simplest(curve, near)
    members = near
    for _ in range(2):
        votes = _votes(near, curve)
        if not len(votes.offset_m):
            return None
        lanes = fit_lanes(votes.offset_m, votes.owner)
        lane = lanes.index(votes.offset_m)
        fits = np.abs(votes.offset_m - lanes.centres_m[lane]) < lanes.width_m / 2
        used = (votes.vote >= 0) & fits[votes.vote]
        members = near.where(used)
        if not _sure(members, owners):
            return None
        curve = _fit_to_lanes(curve, members, votes, used, lanes, bend_m)
    lanes = _lanes_of(members, curve, lanes)
    axis = _spanned(resample(shift_aside(curve, lanes.left_edge_m), AXIS_POINT_M), members)
    approach = Approach("", axis, 0.0, lanes.count, lanes.width_m)
    return _Found(approach, float(extent_m(members, owners).sum()))


def _sure(samples: Samples, owners: int) -> bool:
    extents = extent_m(samples, owners)
    moved = extents[extents >= MIN_MOVED_M]
    return len(moved) >= MIN_VEHICLES or (len(moved) == 2 and float(moved.sum()) >= MIN_TOTAL_M)


def _simplest(curve: Floats, near: Samples) -> tuple[Floats, float]:
    """Fit every vehicle's own offset to a curve of one curvature, or as traced if that is no fit.

    Returns the curve, and how much it may still bend.
    """
    group = np.unique(near.owner, return_inverse=True)[1]
    mean_m, sigma_m = np.zeros(group.max() + 1), np.full(group.max() + 1, FREE_M)
    plain, plain_m = fit(uniform(curve), near, group, mean_m, sigma_m, UNIFORM_BEND_M)
    traced, traced_m = fit(curve, near, group, mean_m, sigma_m, TRACED_BEND_M)
    if plain_m < traced_m * MISFIT_RATIO + MISFIT_M:
        return plain, UNIFORM_BEND_M
    return traced, TRACED_BEND_M


def _fit_to_lanes(
    curve: Floats, members: Samples, votes: _Votes, used: Bools, lanes: Lanes, bend_m: float
) -> Floats:
    """Fit the curve with every vehicle held near the centre of the lane that it is in.

    One that keeps between two lanes, as merged vehicles do, is held by nothing.
    """
    lane = lanes.index(votes.offset_m)
    vote = votes.vote[used]
    pairs, group = np.unique(members.owner * lanes.count + lane[vote], return_inverse=True)
    centre = lanes.centres_m[pairs % lanes.count]
    miss = np.bincount(group, votes.offset_m[vote]) / np.bincount(group) - centre
    sigma_m = np.where(np.abs(miss) < IN_LANE * lanes.width_m, LANE_KEEPING_M, FREE_M)
    return fit(curve, members, group, centre, sigma_m, bend_m)[0]


def _lanes_of(members: Samples, curve: Floats, lanes: Lanes) -> Lanes:
    """Return the lanes again, on the fitted curve."""
    votes = _votes(members, curve)
    return fit_lanes(votes.offset_m, votes.owner) if len(votes.offset_m) else lanes


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


def _spanned(axis: Floats, members: Samples) -> Floats:
    """Cut the axis to, or lengthen it straight to, where two of its vehicles were seen."""
    station, _, _ = locate(Approach("", axis), members.enu)
    lengths = np.linalg.norm(np.diff(axis, axis=0), axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    bounds = np.flatnonzero(np.diff(members.owner, prepend=-1))
    # The second: one vehicle that leaves the road would take the axis with it.
    first = float(np.sort(np.minimum.reduceat(station, bounds))[1])
    last = float(np.sort(np.maximum.reduceat(station, bounds))[-2])
    inner = axis[(at > first + AXIS_POINT_M / 3) & (at < last - AXIS_POINT_M / 3)]
    return np.concatenate([_at(axis, at, first), inner, _at(axis, at, last)])


def _lengthened(approaches: list[Approach]) -> list[Approach]:
    """Let axes go on at both ends, where no other does.

    A vehicle is followed only where all of it is in the picture, and some time after it came.
    """
    longer = []
    for approach in approaches:
        others = [a for a in approaches if a is not approach]
        half_m = approach.lanes * approach.lane_width_m / 2
        axis, middle = approach.axis_enu, shift_aside(approach.axis_enu, -half_m)
        ends = []
        for way in (1, -1):
            free = _free(onward(middle[::way], ONWARD_M, AXIS_POINT_M), half_m, others)
            ends.append(onward(axis[::way], ONWARD_M, AXIS_POINT_M)[:free])
        axis = np.concatenate([ends[1][::-1], axis, ends[0]])
        longer.append(replace(approach, axis_enu=axis))
    return longer


def _free(middle: Floats, half_m: float, others: Sequence[Approach]) -> int:
    """Return how many points of lanes' middle (n, 2) lie before they come upon another's lanes."""
    blocked = np.zeros(len(middle), np.bool_)
    for other in others:
        station, offset, _ = locate(other, middle)
        other_half_m = other.lanes * other.lane_width_m / 2
        beside = np.abs(offset + other_half_m) < half_m + other_half_m
        blocked |= beside & (station > -ONWARD_M) & (station < length_m(other) + ONWARD_M)
    return int(np.argmax(blocked)) if blocked.any() else len(middle)


def _at(axis: Floats, at: Floats, station_m: float) -> Floats:
    leg = int(np.clip(np.searchsorted(at, station_m, side="right") - 1, 0, len(axis) - 2))
    share = (station_m - at[leg]) / (at[leg + 1] - at[leg])
    return np.asarray(axis[leg] + share * (axis[leg + 1] - axis[leg]))[None]


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
