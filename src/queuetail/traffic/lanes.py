"""Lanes from lateral offsets: how many there are, how wide, and where the left edge lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from queuetail.types import Floats, Ints

DEFAULT_WIDTH_M = 3.5
MIN_WIDTH_M, MAX_WIDTH_M = 2.7, 4.5
WIDTH_SIGMA_M = 0.5  # how far lanes differ from the default
SPREAD_M = 0.45  # of a vehicle's mean offset about its lane's centre
MAX_GAP_M = 1.5 * DEFAULT_WIDTH_M  # between lane centres of one carriageway
MIN_SHARE = 0.04  # of the vehicles: fewer are strays, no lane
MIN_VOTES = 2  # of a lane's only vehicle
IN_LANE = 0.3  # of the width from the centre


@dataclass(frozen=True, slots=True)
class Lanes:
    """A carriageway across: lane 0 is the left-most, its centre half a width right of the edge."""

    left_edge_m: float  # offset of the left edge of the left lane
    count: int
    width_m: float

    @property
    def centres_m(self) -> Floats:
        """Offsets of the lanes' centres, from the left, (count,)."""
        return np.asarray(self.left_edge_m - (np.arange(self.count) + 0.5) * self.width_m)

    def index(self, offset_m: Floats) -> Ints:
        """Return the lane of each offset (n,), the nearest one for offsets beside the lanes."""
        lane = np.floor((self.left_edge_m - offset_m) / self.width_m).astype(np.int64)
        return np.clip(lane, 0, self.count - 1)


def fit_lanes(offset_m: Floats, owner: Ints) -> Lanes:
    """Find the lanes of the busiest carriageway among votes: offset and vehicle of each, (n,).

    Raises ValueError without votes.
    """
    if not len(offset_m):
        raise ValueError("lanes need at least one vote")
    chosen = _busiest_cluster(offset_m, owner)
    offsets, owners = offset_m[chosen], owner[chosen]
    width_m, phase_m = _comb(offsets, owners)
    index = np.round((phase_m - offsets) / width_m).astype(np.int64)
    first, last = _occupied(index, np.abs(phase_m - index * width_m - offsets) / width_m, owners)
    inside = (index >= first) & (index <= last)
    centre_m, width_m = _refine(offsets[inside], index[inside], width_m)
    return Lanes(centre_m - (first - 0.5) * width_m, last - first + 1, width_m)


def _busiest_cluster(offset_m: Floats, owner: Ints) -> Ints:
    """Return the votes that no gap wider than a carriageway's separates from the most votes."""
    order = np.argsort(offset_m)
    # Two clusters' nearest votes are closer than their centres by the scatter of both.
    breaks = np.flatnonzero(np.diff(offset_m[order]) > MAX_GAP_M - 2 * SPREAD_M) + 1
    groups = np.split(order, breaks)
    return max(groups, key=lambda rows: (len(np.unique(owner[rows])), len(rows)))


def _comb(offset_m: Floats, owner: Ints) -> tuple[float, float]:
    """Return the spacing and the phase of the comb of lane centres that fits the votes best."""
    widths = np.arange(MIN_WIDTH_M, MAX_WIDTH_M + 0.01, 0.05)
    shares = np.linspace(0.0, 1.0, 40, endpoint=False)
    phase = widths[:, None] * shares
    r = offset_m - phase[..., None]
    r -= widths[:, None, None] * np.round(r / widths[:, None, None])
    misfit = np.minimum((r / SPREAD_M) ** 2, 4.0).mean(axis=2)
    evidence = min(len(np.unique(owner)), 30)
    cost = evidence * misfit + (((widths - DEFAULT_WIDTH_M) / WIDTH_SIGMA_M) ** 2)[:, None]
    best = np.unravel_index(np.argmin(cost), cost.shape)
    return float(widths[best[0]]), float(phase[best])


def _occupied(index: Ints, miss: Floats, owner: Ints) -> tuple[int, int]:
    """Return the first and last of the adjoining lanes that are used, around the busiest one."""
    vehicles: dict[int, int] = {}
    needed = max(1.0, MIN_SHARE * len(np.unique(owner)))
    for lane in np.unique(index):
        votes = (index == lane) & (miss < IN_LANE)
        count = len(np.unique(owner[votes]))
        if count >= needed and (count > 1 or votes.sum() >= MIN_VOTES):
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


def _refine(offset_m: Floats, index: Ints, width_m: float) -> tuple[float, float]:
    """Return the offset of lane 0's centre and the width, by robust least squares."""
    if index.min() == index.max():
        centre = float(np.median(offset_m))
        return centre + float(index[0]) * DEFAULT_WIDTH_M, DEFAULT_WIDTH_M
    A = np.column_stack([np.ones(len(index)), -index.astype(float)])
    solution = np.array([np.median(offset_m + index * width_m), width_m])
    prior = np.diag([0.0, (SPREAD_M / WIDTH_SIGMA_M) ** 2])
    for _ in range(5):
        r = np.abs(offset_m - A @ solution)
        weight = np.minimum(1.0, SPREAD_M / np.maximum(r, 1e-9)) * (r < 3 * SPREAD_M)
        normal = (A * weight[:, None]).T @ A + prior
        rhs = (A * weight[:, None]).T @ offset_m + prior @ [0.0, DEFAULT_WIDTH_M]
        solution = np.linalg.lstsq(normal, rhs, rcond=None)[0]
    return float(solution[0]), float(np.clip(solution[1], MIN_WIDTH_M, MAX_WIDTH_M))
