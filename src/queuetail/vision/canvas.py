"""A small canvas that the ground stands still on, with a background and its noise."""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.geo.ground import apply_homography, px_to_enu
from queuetail.types import Floats, GroundMapping, Image

MAX_GSD_M = 0.6  # in the middle: a car is then eight pixels long
MIN_WIDTH_PX, MAX_WIDTH_PX = 320, 720
MAX_ACROSS_M, MAX_ALONG_M = 0.9, 1.5  # of ground per canvas pixel: beyond, cars are specks
MAX_STRAY = 0.2  # of the canvas' width that the picture may move before the canvas follows
MAX_ZOOM = 1.25
GRID_PX = 8
LEARN_RATE, FIRST_PICTURES = 0.08, 12  # a plain mean of the first, then exponential
NOISE_RATE, RESTLESS_RATE = 0.05, 0.01
NOISE_FACTOR, MIN_CONTRAST = 4.0, 9.0
NOISE_START, NOISE_CAP = 3.0, 12.0
STILL_LEVELS = 8.0
STILL_PICTURES = 8  # at rest so long before a spot may be a ghost, and between looks for ghosts
GHOST_EDGE = 1.3  # a ghost's outline is so much stronger in the background than in the picture
MAX_CHANGED = 0.5  # of the canvas: another scene, or a jump that registration missed
SQUARE = np.ones((3, 3), np.uint8)


class Canvas:
    """The scaled picture as it was framed at first, and what has been learnt of the ground."""

    def __init__(self, luma: Image, mapping: GroundMapping, H_ref_frame: Floats) -> None:
        """Frame the canvas by a picture (h, w), its mapping and its registration."""
        self._frame_shape = luma.shape
        height, width = luma.shape
        _, along_m = _gsd_m(mapping, np.array([[width / 2, height / 2]]), 1.0)
        shrink = _shrink(width, float(along_m[0]))
        self._width, self._height = width // shrink, height // shrink
        self._scale = np.diag([self._width / width, self._height / height, 1.0])
        shape = (self._height, self._width)
        self._background = np.zeros(shape, np.float32)
        self._noise = np.full(shape, NOISE_START, np.float32)
        self._previous = np.zeros(shape, np.float32)
        self._known = np.zeros(shape, np.uint8)
        self._still = np.zeros(shape, np.uint8)
        self._pictures = 0
        self.share: Floats = np.ones(shape, np.float32)
        self._H_canvas_ref: Floats = self._scale @ np.linalg.inv(H_ref_frame)
        self._useful = self._useful_part(mapping)
        self.H_frame_canvas: Floats = np.linalg.inv(self._scale)
        self.inside: Image = self._useful  # of the last picture: 0 at its edge and beyond

    def fits(self, luma: Image) -> bool:
        """Return whether the picture is of the size that the canvas was begun with."""
        return luma.shape == self._frame_shape

    def foreground(self, luma: Image, mapping: GroundMapping, H_ref_frame: Floats) -> Image:
        """Return the mask (0, 255) of what is not ground, and learn the rest of the picture.

        `share` is set to how bright the picture is there by the background's measure.
        """
        self._follow(mapping, H_ref_frame)
        shown = self._shown()
        seen = self._warp(luma)
        fresh = cv2.bitwise_and(shown, cv2.bitwise_not(self._known))
        cv2.multiply(seen, self._gain(seen), dst=seen)
        for store in (self._background, self._previous):
            cv2.copyTo(seen, fresh, store)
        cv2.bitwise_or(self._known, shown, dst=self._known)
        difference = cv2.absdiff(seen, self._background)
        threshold = cv2.max(cv2.multiply(self._noise, NOISE_FACTOR), MIN_CONTRAST)
        mask = cv2.bitwise_and(cv2.compare(difference, threshold, cv2.CMP_GT), shown)
        if cv2.countNonZero(mask) > MAX_CHANGED * max(cv2.countNonZero(shown), 1):
            self._known[:] = 0
            self._pictures = 0
            return np.zeros_like(mask)
        mask = cv2.bitwise_and(cv2.morphologyEx(mask, cv2.MORPH_CLOSE, SQUARE), shown)
        self.share = cv2.divide(seen, cv2.max(self._background, 1.0))
        self._learn(seen, difference, mask, shown)
        return np.asarray(mask, np.uint8)

    def _learn(self, seen: Floats, difference: Floats, mask: Image, shown: Image) -> None:
        self._pictures += 1
        rate = max(LEARN_RATE, 1 / (self._pictures + 1))
        ground = cv2.bitwise_and(shown, cv2.bitwise_not(mask))
        cv2.accumulateWeighted(seen, self._background, rate, ground)
        cv2.accumulateWeighted(difference, self._noise, NOISE_RATE, ground)
        moved = cv2.compare(cv2.absdiff(seen, self._previous), STILL_LEVELS, cv2.CMP_GT)
        # Leaves never rest; a stopped car does, and must not raise its own threshold.
        restless = cv2.bitwise_and(mask, moved)
        capped = cv2.min(difference, NOISE_CAP)
        cv2.accumulateWeighted(capped, self._noise, RESTLESS_RATE, restless)
        resting = cv2.bitwise_and(mask, cv2.bitwise_not(moved))
        self._still = cv2.bitwise_and(cv2.add(self._still, 1), resting)
        self._previous = seen
        if self._pictures % STILL_PICTURES == 0:
            self._heal_ghosts(seen)

    def _heal_ghosts(self, seen: Floats) -> None:
        """Relearn resting spots whose outline is in the background and not in the picture.

        A vehicle that stands has edges; where one stood when the background was learnt, the
        edges are the background's.
        """
        resting = cv2.compare(self._still, STILL_PICTURES, cv2.CMP_GE)
        wide = cv2.dilate(resting, SQUARE)
        ring = cv2.subtract(wide, cv2.erode(resting, SQUARE))
        count, labels = cv2.connectedComponents(wide)
        rows, columns = np.nonzero(ring)
        if not len(rows):
            return
        label = labels[rows, columns]
        old, new = (
            np.bincount(
                label, cv2.morphologyEx(p, cv2.MORPH_GRADIENT, SQUARE)[rows, columns], count
            )
            for p in (self._background, seen)
        )
        ghost = old > GHOST_EDGE * new
        ghost[0] = False
        where = (ghost[labels] * np.uint8(255)).astype(np.uint8)
        cv2.copyTo(seen, where, self._background)

    def _warp(self, luma: Image) -> Floats:
        """Return the picture on the canvas, float32; scaled first, so that nothing aliases."""
        small = cv2.resize(luma, (self._width, self._height), interpolation=cv2.INTER_AREA)
        H_canvas_small = np.linalg.inv(self.H_frame_canvas) @ np.linalg.inv(self._scale)
        half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        M = np.linalg.inv(half) @ H_canvas_small @ half  # OpenCV counts from pixel centres
        size = (self._width, self._height)
        warped = cv2.warpPerspective(small, M, size, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(cv2.GaussianBlur(warped, (3, 3), 0), np.float32)

    def _gain(self, seen: Floats) -> float:
        """Return what brings the picture to the background's exposure."""
        step = (slice(None, None, GRID_PX),) * 2
        used = (self._known[step] > 0) & (seen[step] > 16)
        if used.sum() < 50:
            return 1.0
        return float(np.median(self._background[step][used] / seen[step][used]))

    def _shown(self) -> Image:
        """Return where the picture covers the useful part of the canvas, and set `inside`."""
        height, width = self._frame_shape
        corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
        outline = apply_homography(np.asarray(np.linalg.inv(self.H_frame_canvas)), corners)
        shown = np.zeros_like(self._known)
        if np.isfinite(outline).all():
            cv2.fillConvexPoly(shown, np.round(outline - 0.5).astype(np.int32), 255)
        shown = cv2.bitwise_and(cv2.erode(shown, SQUARE, borderValue=0), self._useful)
        self.inside = cv2.erode(shown, np.ones((5, 5), np.uint8), borderValue=0)
        return np.asarray(shown, np.uint8)

    def _follow(self, mapping: GroundMapping, H_ref_frame: Floats) -> None:
        """Set where the picture lies; move the canvas along when it strays or zooms too far."""
        H_canvas_frame = self._H_canvas_ref @ H_ref_frame
        height, width = self._frame_shape
        middle = np.array([[width / 2, height / 2], [width / 2 + 10, height / 2]])
        now, begun = apply_homography(H_canvas_frame, middle), apply_homography(self._scale, middle)
        stray = float(np.linalg.norm(now[0] - begun[0])) / self._width
        zoom = float(np.linalg.norm(now[1] - now[0]) / np.linalg.norm(begun[1] - begun[0]))
        if not (stray < MAX_STRAY and 1 / MAX_ZOOM < zoom < MAX_ZOOM):
            self._reframe(mapping, H_ref_frame)
            H_canvas_frame = self._scale
        self.H_frame_canvas = np.asarray(np.linalg.inv(H_canvas_frame), np.float64)

    def _reframe(self, mapping: GroundMapping, H_ref_frame: Floats) -> None:
        """Frame the canvas by the picture as it lies now, and take what is known along."""
        framed = self._scale @ np.linalg.inv(H_ref_frame)
        half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        M = np.linalg.inv(half) @ framed @ np.linalg.inv(self._H_canvas_ref) @ half
        size = (self._width, self._height)
        self._background = cv2.warpPerspective(self._background, M, size)
        self._previous = cv2.warpPerspective(self._previous, M, size)
        self._noise = cv2.warpPerspective(self._noise, M, size, borderValue=NOISE_START)
        known = cv2.warpPerspective(self._known, M, size, flags=cv2.INTER_NEAREST)
        self._known = cv2.erode(known, SQUARE, borderValue=0)
        self._still[:] = 0
        self._H_canvas_ref = framed
        self._useful = self._useful_part(mapping)

    def _useful_part(self, mapping: GroundMapping) -> Image:
        """Return the mask of the ground that is seen finely enough to tell cars from specks."""
        rows, columns = np.mgrid[0 : self._height : GRID_PX, 0 : self._width : GRID_PX]
        canvas = np.column_stack([columns.ravel(), rows.ravel()]) + GRID_PX / 2
        px_per_canvas = 1 / self._scale[0, 0]
        across_m, along_m = _gsd_m(mapping, canvas * px_per_canvas, px_per_canvas)
        with np.errstate(invalid="ignore"):
            fine = (across_m < MAX_ACROSS_M) & (along_m < MAX_ALONG_M)
        coarse = (fine.reshape(rows.shape) * np.uint8(255)).astype(np.uint8)
        full = cv2.resize(coarse, None, fx=GRID_PX, fy=GRID_PX, interpolation=cv2.INTER_NEAREST)
        return np.asarray(full[: self._height, : self._width], np.uint8)


def _shrink(width_px: int, gsd_m: float) -> int:
    """Return the whole number to divide the picture's sides by: scaling by those is fastest."""
    widest = max(-(-width_px // MAX_WIDTH_PX), 1)
    narrowest = max(width_px // MIN_WIDTH_PX, 1)
    wanted = int(MAX_GSD_M / gsd_m) if gsd_m > 0 else widest
    return int(np.clip(wanted, widest, max(narrowest, widest)))


def _gsd_m(mapping: GroundMapping, px: Floats, step_px: float) -> tuple[Floats, Floats]:
    """Return metres of ground per `step_px`, the fewest and the most, (n, 2) -> (n,), (n,)."""
    place = px_to_enu(mapping, px)
    a = px_to_enu(mapping, px + np.array([step_px, 0.0])) - place
    b = px_to_enu(mapping, px + np.array([0.0, step_px])) - place
    mean = ((a * a).sum(axis=1) + (b * b).sum(axis=1)) / 2
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    spread = np.sqrt(np.maximum(mean**2 - area**2, 0.0))
    return np.sqrt(np.maximum(mean - spread, 0.0)), np.sqrt(mean + spread)
