"""The road as it is without vehicles: a background that does not absorb what stops.

Asphalt is alike along a lane, so the first picture already tells the road from a queue that stands
on it: the most common brightness of each row is road, and what differs from it is not learnt.
Later every pixel learns only while no vehicle covers it.  Brightness is compared per stretch of
road, so that clouds and exposure steps are not vehicles.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.types import MOVED, Band, Image, Masks, Picture, RoadRaster
from queuetail.vision.carried_road import carried
from queuetail.vision.colour import RoadColour
from queuetail.vision.first_road import (
    ALIKE,
    GRAIN_SIGMAS,
    OTHER_ROAD,
    first_road,
    row_modes,
)
from queuetail.vision.light import light_along
from queuetail.vision.paint import painted
from queuetail.vision.shade import CastShade

Part = tuple[slice, slice]

SETTLE_S = 0.6  # learning time while the model is young
LEARN_EVERY_S = 0.15  # light and road change slowly
LEARN_S = 6.0  # and later: slow enough to average noise, fast enough for moving light
YOUNG_S = 3.0
CHECK_S, STILL_S, STILL_LEVELS = 0.4, 4.0, 8.0  # for what differs but is no vehicle
STILL_SHADE_S = 8.0
GHOST_S, GHOST_EDGES = 1.1, 1.8  # how much stronger a ghost's edges are in the learnt road
VEHICLE_EDGES = 11.0  # grey levels of slope that a learnt vehicle has, and asphalt has not
EDGE_WINDOW_M, EDGE_FLOOR = 1.6, 2.0
MIN_THRESHOLD = 9.0  # grey levels
NOISE_SIGMAS, NOISE_RATE = 4.5, 0.3
NOISY = 2.8  # grey levels; below it, smoothing costs more in edges than it gains
EDGE_TOLERANCE = 0.45  # share of the local gradient: half a pixel of misregistration
PLAIN_TOLERANCE = 12.0  # grey levels from a row's road at which a pixel is road for certain
STAIN_TOLERANCE = 40.0  # grey levels from a row's road that a stain or patch may have,
STAIN_SHARE = 0.3  # and no more than this share of the road's: at dusk cars differ by as little
GRAIN, MOST_OF_ROW = 0.14, 0.6  # of brightness; of a row that shows one road,
LIT_OF_ROW = 0.05  # and of one that shows a lighter one yet
EVERY = 4  # columns of a row that are looked at
GROW_M = 1.2  # vehicles are kept out of learning with this margin


@dataclass(frozen=True, slots=True)
class _Look:
    """One picture, and what is known of its pixels; masks are 255 where it is so."""

    image: Image
    foreign: Image
    shade: Image
    known: Image  # it belongs to known vehicles,
    protect: Image  # and these are MOVED, or MAYBE
    t_s: float


class RoadBackground:
    """Separates vehicles from the road in road-view rasters."""

    def __init__(self) -> None:
        self._layout: RoadRaster | None = None
        self._road = np.zeros((0, 0), np.float32)
        self._bare = np.zeros((0, 0), np.uint8)  # where sunlit road was seen
        self._bands: tuple[Band, ...] = ()
        self._noise = 2.0
        self._is_noisy = False  # and then pictures are smoothed, as in poor light
        self._began_s = self._last_s = 0.0
        self._watched_s = 0.0  # since when, through all layouts that what was learnt is kept in
        self._shade = CastShade()
        self._colour = RoadColour()

    def apply(self, raster: RoadRaster, t_s: float, protect: Image) -> Masks:
        """Return what is not road in this frame.

        `protect` marks pixels that belong to known vehicles (MOVED, or MAYBE): they are not learnt.
        """
        image = raster.image
        if self._is_noisy and raster.bands:
            image = cv2.GaussianBlur(image, (3, 3), 0)
        if not raster.bands:
            return Masks(image, image, image, image.astype(np.float32))
        self._bands = raster.bands
        if self._layout is None or self._layout.plan != raster.plan:
            self._start(raster, t_s)
        self._layout = raster
        known = cv2.compare(protect, 0, cv2.CMP_GT)
        self._light(image, known)
        difference = cv2.subtract(image, self._lit, dtype=cv2.CV_32F)
        foreign = cv2.compare(cv2.absdiff(difference, 0.0), self._threshold, cv2.CMP_GT)
        seen = cv2.compare(image, 0, cv2.CMP_GT)
        foreign &= seen
        bright = cv2.compare(difference, self._threshold, cv2.CMP_GT)
        coloured = self._colour.foreign(raster, self._lit, foreign, known, t_s)
        if coloured is not None:
            coloured &= seen
            foreign |= coloured
            bright |= coloured
        self._leave_out_paint(foreign, bright, protect)
        share = cv2.divide(image, self._lit, dtype=cv2.CV_32F)
        shade = self._shade.mask(share, cv2.bitwise_and(foreign, cv2.bitwise_not(bright)))
        self._learn(_Look(image, foreign, shade, known, protect, t_s))
        return Masks(foreign, bright, shade, cv2.absdiff(share, 1.0))

    def _leave_out_paint(self, foreign: Image, bright: Image, protect: Image) -> None:
        """Take painted marks for road where that was not seen bare yet."""
        unknown = cv2.bitwise_and(bright, cv2.bitwise_not(self._bare))
        unknown &= cv2.compare(protect, MOVED, cv2.CMP_NE)
        if not cv2.countNonZero(unknown):
            return
        dark = cv2.bitwise_and(foreign, cv2.bitwise_not(bright))
        road = cv2.bitwise_not(cv2.bitwise_and(painted(bright, dark, self._px_per_m), unknown))
        foreign &= road
        bright &= road

    def _start(self, raster: RoadRaster, t_s: float) -> None:
        """Believe the first picture where it looks like its row's road, and the row elsewhere.

        Road that was seen bare in an earlier layout is kept as it was learnt.
        """
        image = raster.image
        # Sooner after a road was first seen, a vehicle may have been taken for it.
        old = self._layout if t_s - self._watched_s > YOUNG_S else None
        old_road, old_bare = self._road, self._bare
        self._began_s = self._last_s = t_s
        self._watched_s = t_s if old is None else self._watched_s
        self._road = np.zeros(image.shape, np.float32)
        self._lit = np.zeros(image.shape, np.float32)
        self._threshold = np.full(image.shape, MIN_THRESHOLD, np.float32)
        self._covered = np.zeros(image.shape, np.uint8)
        self._bare = np.zeros(image.shape, np.uint8)
        self._occluded = np.zeros(image.shape, np.bool_)  # in the first picture, perhaps
        self._before = image.copy()
        self._still_s = np.zeros(image.shape, np.float32)
        self._other_s = np.zeros(len(image), np.float32)
        self._checked_s = t_s
        self._gain = np.ones((len(raster.bands), image.shape[1]), np.float32)
        self._grain = [0.0] * len(raster.bands)
        grow = max(round(GROW_M * raster.px_per_m), 1)
        self._grow = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * grow + 1, 3))
        self._px_per_m = raster.px_per_m
        for number, band in enumerate(raster.bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            picture = image[part].astype(np.float32)
            first = first_road(picture, band, raster.px_per_m)
            self._road[part], self._grain[number] = first.road, first.grain
            self._covered[part] = np.where(first.alike, 0, 255)
            self._occluded[part] = first.occluded
            if old is not None and old.bands:
                before, known = carried(old_road, old_bare, old, raster, band)
                self._keep(part, picture, before, known)
        self._refresh_threshold()

    def _keep(self, part: Part, picture: Picture, before: Picture, known: Image) -> None:
        """Keep the road learnt `before` in part of the raster where it is `known` (255)."""
        where = (known > 0) & (before > 0) & (picture > 0)
        if not where.any():
            return
        light = float(np.median(picture[where] / before[where]))
        np.copyto(self._road[part], before * np.float32(light), where=where)
        self._covered[part][where] = 0
        self._bare[part][where] = 255

    def _light(self, image: Image, known: Image) -> None:
        """Scale the road to the light of this picture, stretch by stretch."""
        free = cv2.bitwise_not(cv2.bitwise_or(self._covered, known))
        free &= cv2.compare(image, 0, cv2.CMP_GT)
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            light = light_along(image[part], free[part], self._road[part], self._px_per_m)
            self._gain[number, : band.columns] = light
            np.multiply(self._road[part], light, out=self._lit[part])

    def _learn(self, look: _Look) -> None:
        image, t_s = look.image, look.t_s
        dt_s, young = max(t_s - self._last_s, 0.0), t_s - self._began_s < YOUNG_S
        self._covered = cv2.dilate(cv2.bitwise_or(look.foreign, look.known), self._grow)
        if dt_s < LEARN_EVERY_S and not young:
            return
        self._last_s = t_s
        seen = cv2.compare(image, 0, cv2.CMP_GT)
        free = cv2.bitwise_and(cv2.bitwise_not(self._covered), seen)
        first = cv2.bitwise_and(free, cv2.bitwise_not(self._bare))
        is_new = cv2.countNonZero(first) > 0
        cv2.bitwise_or(self._bare, free, dst=self._bare)
        rate = 1.0 - float(np.exp(-dt_s / (SETTLE_S if young else LEARN_S)))
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            unlit = image[part] / self._gain[number, : band.columns]
            unlit = unlit.astype(np.float32, copy=False)
            if is_new:
                np.copyto(self._road[part], unlit, where=first[part] > 0)
            cv2.accumulateWeighted(unlit, self._road[part], rate, free[part])
        if t_s - self._checked_s < CHECK_S and not young:
            return
        if t_s - self._checked_s >= CHECK_S:
            self._accept_still(look)
        residual = cv2.absdiff(image.astype(np.float32), self._lit)[::6, ::6]
        calm = residual[free[::6, ::6] > 0]
        if len(calm) > 50:
            self._noise += NOISE_RATE * (1.48 * float(np.median(calm)) - self._noise)
        self._is_noisy |= self._noise > NOISY
        self._refresh_threshold()

    def _accept_still(self, look: _Look) -> None:
        """Take for road what differs and stands still, if it is no vehicle or only a ghost.

        Markings and stains that the first picture did not explain are learnt after a while.  A
        ghost, the place of a vehicle that was learnt and has left, shows the edges of a vehicle in
        the road that was learnt and none in the picture; it is learnt at once, unless a vehicle has
        moved there: one the colour of asphalt has no edges either.  A gantry's shadow is learnt in
        time, if it lay there from the first; a tree's sways, a vehicle's leaves.
        """
        image, shade = look.image, look.shade
        still = cv2.compare(cv2.absdiff(image, self._before), STILL_LEVELS, cv2.CMP_LT)
        dt_s, self._checked_s = look.t_s - self._checked_s, look.t_s
        self._still_s += dt_s
        self._still_s[still == 0] = 0.0
        np.copyto(self._before, image)
        free = cv2.dilate(look.known, self._grow) == 0
        learnt_edges = self._edges(cv2.convertScaleAbs(self._road))
        ghost = (learnt_edges > VEHICLE_EDGES) & (learnt_edges > GHOST_EDGES * self._edges(image))
        profiles = self._profiles()
        plain = self._plain(profiles)
        unlike = cv2.absdiff(image.astype(np.float32), plain)
        ghost = (ghost & (unlike < ALIKE)) | (unlike < PLAIN_TOLERANCE)
        stain = free & (unlike < np.minimum(STAIN_SHARE * plain, STAIN_TOLERANCE))
        accepted = (self._still_s >= STILL_S) & stain | (self._still_s >= GHOST_S) & ghost
        accepted &= (look.foreign > 0) & (shade == 0) & (look.protect != MOVED)
        # What hid the road and has left was no bridge, whatever seems to stand in its place.
        accepted |= self._occluded & (self._still_s >= CHECK_S) & (unlike < PLAIN_TOLERANCE)
        accepted |= free & (shade > 0) & (self._bare == 0) & (self._still_s >= STILL_SHADE_S)
        self._relearn_rows(image, profiles, dt_s)
        for number, band in enumerate(self._bands):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            unlit = image[part] / self._gain[number, : band.columns]
            np.copyto(self._road[part], unlit, where=accepted[part])

    def _relearn_rows(self, image: Image, profiles: list[Picture], dt_s: float) -> None:
        """Learn rows anew that have long shown, nearly all along, another road than was learnt.

        Where a queue stood in the first picture, it may have been taken for road.  Beside a queue
        its shadows lie nearly all along as well; between them the lighter road still shows.
        """
        for number, band in enumerate(self._bands):
            rows, (begin, end) = slice(*band.rows), band.visible_columns
            if end <= begin:
                continue
            gain = self._gain[number, begin:end]
            some = (image[rows, begin:end:EVERY] / gain[::EVERY]).astype(np.float32)
            modes = row_modes(some)
            tolerance = np.maximum(ALIKE, GRAIN * modes)[:, None]
            learnt = profiles[number]
            other = np.abs(modes - learnt) > np.maximum(ALIKE, OTHER_ROAD * learnt)
            other &= _show(some, modes, tolerance) > MOST_OF_ROW
            other &= (modes > learnt) | (_show(some, learnt, tolerance) < LIT_OF_ROW)
            waited_s = np.where(other, self._other_s[rows] + dt_s, 0.0)
            anew = np.flatnonzero(waited_s >= STILL_S)
            waited_s[anew] = 0.0
            self._other_s[rows] = waited_s
            if not len(anew):
                continue
            unlit = image[rows, begin:end][anew] / gain
            alike = np.abs(unlit - modes[anew, None]) < tolerance[anew]
            self._road[rows, begin:end][anew] = np.where(alike, unlit, modes[anew, None])

    def _profiles(self) -> list[Picture]:
        """Return each band's road as its rows' most common brightness says, (rows,)."""
        parts = (np.s_[b.rows[0] : b.rows[1], : b.columns : 3] for b in self._bands)
        return [row_modes(self._road[part]) for part in parts]

    def _plain(self, profiles: list[Picture]) -> Picture:
        """Return the road as its profiles say, in the present light."""
        plain = np.zeros_like(self._road)
        for number, (band, profile) in enumerate(zip(self._bands, profiles, strict=True)):
            part = np.s_[band.rows[0] : band.rows[1], : band.columns]
            np.multiply(profile[:, None], self._gain[number, : band.columns], out=plain[part])
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
        for grain, band in zip(self._grain, self._bands, strict=True):
            # Where road was never seen bare, its grain is not known either.
            more = GRAIN_SIGMAS * grain - base
            if more > 0:
                part = np.s_[band.rows[0] : band.rows[1], : band.columns]
                unknown = self._bare[part] == 0
                np.add(self._threshold[part], more, out=self._threshold[part], where=unknown)


def _show(some: Picture, level: Picture, tolerance: Picture) -> Picture:
    """Return the share (rows,) of each row's pixels that are as bright as its level (rows,)."""
    return np.asarray((np.abs(some - level[:, None]) < tolerance).mean(axis=1), np.float32)
