"""Painted lines along the approaches: where the picture shows them, by telemetry's measure.

The luma is read on a grid of stations and offsets.  A line is a ridge across the road: brighter
than what lies on both its sides.  Vehicles pass and shadows have edges but no ridges, so the mean
over pictures and over a dash and its gap keeps the paint.  Where the asphalt ends is seen in the
mean brightness of the same grid (`road_edges`).

Source: Veit et al., Evaluation of road marking feature extraction (2008): of the plain extractors,
the symmetrical local threshold, which compares with both sides, does best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.geo.ground import enu_to_px
from queuetail.traffic.lane_evidence import MAD_SIGMA, NO_MARKS, WINDOW_M, LineMarks
from queuetail.traffic.road import length_m, locate, place
from queuetail.traffic.verges import Verges, together
from queuetail.types import Approach, Bools, Floats, GroundMapping, Image, Ints
from queuetail.vision.road_edges import steps

ALONG_M, ACROSS_M = 0.75, 0.1  # of the grid
BESIDE_M = 8.0  # of the lanes, as far as telemetry may be off
STEP_S = 0.25
SIDE_M, SIDE_PX = 0.35, 1.6  # from a line's middle to the asphalt beside it
MAX_GSD_M = 0.25  # across the road: beyond, a gravel verge is as narrow as a line
MIN_PICTURES = 6
STRAY = 30.0  # levels: no picture counts for more, be it of a white roof
MIN_LEVELS = 1.0
MIN_CLARITY = 6.0  # standard errors above what is near,
MIN_SPREADS = 4.5  # and above what asphalt with its blotches shows all over
NEAR_M = 1.0
LEAST_ERROR = 0.1  # levels
MIN_APART_M = 0.6
MOST_SKEW, SKEW_AT_END_M = 0.08, 0.12  # metres aside per metre along, and what windows resolve
LONG_M, ENOUGH = 36.0, 12  # of road where a short window tells no paint from coarse asphalt


class LaneLines:
    """Gathers ridges and brightness in the lanes of the approaches and beside, for some seconds."""

    def __init__(self, approaches: Sequence[Approach]) -> None:
        self._approaches = tuple(approaches)
        self._grids: tuple[_Grid | None, ...] | None = None
        self._last_s = -np.inf

    def update(self, luma: Image, mapping: GroundMapping, t_s: float) -> None:
        """Take in a picture (h, w); those that follow the last one too closely are passed over."""
        if t_s - self._last_s < STEP_S:
            return
        self._last_s = t_s
        if self._grids is None:
            self._grids = tuple(_Grid.seen(a, mapping, luma.shape) for a in self._approaches)
        for grid in self._grids:
            if grid is not None:
                grid.add(luma, mapping)

    @property
    def marks(self) -> LineMarks:
        """Return where lines are, by the mappings that the pictures came with."""
        parts = [NO_MARKS]
        before: list[_Grid] = []
        for grid in self._grids or ():
            if grid is None or grid.pictures < MIN_PICTURES:
                continue
            marks = _marks(grid)
            for other in before:  # carriageways side by side see each other's lines
                new = ~other.covers(marks.enu)
                marks = LineMarks(marks.enu[new], marks.course[new])
            parts.append(marks)
            before.append(grid)
        return LineMarks(
            np.concatenate([p.enu for p in parts]), np.concatenate([p.course for p in parts])
        )

    @property
    def verges(self) -> Verges:
        """Return where the asphalt may end beside the lanes, by the same mappings."""
        return together(
            [
                steps(grid.approach, number, grid.station_m, grid.offset_m, grid.level)
                for number, grid in enumerate(self._grids or ())
                if grid is not None and grid.pictures >= MIN_PICTURES
            ]
        )


class _Grid:
    """Stations by offsets of one approach, and the mean ridge and brightness at each."""

    def __init__(self, approach: Approach, station_m: Floats, offset_m: Floats) -> None:
        self.approach, self.station_m, self.offset_m = approach, station_m, offset_m
        s, d = np.meshgrid(station_m, offset_m, indexing="ij")
        self._enu = place(approach, s.ravel(), d.ravel())
        self._sum = np.zeros(s.shape, np.float32)
        self._count = np.zeros(s.shape, np.float32)
        self._level = np.zeros(s.shape, np.float32)  # sum of brightness
        self.pictures = 0

    @classmethod
    def seen(
        cls, approach: Approach, mapping: GroundMapping, shape: tuple[int, ...]
    ) -> _Grid | None:
        """Return the grid over the stations that a picture shows finely enough, if any."""
        station = approach.start_station_m + np.arange(ALONG_M / 2, length_m(approach), ALONG_M)
        width_m = approach.lanes * approach.lane_width_m
        middle = np.full(len(station), -width_m / 2)
        px = enu_to_px(mapping, place(approach, station, middle))
        gsd_m = _gsd_m(approach, mapping, station, middle)
        with np.errstate(invalid="ignore"):
            shown = ((px > 0) & (px < np.array(shape[1::-1]))).all(axis=1) & (gsd_m < MAX_GSD_M)
        if shown.sum() * ALONG_M < 2 * WINDOW_M:
            return None
        first, last = np.flatnonzero(shown)[[0, -1]]
        offset = np.arange(-width_m - BESIDE_M, BESIDE_M + ACROSS_M / 2, ACROSS_M)
        return cls(approach, station[first : last + 1], offset)

    def add(self, luma: Image, mapping: GroundMapping) -> None:
        """Take in the ridges of a picture."""
        shape = self._sum.shape
        px = enu_to_px(mapping, self._enu).astype(np.float32).reshape(*shape, 2)
        height, width = luma.shape
        inside = (px > 1).all(axis=2) & (px[..., 0] < width - 1) & (px[..., 1] < height - 1)
        seen = cv2.remap(luma, px - np.float32(0.5), None, cv2.INTER_LINEAR).astype(np.float32)
        ridge = self._ridge(seen, mapping)
        inside &= np.isfinite(ridge)
        self._sum += np.where(inside, np.clip(ridge, -STRAY, STRAY), 0.0)
        self._level += np.where(inside, seen, 0.0)
        self._count += inside
        self.pictures += 1

    @property
    def level(self) -> Floats:
        """Return the mean brightness (stations, offsets); NaN where few pictures show it."""
        seen = self._count > self.pictures / 2
        return np.where(seen, self._level / np.fmax(self._count, 1), np.nan)

    @property
    def length_m(self) -> float:
        """Return the length of the road that the grid lies over."""
        return len(self.station_m) * ALONG_M

    def covers(self, enu: Floats) -> Bools:
        """Tell which points (n, 2) the grid lies over."""
        station, offset, _ = locate(self.approach, enu)
        along = (station > self.station_m[0]) & (station < self.station_m[-1])
        return np.asarray(along & (offset > self.offset_m[0]) & (offset < self.offset_m[-1]))

    def windows(self, length_m: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the middles and skews of windows (w,), and mean ridges and their clarity (w, n).

        A wrong heading sets lines askew: every window is sheared until they stand out the most.
        """
        rows = round(length_m / ALONG_M)
        starts = np.arange(0, len(self.station_m) - rows + 1, rows)
        used = len(starts) * rows
        seen = self._count[:used] > self.pictures / 2
        ridge = np.where(seen, self._sum[:used] / np.fmax(self._count[:used], 1), 0.0)
        ridge = ridge.reshape(len(starts), rows, -1)
        seen = seen.reshape(ridge.shape)
        along_m = (np.arange(rows) - (rows - 1) / 2) * ALONG_M
        skews = np.arange(-MOST_SKEW, MOST_SKEW + 1e-6, SKEW_AT_END_M / length_m)
        tried = [_along(ridge, seen, along_m * skew) for skew in skews]
        means, clarities = (np.stack(values) for values in zip(*tried, strict=True))
        distinct = (np.maximum(clarities - MIN_CLARITY / 2, 0.0) ** 2).sum(axis=2)
        best, window = np.argmax(distinct, axis=0), np.arange(len(starts))
        middle_m = self.station_m[starts] + along_m[-1]
        return middle_m, skews[best], means[best, window], clarities[best, window]

    def _ridge(self, seen: Floats, mapping: GroundMapping) -> Floats:
        """Return by how much every cell is brighter than the brighter of its two sides."""
        station = self.station_m
        middle = np.full(len(station), float(self.offset_m.mean()))
        gsd_m = _gsd_m(self.approach, mapping, station, middle)
        side_m = np.fmax(SIDE_M, SIDE_PX * gsd_m)
        side = np.round(side_m / ACROSS_M).astype(np.int64)[:, None]
        columns = np.arange(len(self.offset_m))
        left, right = columns + side, columns - side
        rows = np.arange(len(station))[:, None]
        last = len(columns) - 1
        beside = np.maximum(seen[rows, np.clip(left, 0, last)], seen[rows, np.clip(right, 0, last)])
        return np.where((left <= last) & (right >= 0), seen - beside, np.nan)


def _along(ridge: Floats, seen: Bools, aside_m: Floats) -> tuple[Floats, Floats]:
    """Return mean ridges along lines that run askew, and their clarity; (w, rows, n) -> (w, n).

    Clarity is how many standard errors a mean lies above those beside it.
    """
    shift = np.round(aside_m / ACROSS_M).astype(np.int64)
    ridge, seen = _sheared(ridge, shift), _sheared(seen, shift)
    count = seen.sum(axis=0)
    mean = ridge.sum(axis=0) / np.fmax(count, 1)
    spread = np.where(seen, (ridge - mean) ** 2, 0.0).sum(axis=0) / np.fmax(count - 1, 1)
    near = round(NEAR_M / ACROSS_M)
    error = np.sqrt(cv2.blur(spread, (2 * near + 1, 1)) / np.fmax(count, 1) + LEAST_ERROR**2)
    # At a step of brightness ridges are low on one side only.
    beside = [cv2.blur(mean, (near, 1), anchor=(end, 0)) for end in (0, near - 1)]
    clarity = (mean - np.maximum(*beside)) / error
    return mean, np.where(count > len(shift) / 2, clarity, -np.inf)


def _sheared(values: NDArray[Any], shift: Ints) -> NDArray[Any]:
    """Return rows, each moved round to the left by its shift; (w, rows, n) -> (rows, w, n)."""
    n = values.shape[2]
    twice = np.concatenate([values, values], axis=2)
    return np.stack([twice[:, row, k : k + n] for row, k in enumerate((shift % n).tolist())])


def _gsd_m(
    approach: Approach, mapping: GroundMapping, station_m: Floats, offset_m: Floats
) -> Floats:
    """Return how much ground across the road a pixel covers, (n,)."""
    here, there = (
        enu_to_px(mapping, place(approach, station_m, offset_m + aside)) for aside in (-0.5, 0.5)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(1.0 / np.linalg.norm(there - here, axis=1))


def _marks(grid: _Grid) -> LineMarks:
    """Return the marks of short windows, and of long ones where no short one shows anything."""
    found = _offsets(grid, WINDOW_M)
    if len(found) < ENOUGH and grid.length_m >= LONG_M:
        longer = _offsets(grid, LONG_M)
        apart = np.abs(longer[:, None] - found[None])
        known = (apart[..., 0] < WINDOW_M / 2) & (apart[..., 1] < MIN_APART_M)
        found = np.concatenate([found, longer[~known.any(axis=1)]])
    enu = place(grid.approach, found[:, 0], found[:, 1]).reshape(-1, 2)
    return LineMarks(enu, locate(grid.approach, enu)[2])


def _offsets(grid: _Grid, length_m: float) -> Floats:
    """Return stations and offsets (n, 2) of marks, one for each `WINDOW_M` of a window's lines."""
    middle_m, skew, mean, clarity = grid.windows(length_m)
    shown = np.abs(clarity[np.isfinite(clarity)])
    if not len(shown):
        return np.zeros((0, 2))
    least = max(MIN_CLARITY, MIN_SPREADS * MAD_SIGMA * float(np.median(shown)))
    pieces = round(length_m / WINDOW_M)
    along_m = (np.arange(pieces) - (pieces - 1) / 2) * WINDOW_M
    found = [
        (station_m + ahead_m, grid.offset_m[0] + column * ACROSS_M + askew * ahead_m)
        for station_m, askew, profile, clear in zip(middle_m, skew, mean, clarity, strict=True)
        for column in _peaks(profile, clear, least)
        for ahead_m in along_m.tolist()
    ]
    return np.array(found).reshape(-1, 2)


def _peaks(mean: Floats, clarity: Floats, least: float) -> list[float]:
    """Return the columns, to a fraction, of a profile's maxima (n,) clearer than `least`."""
    left = np.where(mean > MIN_LEVELS, clarity, -np.inf)
    found: list[float] = []
    reach = round(MIN_APART_M / ACROSS_M)
    while left.max() > least:
        top = int(np.argmax(left))
        around = slice(max(top - reach, 0), top + reach + 1)
        columns, ridge = np.arange(len(mean))[around], mean[around]
        above = np.maximum(ridge - ridge.max() / 2, 0.0)  # strays are cut: its top may be flat
        found.append(float(columns @ above / above.sum()))
        left[around] = -np.inf
    return found
