"""Vehicles in the lanes of the road view: from masks to intervals along each lane."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

import cv2
import numpy as np

from queuetail.types import Band, Bools, Floats, Image, LaneDetections, Masks, RoadRaster

CORE_M = 1.5  # the middle of a lane, which every vehicle in it covers
MIN_COVER = 0.38  # of the core, for a column to belong to a vehicle
CLOSE_M = 0.7  # holes in a vehicle (windscreens the colour of asphalt) up to this length
UNDER_M, BRIDGE_M, UNBROKEN = 2.2, 2.6, 0.9  # across and along: the line of shade under a sill
JOIN_M = 0.5  # breaks in an outline
HOLE_WIDTH_M = 2.2  # across the road: the widest hole that is filled, a vehicle's body
MIN_LENGTH_M = 2.0
LEAN_HEIGHT_M = 1.1  # bonnets and boots: what every vehicle stands above its footprint
TALL_LENGTH_M = 6.5  # longer vehicles may be tall enough to hide the next lane
TALL_HEIGHT_M, SIDE_SLACK_M = 4.0, 0.8
MIN_SIDE = 0.5  # of an interval along a tall vehicle, for the rest to be looked at
SIDE_COVER = 0.7  # of the line between the lanes, where a tall vehicle reaches over it
BRIGHT_COVER = 0.3  # of the core brighter than road, for a column that is surely not shadow
BRIGHT_SHARE = 0.3  # of a vehicle's columns, for it to show where its cast shadow ends
MEMORY = 40  # vehicles over which the cast shadow's length is taken
MAX_SHADOW_M = 6.0
UNEVEN_M = 2.5  # of dark end beyond the usual: another vehicle's shadow reaches it
BODY_COVER = 0.25  # of the core more than shadow, for a column that shows a body
BODY_SHARE = 0.25  # of a vehicle's columns, for it to show where its cast shadow ends
ONLY_SHADE = 0.15  # of the columns: with less, all may be shadow
SHADOW_REACH_M, SHADOW_LANES = 4.0, 2  # along and across the road, from a body to its shadow


@dataclass(slots=True)
class Interval:
    """Foreground along one lane, in raster columns and rows."""

    band: int
    lane: int
    rear: float
    front: float
    row: float
    cut: tuple[bool, bool]  # at the rear and front, by the end of what is seen
    contrast: float
    body: float
    shadow: bool = False


class LaneDetector:
    """Finds intervals of foreground along every lane of a road-view raster."""

    def __init__(self) -> None:
        self._shadows = CastShadows()

    def find(self, masks: Masks, raster: RoadRaster) -> LaneDetections:
        """Return the vehicles of all lanes, in raster columns and rows."""
        found: list[Interval] = []
        for number, band in enumerate(raster.bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            filled = fill_outlines(masks.foreign[part], raster.px_per_m)
            standing = footprints(filled, band.lean_px)
            shade = masks.shade[part]
            here = Masks(standing, masks.bright[part], shade, masks.contrast[part])
            body = cv2.bitwise_and(masks.foreign[part], cv2.bitwise_not(shade))
            dark = cv2.bitwise_and(masks.foreign[part], cv2.bitwise_not(masks.bright[part]))
            found += self._band(number, band, here, body, dark, raster.px_per_m)
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
        )

    def _band(
        self, number: int, band: Band, masks: Masks, body: Image, dark: Image, px_per_m: float
    ) -> list[Interval]:
        """Search one band's lanes, the nearest to the camera first."""
        lanes = range(1, len(band.lane_rows) + 1)
        away_is_left = float(band.lean_px[:, 1].mean()) < 0
        found: list[Interval] = []
        tall: list[Interval] = []
        for lane in reversed(lanes) if away_is_left else lanes:
            line = band.lane_rows[lane - 1] + band.lane_width_px / 2 * (1 if away_is_left else -1)
            kept = self._lane(number, band, lane, masks, body, dark, px_per_m)
            for t in tall:
                leaning = _side_columns(t, band, px_per_m)
                kept = [
                    piece
                    for i in kept
                    for piece in _beside(t, leaning, i, masks.foreign, line, px_per_m)
                ]
            found += kept
            tall = [i for i in kept if i.front - i.rear >= TALL_LENGTH_M * px_per_m]
        mark_shadows(found, SHADOW_REACH_M * px_per_m)
        return found

    def _lane(
        self,
        number: int,
        band: Band,
        lane: int,
        masks: Masks,
        body: Image,
        dark: Image,
        px_per_m: float,
    ) -> list[Interval]:
        standing = masks.foreign
        middle = band.lane_rows[lane - 1]
        half = max(CORE_M / 2 * px_per_m, 1.0)
        core = np.s_[max(round(middle - half), 0) : round(middle + half) + 1]
        cover = cv2.reduce(standing[core], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0] / 255
        shine = cv2.reduce(masks.bright[core], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0] / 255
        solid = cv2.reduce(body[core], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0] / 255
        shaded = bool(masks.shade.any())
        begin, end = band.visible_columns
        on = (cover >= MIN_COVER).astype(np.uint8)[None]
        on[:, :begin] = 0
        on[:, end:] = 0
        width = 2 * (max(round(CLOSE_M * px_per_m), 1) // 2) + 1
        on = cv2.morphologyEx(on, cv2.MORPH_CLOSE, np.ones((1, width), np.uint8))[0]
        half = UNDER_M / 2 * px_per_m
        sill = dark[max(round(middle - half), 0) : round(middle + half) + 1]
        under: Bools = np.any(sill, axis=0)
        on = bridged(on, under, BRIDGE_M * px_per_m)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], on, [0]])))
        found: list[Interval] = []
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            cut = first <= begin + 1, last >= end - 1
            if last - first < MIN_LENGTH_M * px_per_m and not any(cut):
                continue
            ends = _crossing(cover, first, -1), _crossing(cover, last, +1)
            shadowed = (
                dark_ends(solid[first:last], BODY_COVER, BODY_SHARE)
                if shaded
                else dark_ends(shine[first:last], BRIGHT_COVER, BRIGHT_SHARE)
            )
            ends = self._shadows.without(ends, shadowed, cut, px_per_m)
            share = float((solid[first:last] >= BODY_COVER).mean())
            shown = cv2.bitwise_and(standing, body) if share >= BODY_SHARE else standing
            row = _middle_row(shown, band, middle, first, last)
            contrast = float(masks.contrast[core, first:last].mean())
            found.append(Interval(number, lane, *ends, row, cut, contrast, share))
        return found


class CastShadows:
    """How far cast shadow lengthens vehicles at either end, learnt from bright vehicles.

    The sun is the same for all: where a bright body begins well after its dark silhouette, the
    difference is shadow, and dark vehicles, which hide it, have as much.
    """

    def __init__(self) -> None:
        # Metres behind and ahead, of the last bright vehicles, for low and for tall ones.
        self._ends_m: dict[bool, deque[tuple[float, float]]] = {
            False: deque(maxlen=MEMORY),
            True: deque(maxlen=MEMORY),
        }
        self._typical = {False: (0.0, 0.0), True: (0.0, 0.0)}

    def without(
        self,
        ends: tuple[float, float],
        dark: tuple[float, float] | None,
        cut: tuple[bool, bool],
        px_per_m: float,
    ) -> tuple[float, float]:
        """Return rear and front columns without shadow; `dark` is the dark length at each end."""
        rear, front = ends
        tall = front - rear >= TALL_LENGTH_M * px_per_m
        known = self._ends_m[tall]
        if dark is not None and max(dark) < MAX_SHADOW_M * px_per_m and not any(cut):
            known.append((dark[0] / px_per_m, dark[1] / px_per_m))
            self._typical[tall] = _median_ends(known)
        if len(known) < 3:
            return ends
        behind, ahead = (length_m * px_per_m for length_m in self._typical[tall])
        if dark is not None:
            uneven = UNEVEN_M * px_per_m
            behind = dark[0] if dark[0] > behind + uneven else behind
            ahead = dark[1] if dark[1] > ahead + uneven else ahead
        if front - rear - behind - ahead < MIN_LENGTH_M * px_per_m:
            return ends
        return rear + (0.0 if cut[0] else behind), front - (0.0 if cut[1] else ahead)


def _median_ends(ends_m: Iterable[tuple[float, float]]) -> tuple[float, float]:
    behind, ahead = zip(*ends_m, strict=True)
    return median(behind), median(ahead)


def dark_ends(shown: Floats, cover: float, share: float) -> tuple[float, float] | None:
    """Return how many columns at each end of a vehicle show no body; None where too few do.

    `shown` is each column's cover by what is surely no shadow.
    """
    body = np.flatnonzero(shown >= cover)
    if len(body) < share * len(shown):
        return None
    return float(body[0]), float(len(shown) - 1 - body[-1])


def bridged(on: Image, under: Bools, longest: float) -> Image:
    """Join runs of columns (n,) that are `on` where a dark line goes on from one to the next.

    A body the colour of asphalt shows its windows, and the line of shade along its sill.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on, [0]])))
    joined = on.copy()
    for end, begin in zip(edges[1:-1:2].tolist(), edges[2::2].tolist(), strict=True):
        if begin - end <= longest and under[end:begin].mean() >= UNBROKEN:
            joined[end:begin] = 1
    return joined


def mark_shadows(intervals: Sequence[Interval], reach: float) -> None:
    """Mark the intervals of one band that show only shade, beside or near a body that casts it."""
    bodies = [i for i in intervals if i.body >= BODY_SHARE]
    for interval in intervals:
        interval.shadow = interval.body < ONLY_SHADE and any(
            0 < abs(caster.lane - interval.lane) <= SHADOW_LANES
            and caster.rear < interval.front + reach
            and caster.front > interval.rear - reach
            for caster in bodies
        )


def fill_outlines(foreign: Image, px_per_m: float) -> Image:
    """Fill what an outline encloses: the body of a vehicle the colour of asphalt.

    Columns are closed across the road, where the two sides of an outline are a vehicle apart.
    """
    join = 2 * (max(round(JOIN_M * px_per_m), 1) // 2) + 1
    joined = cv2.morphologyEx(foreign, cv2.MORPH_CLOSE, np.ones((join, join), np.uint8))
    across = 2 * (max(round(HOLE_WIDTH_M * px_per_m), 1) // 2) + 1
    return cv2.morphologyEx(joined, cv2.MORPH_CLOSE, np.ones((across, 1), np.uint8))


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
    bounds = np.linspace(0, width, len(lean_px) + 1).astype(int)
    for lean, first, last in zip(lean_px, bounds[:-1], bounds[1:], strict=True):
        kept = standing[:, first:last]
        for share in (0.5, 1.0):
            dx, dy = (round(v) for v in lean * LEAN_HEIGHT_M * share)
            kept &= padded[reach + dy : reach + dy + height, reach + first + dx : reach + last + dx]
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
    weight = standing[top:bottom, first:last].mean(axis=1)
    total = float(weight.sum())
    if total <= 0:
        return middle
    return top + 0.5 + float(weight @ np.arange(len(weight))) / total


def _side_columns(tall: Interval, band: Band, px_per_m: float) -> tuple[float, float]:
    """Return the columns that a tall vehicle's side may cover in the next lane."""
    block = int(np.clip(tall.rear / band.columns, 0.0, 0.999) * len(band.lean_px))
    along = float(band.lean_px[block][0]) * TALL_HEIGHT_M
    slack = SIDE_SLACK_M * px_per_m
    return tall.rear + min(along, 0.0) - slack, tall.front + max(along, 0.0) + slack


def _beside(
    tall: Interval,
    leaning: tuple[float, float],
    interval: Interval,
    standing: Image,
    line_row: float,
    px_per_m: float,
) -> list[Interval]:
    """Return what of an interval is more than the side of a tall vehicle in the nearer lane.

    That may be nothing, or what stands before and behind the side, joined to it in the picture.
    """
    first, last = max(interval.rear, tall.rear), min(interval.front, tall.front)
    if last - first < MIN_SIDE * (interval.front - interval.rear):
        return [interval]
    half = max(0.3 * px_per_m, 1.0)
    between = standing[
        max(round(line_row - half), 0) : round(line_row + half) + 1, max(int(first), 0) : int(last)
    ]
    if not between.size or between.mean() / 255 <= SIDE_COVER:
        return [interval]
    pieces = []
    least = MIN_LENGTH_M * px_per_m
    if leaning[0] - interval.rear >= least:
        cut = interval.cut[0], False
        pieces.append(dataclasses.replace(interval, front=leaning[0], cut=cut))
    if interval.front - leaning[1] >= least:
        cut = False, interval.cut[1]
        pieces.append(dataclasses.replace(interval, rear=leaning[1], cut=cut))
    return pieces
