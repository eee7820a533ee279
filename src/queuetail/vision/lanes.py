"""Vehicles in the lanes of the road view: from masks to intervals along each lane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.types import Band, Bools, Floats, Image, LaneDetections, Masks, RoadRaster
from queuetail.vision.cast_shadows import BODY_SHARE, CastShadows, ShadowReach, dark_ends
from queuetail.vision.flow import LaneFlow
from queuetail.vision.lane_interval import MIN_LENGTH_M, Interval
from queuetail.vision.occlusion import ROOF_M, LaneRows, lane_edge, lane_rows
from queuetail.vision.outlines import (
    BRIDGE_M,
    bridged,
    fill_outlines,
    joint_px,
    sill_line,
    silled,
    under_sill,
    without_gaps,
)

MIN_COVER = 0.38  # of the core, for a column to belong to a vehicle
LEAN_HEIGHT_M = 1.1  # bonnets and boots: what every vehicle stands above its footprint
OWN_SHADOW_M = 1.3  # of a known car's length at either end, which may be its shadow
MOSTLY_PARTLY = 0.5  # of an interval's columns half hidden: its place across the lane is not told
BRIGHT_COVER = 0.3  # of the core brighter than road, for a column that is surely not shadow
BRIGHT_SHARE = 0.3  # of a vehicle's columns, for it to show where its cast shadow ends
BODY_COVER = 0.25  # of the core more than shadow, for a column that shows a body
MAY_BE_TWO_M = 6.5  # an interval that is longer may show two vehicles
FINE_PX_PER_M, MOST_LEAN = 3.0, 0.35  # with less, or more lean along the road, no gaps show
MOST_TAKEN = 0.1  # by vehicles in a lane, of what is astride of two


@dataclass(frozen=True, slots=True)
class BandMasks:
    """What one band shows, each (rows, columns)."""

    silhouettes: Image  # what is not road, without holes, cast shadow included
    standing: Image  # the part of it that stands on the road
    bodies: Image  # and of that what is no cast shadow
    bright: Image  # brighter than road
    body: Image  # not road and not cast shadow
    dark: Image  # not road and not brighter
    contrast: NDArray[np.float32]
    shaded: bool  # whether any cast shadow is known


class LaneDetector:
    """Finds intervals of foreground along every lane of a road-view raster."""

    def __init__(self) -> None:
        self._shadows, self._reach = CastShadows(), ShadowReach()
        self._flow = LaneFlow()

    def find(self, masks: Masks, raster: RoadRaster, low: tuple[Bools, ...] = ()) -> LaneDetections:
        """Return the vehicles of all lanes, in raster columns and rows, and how the lanes move.

        `low` says of each band (lanes, columns) where vehicles are known to be no taller than cars.
        """
        found: list[Interval] = []
        speeds = self._flow.measure(raster)
        hidden: list[Bools] = []
        for number, band in enumerate(raster.bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            filled, bodies = fill_outlines(
                masks.foreign[part], raster.px_per_m, float(band.lean_px[:, 1].mean())
            )
            standing = footprints(filled, band.lean_px)
            body = cv2.bitwise_and(masks.foreign[part], cv2.bitwise_not(masks.shade[part]))
            body = cv2.bitwise_or(body, bodies)
            seen = BandMasks(
                silhouettes=filled,
                standing=standing,
                bodies=cv2.bitwise_and(standing, body),
                bright=masks.bright[part],
                body=body,
                dark=cv2.bitwise_and(masks.foreign[part], cv2.bitwise_not(masks.bright[part])),
                contrast=masks.contrast[part],
                shaded=bool(masks.shade[part].any()),
            )
            cars = low[number] if number < len(low) else None
            rows = lane_rows(cv2.bitwise_and(filled, body), band, raster.px_per_m, cars)
            found += self._band(number, band, seen, rows, cars, raster.px_per_m)
            hidden.append(np.array([r.hidden for r in rows], np.bool_))
        for speed, hides in zip(speeds, hidden, strict=True):
            speed[hides] = np.nan
        return LaneDetections(
            band=np.array([i.band for i in found], np.int64),
            lane=np.array([i.lane for i in found], np.int64),
            rear_column=np.array([i.rear for i in found], float),
            front_column=np.array([i.front for i in found], float),
            row=np.array([i.row for i in found], float),
            cut_rear=np.array([i.cut[0] for i in found], np.bool_),
            cut_front=np.array([i.cut[1] for i in found], np.bool_),
            contrast=np.array([i.contrast for i in found], float),
            body=np.array([i.body for i in found], float),
            shadow=np.array([i.shadow for i in found], np.bool_),
            roof=np.array([i.roof for i in found], np.bool_),
            astride=np.array([i.astride for i in found], np.bool_),
            bodies=tuple(np.array(i.bodies).reshape(-1, 2) for i in found),
            speed_mps=tuple(speeds),
            hidden=tuple(hidden),
        )

    def _band(
        self,
        number: int,
        band: Band,
        seen: BandMasks,
        rows: Sequence[LaneRows],
        cars: Bools | None,
        px_per_m: float,
    ) -> list[Interval]:
        """Search one band's lanes."""
        found: list[Interval] = []
        for lane, visible in enumerate(rows, 1):
            known = None if cars is None else cars[lane - 1]
            found += self._lane(number, band, lane, seen, visible, known, px_per_m)
        self._reach.mark(found, len(rows), px_per_m)
        return found + self._astride(number, band, seen, rows, found, px_per_m)

    def _astride(
        self,
        number: int,
        band: Band,
        seen: BandMasks,
        rows: Sequence[LaneRows],
        in_lanes: Sequence[Interval],
        px_per_m: float,
    ) -> list[Interval]:
        """Search between neighbouring lanes for what covers the middle of neither."""
        found: list[Interval] = []
        for lane, (left, right) in enumerate(pairwise(rows), 1):
            between = lane_edge(left, right, px_per_m, len(seen.standing))
            taken = between.hidden.copy()
            for interval in in_lanes:
                if lane <= interval.lane <= lane + 1:
                    taken[max(round(interval.rear), 0) : max(round(interval.front), 0)] = True
            on = (between.cover(seen.standing) >= 255 * MIN_COVER) & ~taken
            if np.count_nonzero(on) < MIN_LENGTH_M * px_per_m:
                continue
            for i in self._lane(number, band, lane, seen, between, None, px_per_m):
                inside = taken[max(round(i.rear), 0) : max(round(i.front), 0)]
                if i.body >= BODY_SHARE and _share(inside) <= MOST_TAKEN:
                    found.append(i)
        return found

    def _lane(
        self,
        number: int,
        band: Band,
        lane: int,
        seen: BandMasks,
        visible: LaneRows,
        cars: Bools | None,
        px_per_m: float,
    ) -> list[Interval]:
        middle = visible.middle
        cover = visible.cover(seen.standing, seen.silhouettes) / 255
        on = _standing_columns(cover, seen, band, middle, px_per_m)
        edges = np.flatnonzero(on[1:] != on[:-1]) + 1
        if not len(edges) and not on[0]:
            return []
        sure = visible.cover(seen.body if seen.shaded else seen.bright) / 255
        solid = sure if seen.shaded else visible.cover(seen.body) / 255
        kept = sure
        if cars is not None:
            # A dark car is not its neighbour's shadow; at its ends it may have one of its own.
            size = 2 * round(OWN_SHADOW_M * px_per_m) + 1
            inner = cv2.erode(cars.view(np.uint8)[None], np.ones((1, size), np.uint8))[0]
            kept = np.where(inner > 0, np.float32(1.0), sure)
        bounds = [*([0] if on[0] else []), *edges.tolist(), *([len(on)] if on[-1] else [])]
        begin, end = band.visible_columns
        found: list[Interval] = []
        for first, last in zip(bounds[::2], bounds[1::2], strict=True):
            cut = (
                first <= begin + 1 or bool(visible.hidden[first - 1]),
                last >= end - 1 or bool(visible.hidden[last]),
            )
            if last - first < MIN_LENGTH_M * px_per_m and not any(cut):
                continue
            ends = _crossing(cover, first, -1), _crossing(cover, last, +1)
            limits = (BODY_COVER, BODY_SHARE) if seen.shaded else (BRIGHT_COVER, BRIGHT_SHARE)
            dark = dark_ends(sure[first:last], *limits)
            most = dark if kept is sure else dark_ends(kept[first:last], *limits)
            if not visible.edge:
                ends = self._shadows.without(ends, dark, most, cut, px_per_m)
            share = _share(solid[first:last] >= BODY_COVER)
            roof = _share(visible.partly[first:last]) >= MOSTLY_PARTLY
            row = middle
            if roof:
                # What shows is the roof, which appears farther along the road by its lean.
                lean = float(band.lean_px[_block(band, first)][0]) * (ROOF_M - LEAN_HEIGHT_M / 2)
                ends = ends[0] - lean, ends[1] - lean
            else:
                shown = seen.bodies if share >= BODY_SHARE else seen.standing
                row = _middle_row(shown, band, middle, first, last)
            contrast = cv2.mean(seen.contrast[slice(*visible.core), first:last])[0]
            interval = Interval(number, lane, *ends, row, cut, contrast, share, roof)
            interval.astride = visible.edge
            may_be_two = seen.shaded and last - first > MAY_BE_TWO_M * px_per_m
            if may_be_two and not (roof or visible.edge) and _gaps_show(band, first, px_per_m):
                body = visible.cover(seen.bodies)[first:last] >= 255 * BODY_COVER
                interval.bodies = body_runs(body, first, px_per_m)
            found.append(interval)
        return found


def _gaps_show(band: Band, column: int, px_per_m: float) -> bool:
    """Tell whether the camera sees the road between vehicles that stand in a row at a column."""
    lean_m = abs(float(band.lean_px[_block(band, column)][0])) / px_per_m
    return px_per_m >= FINE_PX_PER_M and lean_m < MOST_LEAN


def _block(band: Band, column: int) -> int:
    """Return in which block of equal lean a column lies."""
    return min(int(column / band.columns * len(band.lean_px)), len(band.lean_px) - 1)


def body_runs(body: Bools, first: int, px_per_m: float) -> tuple[tuple[float, float], ...]:
    """Return the rears and fronts of the vehicles that columns (n,) from `first` on show.

    A windscreen parts nothing; what is too short is no vehicle.
    """
    beside = joint_px(px_per_m)  # room, so that nothing is joined to the end of the columns
    closed = without_gaps(np.pad(body.astype(np.uint8), beside), px_per_m)
    edges = np.flatnonzero(closed[1:] != closed[:-1]) + 1 - beside + first
    runs = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return tuple((rear, front) for rear, front in runs if front - rear >= MIN_LENGTH_M * px_per_m)


def _standing_columns(
    cover: Floats, seen: BandMasks, band: Band, middle: float, px_per_m: float
) -> Image:
    """Return which columns (n,) of a lane something stands on: its cover, and what joins it."""
    on = (cover >= MIN_COVER).astype(np.uint8)
    begin, end = band.visible_columns
    on[:begin] = 0
    on[end:] = 0
    closed = without_gaps(on, px_per_m)
    joined = bridged(closed, under_sill(seen.dark, middle, px_per_m), BRIDGE_M * px_per_m)
    line = sill_line(seen.dark, seen.bright, seen.silhouettes, band, middle, px_per_m)
    return silled(joined, line, px_per_m)


def footprints(solid: Image, lean_px: Floats) -> Image:
    """Keep what has foreground above it up to bonnet height: the part that stands on the road.

    A vehicle's silhouette is its footprint smeared away from the camera by its height; eroding it
    along that direction undoes the smear.
    """
    height, width = solid.shape
    reach = int(np.ceil(np.abs(lean_px).max(initial=0.0) * LEAN_HEIGHT_M)) + 1
    # Beyond the raster nothing is known: what would be seen there counts as foreground.
    padded = cv2.copyMakeBorder(
        solid, reach, reach, reach, reach, cv2.BORDER_CONSTANT | cv2.BORDER_ISOLATED, value=255
    )
    standing = solid.copy()
    bounds = np.linspace(0, width, len(lean_px) + 1).astype(int).tolist()
    for share in (0.5, 1.0):
        shifts = np.rint(lean_px * LEAN_HEIGHT_M * share).astype(int).tolist()
        begin = 0
        for block, (dx, dy) in enumerate(shifts):
            if block + 1 < len(shifts) and shifts[block + 1] == [dx, dy]:
                continue  # neighbours that lean alike are looked at in one go
            first, last = bounds[begin], bounds[block + 1]
            begin = block + 1
            above = padded[reach + dy : reach + dy + height, reach + first + dx : reach + last + dx]
            standing[:, first:last] &= above
    return standing


def _crossing(cover: Floats, edge: int, direction: int) -> float:
    """Refine an interval's end to where the cover crosses its threshold, in columns."""
    inside = edge if direction < 0 else edge - 1
    outside = edge - 1 if direction < 0 else edge
    if not (0 <= inside < len(cover) and 0 <= outside < len(cover)):
        return float(edge)
    high, low = float(cover[inside]), float(cover[outside])
    if high <= MIN_COVER or low >= MIN_COVER:
        return float(edge)
    share = (high - MIN_COVER) / (high - low)  # of the way from one column's centre to the next
    return edge + direction * (share - 0.5)


def _middle_row(standing: Image, band: Band, middle: float, first: int, last: int) -> float:
    """Return the row of an interval's middle, from its spread across the lane and a bit beyond."""
    half = 0.6 * band.lane_width_px
    top, bottom = max(round(middle - half), 0), min(round(middle + half), len(standing))
    part = standing[top:bottom, first:last]
    weight = cv2.reduce(part, 1, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[:, 0]
    total = float(weight.sum())
    if total <= 0:
        return middle
    return top + 0.5 + float(weight @ np.arange(len(weight), dtype=np.float32)) / total


def _share(which: Bools) -> float:
    """Return the share of columns (n,), n > 0, that are true."""
    return np.count_nonzero(which) / len(which)
