"""The road as it is without vehicles: a background that does not absorb what stops.

Asphalt is alike along a lane, so the first picture already tells the road from a queue that stands
on it: the most common brightness of each row is road, and what differs from it is not learnt.
Later every pixel learns only while no vehicle covers it.  Brightness is compared per stretch of
road, so that clouds and exposure steps are not vehicles.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.types import Band, Bools, Image, Masks, RoadRaster
from queuetail.vision.colour import RoadColour
from queuetail.vision.shade import CastShade

Picture = NDArray[np.float32]

SETTLE_S = 0.6  # learning time while the model is young
LEARN_EVERY_S = 0.15  # light and road change slowly
LEARN_S = 6.0  # and later: slow enough to average noise, fast enough for moving light
YOUNG_S = 3.0
CHECK_S, STILL_S, STILL_LEVELS = 0.4, 4.0, 8.0  # for what differs but is no vehicle
STILL_SHADE_S = 8.0
GHOST_S, GHOST_EDGES = 1.1, 1.8  # how much stronger a ghost's edges are in the learnt road
VEHICLE_EDGES = 11.0  # grey levels of slope that a learnt vehicle has, and asphalt has not
EDGE_WINDOW_M, EDGE_FLOOR = 1.6, 2.0
GAIN_WINDOW_M = 9.0  # stretch of road over which brightness is compared
GAIN_LIMITS = (0.25, 4.0)
MIN_THRESHOLD = 9.0  # grey levels
NOISE_SIGMAS, NOISE_RATE = 4.5, 0.3
NOISY = 2.8  # grey levels; below it, smoothing costs more in edges than it gains
EDGE_TOLERANCE = 0.45  # share of the local gradient: half a pixel of misregistration
CLOUD_RATIO = 1.25  # of the lightest to the darkest stretch of road: less is no cloud's edge
PLAIN_TOLERANCE = 12.0  # grey levels from a row's road at which a pixel is road for certain
STAIN_TOLERANCE = 40.0  # grey levels from a row's road that a stain or patch may have,
STAIN_SHARE = 0.3  # and no more than this share of the road's: at dusk cars differ by as little
PRIOR_TOLERANCE = 20.0  # grey levels from a row's road that the first picture may differ
GROW_M = 1.2  # vehicles are kept out of learning with this margin


class RoadBackground:
    """Separates vehicles from the road in road-view rasters."""

    def __init__(self) -> None:
        self._layout: RoadRaster | None = None
        self._road = np.zeros((0, 0), np.float32)
        self._bands: tuple[Band, ...] = ()
        self._noise = 2.0
        self._is_noisy = False  # and then pictures are smoothed, as in poor light
        self._began_s = self._last_s = 0.0
        self._shade = CastShade()
        self._colour = RoadColour()

    def apply(self, raster: RoadRaster, t_s: float, protect: Image) -> Masks:
        """Return what is not road in this frame.

        `protect` marks pixels that belong to known vehicles (255): they are never learnt.
        """
        image = raster.image
        if self._is_noisy and raster.bands:
            image = cv2.GaussianBlur(image, (3, 3), 0)
        if not raster.bands:
            return Masks(image, image, image, image.astype(np.float32))
        if self._layout is None or self._layout.plan != raster.plan:
            self._start(raster, t_s)
        self._layout, self._bands = raster, raster.bands
        self._light(image, protect)
        difference = cv2.subtract(image, self._lit, dtype=cv2.CV_32F)
        foreign = cv2.compare(cv2.absdiff(difference, 0.0), self._threshold, cv2.CMP_GT)
        seen = cv2.compare(image, 0, cv2.CMP_GT)
        foreign &= seen
        bright = cv2.compare(difference, self._threshold, cv2.CMP_GT)
        coloured = self._colour.foreign(raster, self._lit, foreign, protect, t_s)
        if coloured is not None:
            coloured &= seen
            foreign |= coloured
            bright |= coloured
        share = cv2.divide(image, self._lit, dtype=cv2.CV_32F)
        shade = self._shade.mask(share, cv2.bitwise_and(foreign, cv2.bitwise_not(bright)))
        self._learn(image, foreign, shade, protect, t_s)
        return Masks(foreign, bright, shade, cv2.absdiff(share, 1.0))

    def _start(self, raster: RoadRaster, t_s: float) -> None:
        """Believe the first picture where it looks like its row's road, and the row elsewhere.

        Road that an earlier layout showed as well is kept as it was learnt.
        """
        image, old_road, old = raster.image, self._road, self._layout
        self._began_s = self._last_s = t_s
        self._road = np.zeros(image.shape, np.float32)
        self._lit = np.zeros(image.shape, np.float32)
        self._threshold = np.full(image.shape, MIN_THRESHOLD, np.float32)
        self._covered = np.zeros(image.shape, np.uint8)
        self._bare = np.zeros(image.shape, np.uint8)  # where sunlit road was seen
        self._before = image.copy()
        self._still_s = np.zeros(image.shape, np.float32)
        self._checked_s = t_s
        self._gain = np.ones((len(raster.bands), image.shape[1]), np.float32)
        grow = max(round(GROW_M * raster.px_per_m), 1)
        self._grow = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * grow + 1, 3))
        self._px_per_m = raster.px_per_m
        self._window = max(round(GAIN_WINDOW_M * raster.px_per_m), 1)
        for band in raster.bands:
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            picture = _evenly_lit(image[part].astype(np.float32), self._window)
            profile = _row_modes(picture)[:, None]
            alike = np.abs(picture - profile) < PRIOR_TOLERANCE
            self._road[part] = np.where(alike, picture, profile)
            self._covered[part] = np.where(alike, 0, 255)
            _accept_occluders(self._road[part], picture, alike)
        same_road = old is not None and old.approaches is raster.approaches
        if old is not None and same_road and old.px_per_m == raster.px_per_m:
            _carry_over(old_road, old.bands, self._road, raster.bands)
        self._refresh_threshold()

    def _light(self, image: Image, protect: Image) -> None:
        """Scale the road to the light of this picture, stretch by stretch."""
        free = cv2.bitwise_not(cv2.bitwise_or(self._covered, protect))
        free &= cv2.compare(image, 0, cv2.CMP_GT)
        window = self._window
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            use = free[part]
            seen = cv2.reduce(
                cv2.bitwise_and(image[part], use), 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F
            )
            known = cv2.copyTo(self._road[part], use)
            road = cv2.reduce(known, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F)
            seen_sum = cv2.blur(seen, (window, 1), borderType=cv2.BORDER_REPLICATE)
            road_sum = cv2.blur(road, (window, 1), borderType=cv2.BORDER_REPLICATE)
            gain = _ratio_or_neighbour(seen_sum[0], road_sum[0], band.rows[1] - band.rows[0])
            self._gain[number, : band.columns] = np.clip(gain, *GAIN_LIMITS)
            np.multiply(self._road[part], self._gain[number, : band.columns], out=self._lit[part])

    def _learn(
        self, image: Image, foreign: Image, shade: Image, protect: Image, t_s: float
    ) -> None:
        dt_s, young = max(t_s - self._last_s, 0.0), t_s - self._began_s < YOUNG_S
        self._covered = cv2.dilate(cv2.bitwise_or(foreign, protect), self._grow)
        if dt_s < LEARN_EVERY_S and not young:
            return
        self._last_s = t_s
        seen = cv2.compare(image, 0, cv2.CMP_GT)
        free = cv2.bitwise_and(cv2.bitwise_not(self._covered), seen)
        cv2.bitwise_or(self._bare, free, dst=self._bare)
        rate = 1.0 - float(np.exp(-dt_s / (SETTLE_S if young else LEARN_S)))
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            unlit = image[part] / self._gain[number, : band.columns]
            unlit = unlit.astype(np.float32, copy=False)
            cv2.accumulateWeighted(unlit, self._road[part], rate, free[part])
        if t_s - self._checked_s < CHECK_S and not young:
            return
        if t_s - self._checked_s >= CHECK_S:
            self._accept_still(image, cv2.bitwise_and(foreign, seen), shade, protect, t_s)
        residual = cv2.absdiff(image.astype(np.float32), self._lit)[::6, ::6]
        calm = residual[free[::6, ::6] > 0]
        if len(calm) > 50:
            self._noise += NOISE_RATE * (1.48 * float(np.median(calm)) - self._noise)
        self._is_noisy |= self._noise > NOISY
        self._refresh_threshold()

    def _accept_still(
        self, image: Image, foreign: Image, shade: Image, protect: Image, t_s: float
    ) -> None:
        """Take for road what differs and stands still, if it is no vehicle or only a ghost.

        Markings and stains that the first picture did not explain are learnt after a while.  A
        ghost, the place of a vehicle that was learnt and has left, shows the edges of a vehicle in
        the road that was learnt and none in the picture; it is learnt at once.  A gantry's shadow
        is learnt in time, if it lay there from the first; a tree's sways, a vehicle's leaves.
        """
        still = cv2.compare(cv2.absdiff(image, self._before), STILL_LEVELS, cv2.CMP_LT)
        self._still_s += t_s - self._checked_s
        self._still_s[still == 0] = 0.0
        np.copyto(self._before, image)
        self._checked_s = t_s
        free = cv2.dilate(protect, self._grow) == 0
        learnt_edges = self._edges(cv2.convertScaleAbs(self._road))
        ghost = (learnt_edges > VEHICLE_EDGES) & (learnt_edges > GHOST_EDGES * self._edges(image))
        plain = self._plain()
        unlike = cv2.absdiff(image.astype(np.float32), plain)
        ghost = (ghost & (unlike < PRIOR_TOLERANCE)) | (unlike < PLAIN_TOLERANCE)
        stain = free & (unlike < np.minimum(STAIN_SHARE * plain, STAIN_TOLERANCE))
        accepted = (self._still_s >= STILL_S) & stain | (self._still_s >= GHOST_S) & ghost
        accepted &= (foreign > 0) & (shade == 0)
        accepted |= free & (shade > 0) & (self._bare == 0) & (self._still_s >= STILL_SHADE_S)
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            unlit = image[part] / self._gain[number, : band.columns]
            np.copyto(self._road[part], unlit, where=accepted[part])

    def _plain(self) -> Picture:
        """Return the road as its rows' most common brightness says, in the present light."""
        plain = np.zeros_like(self._road)
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            modes = _row_modes(self._road[part][:, ::3])[:, None]
            np.multiply(modes, self._gain[number, : band.columns], out=plain[part])
        return plain

    def _edges(self, image: Image) -> Picture:
        """Return how strong the edges are around each pixel, over a metre or two."""
        slope = cv2.morphologyEx(image, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        size = max(round(EDGE_WINDOW_M * self._px_per_m), 3)
        return cv2.blur(slope.astype(np.float32), (size, size)) + EDGE_FLOOR

    def _refresh_threshold(self) -> None:
        slope = cv2.morphologyEx(self._road, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        base = max(MIN_THRESHOLD, NOISE_SIGMAS * self._noise)
        np.multiply(slope, EDGE_TOLERANCE, out=self._threshold)
        self._threshold += base


def _carry_over(
    old: Picture, old_bands: tuple[Band, ...], new: Picture, new_bands: tuple[Band, ...]
) -> None:
    """Copy learnt road from an old layout to where a new one shows the same place."""
    before = {b.approach_index: b for b in old_bands}
    for band in new_bands:
        known = before.get(band.approach_index)
        if known is None or known.lane_rows != band.lane_rows:
            continue
        shift = band.first_column - known.first_column
        first, last = max(shift, 0), min(known.columns, band.columns + shift)
        if last > first:
            rows, known_rows = slice(*band.rows), slice(*known.rows)
            new[rows, first - shift : last - shift] = old[known_rows, first:last]


def _row_modes(picture: Picture) -> Picture:
    """Return each row's most common brightness: road is one colour, vehicles are many."""
    rows = len(picture)
    levels = np.clip(picture, 0, 255).astype(np.intp)
    levels += np.arange(rows)[:, None] * 256
    counts = np.bincount(levels.ravel(), minlength=rows * 256).reshape(rows, 256)
    counts[:, 0] = 0  # nothing is seen there
    return (
        cv2.GaussianBlur(counts.astype(np.float32), (25, 1), 4.0).argmax(axis=1).astype(np.float32)
    )


def _evenly_lit(picture: Picture, window: int) -> Picture:
    """Divide a first picture by its light along the road, so that clouds do not look like road.

    Most rows of a column are bare road or shoulder, even beside a queue.
    """
    profile = np.maximum(_row_modes(picture), 1.0)[:, None]
    light = np.median(picture / profile, axis=0, keepdims=True).astype(np.float32)
    # The median lets a bridge be a bridge, and not light.
    size = min(4 * window + 1, 255)
    levels = cv2.medianBlur(np.clip(light * 64, 0, 255).astype(np.uint8), size)
    light = cv2.blur(levels.astype(np.float32) / 64, (size, 1), borderType=cv2.BORDER_REPLICATE)
    low, high = np.percentile(light, [5, 95])
    if high < CLOUD_RATIO * low:
        return picture
    return picture / np.clip(light, *GAIN_LIMITS)


def _accept_occluders(road: Picture, picture: Picture, alike: Bools) -> None:
    """Take a bridge or gantry, which also covers both shoulders, for part of the scene."""
    shoulder = max(len(alike) // 8, 1)
    odd = np.logical_not(alike)
    across = (odd[:shoulder].mean(axis=0) > 0.7) & (odd[-shoulder:].mean(axis=0) > 0.7)
    across &= odd.mean(axis=0) > 0.7
    road[:, across] = picture[:, across]


def _ratio_or_neighbour(seen: Picture, road: Picture, rows: int) -> Picture:
    """Return seen / road per column; columns with too little bare road take the nearest ones'."""
    enough = road > 0.08 * rows * max(float(np.median(road)) / max(rows, 1), 1.0)
    if enough.all():
        return seen / road
    if not enough.any():
        return np.ones_like(seen)
    columns = np.arange(len(seen))
    good = columns[enough]
    return np.interp(columns, good, seen[enough] / road[enough]).astype(np.float32)
