"""What tall vehicles hide of the lane behind them, seen from the camera.

A truck's silhouette reaches over the next lane by its height times the lean.  What stands there
shows beyond the silhouette, or not at all.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.types import Band, Bools, Floats, Image, Ints

CORE_M = 1.5  # the middle of a lane, which every vehicle in it covers
FAR_SIDE_M, ROOF_M = 0.9, 1.3  # of a car: from its lane's middle to its far side, and its height
RAGGED_M = 0.35  # how much farther than its usual reach a silhouette may go
LEAST_VISIBLE_M = 0.45  # across the lane: with less, what stands there is hidden
START_M = 0.6  # from a lane's middle outwards: inside every vehicle's far side
TALL_M, TALL_LEAN = 1.3, 2.2  # reach, per metre of lean on top, that no car's silhouette has
LEAST_LEAN_M = 0.08  # per metre of height: with less a truck hides nothing of the next lane
LONGER_THAN_CARS_M = 6.0  # a shorter peak along a silhouette is a car that touches it
TALL_HEIGHT_M, SLACK_M = 4.0, 0.8  # how far along the road a silhouette may lean
HOLE_M = 0.9  # windows and shade within a silhouette


@dataclass(frozen=True, slots=True)
class Beyond:
    """What a car shows beyond a tall vehicle: where `window` (rows, columns) is 255."""

    first_row: int
    window: Image
    rows: Floats  # (columns,) how many they are, at least 1


@dataclass(frozen=True, slots=True)
class LaneRows:
    """Where one lane is looked at: its core, or beyond a tall vehicle that hides some of it."""

    middle: float
    core: tuple[int, int]  # the rows about its middle, first and one after the last
    partly: Bools  # (columns,) some of the core is hidden
    hidden: Bools  # (columns,) too little shows beyond what hides it
    beyond: Beyond | None = None  # where it is partly hidden
    edge: bool = False  # it is no lane, but what is about the edge between two

    def cover(self, mask: Image, silhouettes: Image | None = None) -> Floats:
        """Return the mean of a mask (h, w) over the rows of every column, 0 … 255.

        `silhouettes` is looked at instead where the core is partly hidden.
        """
        mean = cv2.reduce(mask[slice(*self.core)], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0]
        if self.beyond is None:
            return np.asarray(mean)
        first = self.beyond.first_row
        looked = (mask if silhouettes is None else silhouettes)[first:][: len(self.beyond.window)]
        shown = cv2.bitwise_and(looked, self.beyond.window)
        total = cv2.reduce(shown, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F)[0]
        return np.where(self.partly, total / self.beyond.rows, mean)


def lane_rows(
    silhouettes: Image, band: Band, px_per_m: float, low: Bools | None = None
) -> list[LaneRows]:
    """Return the visible rows of every lane, left-most first.

    `silhouettes` (h, w) is what is seen of vehicles, without cast shadow; `low` (lanes, columns)
    where vehicles are known to be no taller than cars.
    """
    lean_px = float(band.lean_px[:, 1].mean())
    away = -1 if lean_px < 0 else 1
    lean_m = abs(lean_px) / px_per_m
    count = len(band.lane_rows)
    hole = 2 * (max(round(HOLE_M * px_per_m), 1) // 2) + 1
    solid = cv2.morphologyEx(silhouettes, cv2.MORPH_CLOSE, np.ones((hole, hole), np.uint8))
    found: list[LaneRows | None] = [None] * count
    blocked: Ints | None = None  # the row up to which nearer lanes hide what is farther away
    for lane in range(count) if away > 0 else reversed(range(count)):
        middle = band.lane_rows[lane]
        far = middle + away * (FAR_SIDE_M + ROOF_M * lean_m) * px_per_m
        found[lane] = _rows(middle, far, blocked, away, px_per_m, solid.shape)
        if lean_m < LEAST_LEAN_M:
            continue
        cars = None if low is None else low[lane]
        reach = _reach(solid, band, middle, away, lean_m, px_per_m, cars)
        if reach is not None:
            blocked = reach if blocked is None else away * np.maximum(away * reach, away * blocked)
    return [rows for rows in found if rows is not None]


def _rows(
    middle: float,
    far_side: float,
    blocked: Ints | None,
    away: int,
    px_per_m: float,
    shape: tuple[int, ...],
) -> LaneRows:
    height, columns = shape
    core = _core(middle, px_per_m, height)
    if blocked is None:
        nowhere = np.zeros(columns, np.bool_)
        return LaneRows(middle, core, nowhere, nowhere)
    partly = away * blocked >= away * (core[0] if away > 0 else core[1] - 1)
    far = int(np.clip(round(far_side), 0, height - 1))
    top, bottom = (blocked + 1, far + 1) if away > 0 else (far, blocked)
    top, bottom = np.broadcast_arrays(np.clip(top, 0, height), np.clip(bottom, 0, height))
    hidden = partly & (bottom - top < max(LEAST_VISIBLE_M * px_per_m, 1.0))
    return LaneRows(middle, core, partly, hidden, _beyond(top, bottom, partly, hidden))


def _beyond(top: Ints, bottom: Ints, partly: Bools, hidden: Bools) -> Beyond | None:
    """Return rows `top` … `bottom` (exclusive) of the partly hidden columns, None without any."""
    if not partly.any():
        return None
    last = max(int(bottom[partly].max()), 1)
    first = min(int(top[partly].min()), last - 1)
    row = np.arange(first, last)[:, None]
    shows = (row >= top) & (row < bottom) & partly & ~hidden
    window = np.where(shows, np.uint8(255), np.uint8(0))
    return Beyond(first, window, np.maximum(bottom - top, 1).astype(np.float32))


def lane_edge(left: LaneRows, right: LaneRows, px_per_m: float, height: int) -> LaneRows:
    """Return the rows about the edge between two lanes, hidden where some of either lane is."""
    middle = (left.middle + right.middle) / 2
    hidden = left.partly | left.hidden | right.partly | right.hidden
    core = _core(middle, px_per_m, height)
    return LaneRows(middle, core, np.zeros_like(hidden), hidden, edge=True)


def _core(middle: float, px_per_m: float, height: int) -> tuple[int, int]:
    half = max(CORE_M / 2 * px_per_m, 1.0)
    return max(round(middle - half), 0), min(round(middle + half) + 1, height)


def _reach(
    solid: Image,
    band: Band,
    middle: float,
    away: int,
    lean_m: float,
    px_per_m: float,
    low: Bools | None,
) -> Ints | None:
    """Return up to which row tall vehicles in a lane hide the lanes behind; None without any."""
    begin = round(middle + away * START_M * px_per_m)
    size = round(LONGER_THAN_CARS_M * px_per_m)
    if not 0 <= begin < len(solid) or size >= solid.shape[1]:
        return None
    outward = solid[begin:] if away > 0 else solid[begin::-1]
    tall_px = (TALL_M + TALL_LEAN * lean_m - START_M) * px_per_m
    if int(tall_px) >= len(outward) or np.count_nonzero(outward[int(tall_px)]) < size:
        return None
    open_road = outward == 0
    run = np.where(open_road.any(axis=0), open_road.argmax(axis=0), len(outward))
    run = run.astype(np.float32)[None]
    if low is not None:
        run[0, low] = 0.0
    smooth = cv2.morphologyEx(run, cv2.MORPH_OPEN, np.ones((1, size), np.uint8))
    if smooth.max() <= tall_px:
        return None
    leaning = _leaned(smooth, band, px_per_m)[0].astype(np.int64)
    nothing = -1 if away > 0 else len(solid)
    ragged = round(RAGGED_M * px_per_m)
    return np.where(leaning > tall_px, begin + away * (leaning - 1 + ragged), nothing)


def _leaned(reach: Floats, band: Band, px_per_m: float) -> Floats:
    """Spread a reach (1, columns) along the road as far as tall silhouettes lean there."""
    columns = reach.shape[1]
    bounds = np.linspace(0, columns, len(band.lean_px) + 1).astype(int)
    spread = np.empty_like(reach)
    for lean, first, last in zip(band.lean_px[:, 0], bounds[:-1], bounds[1:], strict=True):
        size = round(abs(float(lean)) * TALL_HEIGHT_M + SLACK_M * px_per_m)
        begin, end = max(first - size, 0), min(last + size, columns)
        wide = cv2.dilate(reach[:, begin:end], np.ones((1, 2 * size + 1), np.uint8))
        spread[:, first:last] = wide[:, first - begin : last - begin]
    return spread
