"""The road's colour, and what has another: a red car as bright as asphalt is told by nothing else.

Asphalt is grey, in sun and in shadow, and what the camera or the light tints, it tints all over.
Colours come at half the size and blurred by compression, so they only add to what brightness shows.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.types import Bools, Image, Picture, RoadRaster

LEARN_EVERY_S, LEARN_S = 0.8, 6.0
STILL_S, STILL_LEVELS = 4.0, 6.0  # for what has another colour, but is no vehicle
# What differs from road does so by this share of its brightness, within these levels of chroma,
SHARE, LEAST, MOST_NEEDED = 0.13, 5.0, 12.0
NOISE_SIGMAS, NOISE_RATE = 5.0, 0.3  # and by more than noise explains,
LARGER_OF_TWO = 0.95  # sigmas to the median of the larger of two deviations
GROW = np.ones((5, 9), np.uint8)  # vehicles are kept out of learning with this margin
BLUR = np.ones((3, 5), np.uint8)  # how far compression carries a colour
SPECK = np.ones((1, 3), np.uint8)  # what is shorter is none
MOST = 0.25  # of the picture in another colour than before: it is the camera that changed
ENOUGH, SAMPLE = 50, 5  # pixels of bare road that tell tint and noise: every fifth
GREY = 128.0


class RoadColour:
    """Learns the colours of bare road, and finds what has others, in road-view rasters."""

    def __init__(self) -> None:
        self._plan: int | None = None
        self._road = np.zeros((2, 0, 0), np.float32)  # without the present tint
        self._expected = np.zeros((2, 0, 0), np.uint8)  # with it
        self._before = np.zeros((2, 0, 0), np.uint8)
        self._still_s = np.zeros((0, 0), np.float32)  # for how long each colour has not changed
        self._noise = 1.5
        self._limit = np.zeros((0, 0), np.uint8)  # of what differs, for it to be no road
        self._learnt_s = -math.inf

    def foreign(
        self, raster: RoadRaster, lit: Picture, differs: Image, protect: Image, t_s: float
    ) -> Image | None:
        """Return (255), at the raster's size, what has another colour than road; None untold.

        `lit` is the bare road's brightness in this picture's light; `differs` (255) what is no road
        by brightness, `protect` what belongs to known vehicles.
        """
        colour = raster.colour
        if colour is None:
            return None
        if self._plan != raster.plan:
            self._plan, self._learnt_s = raster.plan, -math.inf
            self._road = _first_guess(colour)
            self._expected = np.rint(self._road).astype(np.uint8)
            self._before, self._still_s = colour.copy(), np.zeros(colour.shape[1:], np.float32)
        if t_s - self._learnt_s >= LEARN_EVERY_S:
            self._learn(colour, differs, protect, t_s)
            self._limit = self._least(_at_size(lit, colour))
        off = cv2.max(*(cv2.absdiff(c, e) for c, e in zip(colour, self._expected, strict=True)))
        # Where a colour is blurred, half of it is where its edge was.
        half = cv2.convertScaleAbs(cv2.dilate(off, BLUR), alpha=0.5)
        limit = cv2.max(self._limit, half)
        foreign = cv2.bitwise_and(cv2.compare(off, limit, cv2.CMP_GT), _seen(colour))
        if cv2.countNonZero(foreign) > MOST * foreign.size:
            self._learnt_s = -math.inf
            return None
        foreign = cv2.morphologyEx(foreign, cv2.MORPH_OPEN, SPECK)
        height, width = foreign.shape
        foreign = cv2.resize(foreign, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(foreign[: raster.image.shape[0], : raster.image.shape[1]])

    def _learn(self, colour: Image, differs: Image, protect: Image, t_s: float) -> None:
        """Take in the tint, the noise and the colours of bare road in this picture."""
        covered = cv2.dilate(_at_size(cv2.bitwise_or(differs, protect), colour), GROW)
        bare = cv2.bitwise_and(cv2.bitwise_not(covered), _seen(colour))
        sample = (colour - self._road)[:, bare > 0][:, ::SAMPLE]
        if sample.shape[1] < ENOUGH:
            return
        tint = np.median(sample, axis=1).astype(np.float32)
        away = np.abs(sample - tint[:, None]).max(axis=0)
        noise = LARGER_OF_TWO * float(np.median(away))
        self._noise += NOISE_RATE * (noise - self._noise)
        step_s = min(t_s - self._learnt_s, LEARN_EVERY_S)
        rate, self._learnt_s = 1.0 - math.exp(-step_s / LEARN_S), t_s
        stays = self._stays(colour, protect, step_s)
        most = max(MOST_NEEDED, NOISE_SIGMAS * self._noise)
        for plane, road, shift in zip(colour, self._road, tint.tolist(), strict=True):
            untinted = cv2.subtract(plane, (shift, 0.0, 0.0, 0.0), dtype=cv2.CV_32F)
            alike = cv2.compare(cv2.absdiff(untinted, road), most, cv2.CMP_LT)
            cv2.accumulateWeighted(untinted, road, rate, cv2.bitwise_and(bare, alike))
            np.copyto(road, untinted, where=stays)
        tinted = np.rint(self._road + tint[:, None, None])
        self._expected = np.clip(tinted, 0, 255).astype(np.uint8)

    def _least(self, lit: Picture) -> Image:
        """Return the levels by which each place differs at the least, for it to be no road."""
        noise = NOISE_SIGMAS * self._noise
        share = cv2.convertScaleAbs(lit, alpha=SHARE)
        return np.clip(share, max(LEAST, noise), max(MOST_NEEDED, noise)).astype(np.uint8)

    def _stays(self, colour: Image, protect: Image, step_s: float) -> Bools:
        """Return what has not changed for long and is no known vehicle: paint, a parked car."""
        changed = cv2.max(*(cv2.absdiff(c, b) for c, b in zip(colour, self._before, strict=True)))
        still = changed < max(STILL_LEVELS, NOISE_SIGMAS * self._noise)
        self._still_s = np.where(still, self._still_s + np.float32(step_s), np.float32(0.0))
        np.copyto(self._before, colour)
        vehicles = cv2.dilate(_at_size(protect, colour), GROW) > 0
        return np.asarray((self._still_s >= STILL_S) & ~vehicles)


def _at_size(of_raster: NDArray[Any], colour: Image) -> NDArray[Any]:
    """Return what belongs to the raster at the size of its colours."""
    size = (colour.shape[2], colour.shape[1])
    return np.asarray(cv2.resize(of_raster, size, interpolation=cv2.INTER_NEAREST))


def _seen(colour: Image) -> Image:
    """Return (255) where the picture shows anything: no colour that cameras make has a 0."""
    return np.asarray(cv2.compare(colour[0], 0, cv2.CMP_GT), np.uint8)


def _first_guess(colour: Image) -> Picture:
    """Return the colour of the road: what each row shows most, where a picture does not show it."""
    seen = _seen(colour) > 0
    road = np.full(colour.shape, GREY, np.float32)
    for row in np.flatnonzero(seen.any(axis=1)).tolist():
        road[:, row] = np.median(colour[:, row, seen[row]], axis=1)[:, None]
    alike = np.abs(colour - road).max(axis=0) < MOST_NEEDED
    return np.where(alike & seen, colour, road).astype(np.float32)
