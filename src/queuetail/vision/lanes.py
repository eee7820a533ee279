"""Vehicles in the lanes of the road view: from masks to intervals along each lane."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from statistics import median

import cv2
import numpy as np

from queuetail.types import Band, Floats, Image, LaneDetections, Masks, RoadRaster

CORE_M = 1.5  # the middle of a lane, which every vehicle in it covers
MIN_COVER = 0.38  # of the core, for a column to belong to a vehicle
CLOSE_M = 0.7  # holes in a vehicle (windscreens the colour of asphalt) up to this length
JOIN_M = 0.5  # breaks in an outline
HOLE_WIDTH_M = 2.2  # across the road: the widest hole that is filled, a vehicle's body
MIN_LENGTH_M = 2.0
LEAN_HEIGHT_M = 1.1  # bonnets and boots: what every vehicle stands above its footprint
TALL_LENGTH_M = 6.5  # longer vehicles may be tall enough to hide the next lane
SIDE_COVER = 0.7  # of the line between the lanes, where a tall vehicle reaches over it
BRIGHT_COVER = 0.3  # of the core brighter than road, for a column that is surely not shadow
BRIGHT_SHARE = 0.3  # of a vehicle's columns, for it to show where its cast shadow ends
MEMORY = 40  # vehicles over which the cast shadow's length is taken
MAX_SHADOW_M = 6.0
# Of each interval: band, lane, rear and front column, row, cut at the rear and front, contrast.
Interval = tuple[int, int, float, float, float, bool, bool, float]


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
            here = Masks(standing, masks.bright[part], masks.contrast[part])
            found += self._band(number, band, here, raster.px_per_m)
        columns = list(zip(*found, strict=True)) if found else [()] * 8
        return LaneDetections(
            band=np.array(columns[0], np.int64),
            lane=np.array(columns[1], np.int64),
            rear_column=np.array(columns[2], float),
            front_column=np.array(columns[3], float),
            row=np.array(columns[4], float),
            cut_rear=np.array(columns[5], np.bool_),
            cut_front=np.array(columns[6], np.bool_),
            contrast=np.array(columns[7], float),
        )

    def _band(self, number: int, band: Band, masks: Masks, px_per_m: float) -> list[Interval]:
        """Search one band's lanes, the nearest to the camera first."""
        lanes = range(1, len(band.lane_rows) + 1)
        away_is_left = float(np.median(band.lean_px[:, 1])) < 0
        found: list[Interval] = []
        tall: list[Interval] = []
        for lane in reversed(lanes) if away_is_left else lanes:
            line = band.lane_rows[lane - 1] + band.lane_width_px / 2 * (1 if away_is_left else -1)
            kept = [
                i
                for i in self._lane(number, band, lane, masks, px_per_m)
                if not any(_is_side_of(t, i, masks.foreign, line, px_per_m) for t in tall)
            ]
            found += kept
            tall = [i for i in kept if i[3] - i[2] >= TALL_LENGTH_M * px_per_m]
        return found

    def _lane(
        self, number: int, band: Band, lane: int, masks: Masks, px_per_m: float
    ) -> list[Interval]:
        standing = masks.foreign
        middle = band.lane_rows[lane - 1]
        half = max(CORE_M / 2 * px_per_m, 1.0)
        core = np.s_[max(round(middle - half), 0) : round(middle + half) + 1]
        cover = cv2.reduce(standing[core], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0] / 255
        shine = cv2.reduce(masks.bright[core], 0, cv2.REDUCE_AVG, dtype=cv2.CV_32F)[0] / 255
        begin, end = band.visible_columns
        on = (cover >= MIN_COVER).astype(np.uint8)[None]
        on[:, :begin] = 0
        on[:, end:] = 0
        width = 2 * (max(round(CLOSE_M * px_per_m), 1) // 2) + 1
        on = cv2.morphologyEx(on, cv2.MORPH_CLOSE, np.ones((1, width), np.uint8))[0]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], on, [0]])))
        found: list[Interval] = []
        for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
            cut = first <= begin + 1, last >= end - 1
            if last - first < MIN_LENGTH_M * px_per_m and not any(cut):
                continue
            ends = _crossing(cover, first, -1), _crossing(cover, last, +1)
            ends = self._shadows.without(ends, dark_ends(shine[first:last]), cut, px_per_m)
            row = _middle_row(standing, band, middle, first, last)
            contrast = float(masks.contrast[core, first:last].mean())
            found.append((number, lane, *ends, row, *cut, contrast))
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
        if front - rear - behind - ahead < MIN_LENGTH_M * px_per_m:
            return ends
        return rear + (0.0 if cut[0] else behind), front - (0.0 if cut[1] else ahead)


def _median_ends(ends_m: Iterable[tuple[float, float]]) -> tuple[float, float]:
    behind, ahead = zip(*ends_m, strict=True)
    return median(behind), median(ahead)


def dark_ends(shine: Floats) -> tuple[float, float] | None:
    """Return how many columns at each end of a bright vehicle are dark; None for dark vehicles."""
    bright = np.flatnonzero(shine >= BRIGHT_COVER)
    if len(bright) < BRIGHT_SHARE * len(shine):
        return None
    return float(bright[0]), float(len(shine) - 1 - bright[-1])


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


def _is_side_of(
    tall: Interval, interval: Interval, standing: Image, line_row: float, px_per_m: float
) -> bool:
    """Tell whether an interval is only the side of a tall vehicle in the nearer lane."""
    first, last = max(interval[2], tall[2]), min(interval[3], tall[3])
    if last - first < 0.75 * (interval[3] - interval[2]):
        return False
    half = max(0.3 * px_per_m, 1.0)
    between = standing[
        max(round(line_row - half), 0) : round(line_row + half) + 1, max(int(first), 0) : int(last)
    ]
    return bool(between.size and between.mean() / 255 > SIDE_COVER)
