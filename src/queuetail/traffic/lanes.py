"""Lanes from lateral offsets: how many there are, how wide, and where the left edge lies.

Vehicles keep to the middles of lanes, painted lines lie on their edges.  Lines are seen to a
decimetre; all vehicles may seem to be aside together, for shadow or lean, which the lines show.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from queuetail.traffic.lane_evidence import WANDER_M, WINDOW_M
from queuetail.types import Floats, Ints

DEFAULT_WIDTH_M = 3.5
MIN_WIDTH_M, MAX_WIDTH_M = 2.7, 4.5
WIDTH_SIGMA_M = 0.5  # how far lanes differ from the default
SPREAD_M = 0.45  # of a vehicle's mean offset about its lane's centre
MAX_GAP_M = 1.5 * DEFAULT_WIDTH_M  # between lane centres of one carriageway
MIN_SHARE = 0.04  # of the vehicles: fewer are strays, no lane
MIN_VOTES = 2  # of a lane's only vehicle, where no lines are seen
IN_LANE = 0.3  # of the width from the centre
SHARE_M = 0.5  # how far aside all vehicles may seem to be, where lines show it,
NOT_ASIDE_M = 1e-6  # and where nothing would
FEW = 6  # vehicles: more that share a bias say no more, where lines are seen
LINE_SIGMA_M, SEARCH_SIGMA_M = 0.12, 0.25
LINE_WORTH = WINDOW_M / WANDER_M  # of a mark
BESIDE_M = 6.5  # the outermost vehicles: lines farther out are another road's
PHASES, REFINEMENTS = 40, 5
MANY, MOST = 30, 80  # vehicles that count, and votes that the search looks at
WORST = 4.0  # squared sigmas: a stray counts for no more
NO_LINES: Floats = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Lanes:
    """A carriageway across: lane 0 is the left-most, its centre half a width right of the edge."""

    left_edge_m: float  # offset of the left edge of the left lane
    count: int
    width_m: float
    aside_m: float = 0.0  # how far to the left of their lanes' centres all vehicles seem to be

    @property
    def driven_m(self) -> Floats:
        """Offsets at which each lane's vehicles seem to drive, from the left, (count,)."""
        return self.driven_at_m(np.arange(self.count))

    @property
    def edges_m(self) -> Floats:
        """Offsets of the lanes' edges, from the left, (count + 1,)."""
        return np.asarray(self.left_edge_m - np.arange(self.count + 1) * self.width_m)

    def driven_at_m(self, lane: Ints) -> Floats:
        """Return the offsets at which vehicles of lanes (n,), these or beyond, seem to drive."""
        return np.asarray(self.left_edge_m - (lane + 0.5) * self.width_m + self.aside_m)

    def index(self, offset_m: Floats) -> Ints:
        """Return the lane of vehicles (n,), the nearest one of those beside the lanes."""
        return np.clip(self.counted_on(offset_m), 0, self.count - 1)

    def counted_on(self, offset_m: Floats) -> Ints:
        """Return the lane of vehicles (n,), counted on beyond the first lane and the last."""
        away_m = self.left_edge_m + self.aside_m - offset_m
        return np.asarray(np.floor(away_m / self.width_m), np.int64)


def fit_lanes(
    offset_m: Floats, owner: Ints, line_m: Floats = NO_LINES, doubt_m: float = 0.0
) -> Lanes:
    """Find the lanes of the busiest carriageway among votes: offset and vehicle of each, (n,).

    `line_m` (k,) are the offsets of marks of painted lines, `doubt_m` is how far aside shadows may
    set all vehicles.  Raises ValueError without votes.
    """
    if not len(offset_m):
        raise ValueError("lanes need at least one vote")
    chosen = _busiest_cluster(offset_m, owner)
    offsets, owners = offset_m[chosen], owner[chosen]
    near = (line_m > offsets.min() - BESIDE_M) & (line_m < offsets.max() + BESIDE_M)
    share_m = float(np.hypot(SHARE_M, doubt_m))
    lanes = _comb(offsets, owners, line_m[near], share_m)
    index = lanes.counted_on(offsets)
    miss = np.abs(lanes.driven_at_m(index) - offsets)
    first, last = _occupied(index, miss / lanes.width_m, owners, _between(lanes, line_m[near]))
    inside = (index >= first) & (index <= last)
    lanes = _refine(lanes, offsets[inside], index[inside], line_m[near], share_m)
    left_m = lanes.left_edge_m - first * lanes.width_m
    return Lanes(left_m, last - first + 1, lanes.width_m, lanes.aside_m)


def _busiest_cluster(offset_m: Floats, owner: Ints) -> Ints:
    """Return the votes that no gap wider than a carriageway's separates from the most votes."""
    order = np.argsort(offset_m)
    # Two clusters' nearest votes are closer than their centres by the scatter of both.
    breaks = np.flatnonzero(np.diff(offset_m[order]) > MAX_GAP_M - 2 * SPREAD_M) + 1
    groups = np.split(order, breaks)
    return max(groups, key=lambda rows: (len(np.unique(owner[rows])), len(rows)))


def _comb(offset_m: Floats, owner: Ints, line_m: Floats, share_m: float) -> Lanes:
    """Return the spacing and the phase of the comb of lanes that votes and lines fit best."""
    widths = np.arange(MIN_WIDTH_M, MAX_WIDTH_M + 0.01, 0.05)
    steps = widths / PHASES
    phase = steps[:, None] * np.arange(PHASES)
    many = FEW if len(line_m) else MANY
    cost = min(len(np.unique(owner)), many) * _misfit(offset_m, phase, widths, SPREAD_M)
    aside: Ints = np.zeros(cost.shape, np.int64)
    if len(line_m):
        worth = LINE_WORTH * len(line_m)
        cost, aside = _set_aside(cost, steps, share_m)
        cost += worth * _misfit(line_m, phase + widths[:, None] / 2, widths, SEARCH_SIGMA_M)
    cost += (((widths - DEFAULT_WIDTH_M) / WIDTH_SIGMA_M) ** 2)[:, None]
    best = np.unravel_index(np.argmin(cost), cost.shape)
    width_m = float(widths[best[0]])
    aside_m = float(aside[best] * steps[best[0]])
    return Lanes(float(phase[best]) + width_m / 2, 1, width_m, aside_m)


def _misfit(offset_m: Floats, phase_m: Floats, width_m: Floats, sigma_m: float) -> Floats:
    """Return the mean squared sigmas from the nearest tooth of each comb, (widths, phases)."""
    some = offset_m[:: -(-len(offset_m) // MOST)]
    r = some - phase_m[..., None]
    r -= width_m[:, None, None] * np.round(r / width_m[:, None, None])
    return np.asarray(np.minimum((r / sigma_m) ** 2, WORST).mean(axis=2))


def _set_aside(cost: Floats, step_m: Floats, share_m: float) -> tuple[Floats, Ints]:
    """Return the least cost (widths, phases) if vehicles are all aside, and by how many steps."""
    by = np.arange(1 - PHASES // 2, PHASES // 2)
    moved = np.stack([np.roll(cost, -n, axis=1) for n in by])
    moved += ((by[:, None] * step_m / share_m) ** 2)[..., None]
    least = moved.argmin(axis=0)
    return np.take_along_axis(moved, least[None], 0)[0], by[least]


def _between(lanes: Lanes, line_m: Floats) -> range:
    """Return the lanes that lie between painted lines."""
    if not len(line_m):
        return range(0)
    edge = np.round((lanes.left_edge_m - line_m) / lanes.width_m)
    return range(int(edge.min()), int(edge.max()))


def _occupied(index: Ints, miss: Floats, owner: Ints, between: range) -> tuple[int, int]:
    """Return the first and last of the adjoining lanes that are used, around the busiest one.

    Less will do in the lanes `between` lines.
    """
    vehicles: dict[int, int] = {}
    needed = max(1.0, MIN_SHARE * len(np.unique(owner)))
    for lane in np.unique(index):
        votes = (index == lane) & (miss < IN_LANE)
        count = len(np.unique(owner[votes]))
        if count >= needed and (count > 1 or lane in between or votes.sum() >= MIN_VOTES):
            vehicles[int(lane)] = count
    if not vehicles:
        lane = int(np.bincount(index - index.min()).argmax() + index.min())
        return lane, lane
    first = last = max(vehicles, key=vehicles.__getitem__)
    while first - 1 in vehicles:
        first -= 1
    while last + 1 in vehicles:
        last += 1
    return first, last


def _refine(lanes: Lanes, offset_m: Floats, index: Ints, line_m: Floats, share_m: float) -> Lanes:
    """Return the comb's left edge, width and bias of vehicles, by robust least squares."""
    edge = np.round((lanes.left_edge_m - line_m) / lanes.width_m)
    on_edge = np.abs(lanes.left_edge_m - edge * lanes.width_m - line_m) < 3 * SEARCH_SIGMA_M
    edge, line_m = edge[on_edge], line_m[on_edge]
    if index.min() == index.max() and not len(line_m):
        middle_m = float(np.median(offset_m)) + (float(index[0]) + 0.5) * DEFAULT_WIDTH_M
        return Lanes(middle_m, 1, DEFAULT_WIDTH_M)
    away = np.concatenate([index + 0.5, edge])
    is_vehicle = np.arange(len(away)) < len(index)
    A = np.column_stack([np.ones(len(away)), -away, is_vehicle])
    seen_m = np.concatenate([offset_m, line_m])
    sigma_m = np.where(is_vehicle, SPREAD_M, LINE_SIGMA_M)
    worth = np.where(is_vehicle & (len(line_m) > 0), min(1.0, FEW / len(index)), 1.0)
    expected = np.array([0.0, DEFAULT_WIDTH_M, 0.0])
    prior = np.diag([0.0, WIDTH_SIGMA_M**-2, (share_m if len(line_m) else NOT_ASIDE_M) ** -2])
    solution = np.array([lanes.left_edge_m, lanes.width_m, lanes.aside_m])
    for _ in range(REFINEMENTS):
        r = np.abs(seen_m - A @ solution) / sigma_m
        weight = np.minimum(1.0, 1 / np.maximum(r, 1e-9)) * (r < 3) * worth / sigma_m**2
        normal = (A * weight[:, None]).T @ A + prior
        rhs = (A * weight[:, None]).T @ seen_m + prior @ expected
        solution = np.linalg.lstsq(normal, rhs, rcond=None)[0]
    width_m = float(np.clip(solution[1], MIN_WIDTH_M, MAX_WIDTH_M))
    return Lanes(float(solution[0]), 1, width_m, float(solution[2]))
