"""Cast shadow told from dark things: one sun gives every shadow the same depth.

A shadow keeps a constant share of the road's brightness (Cucchiara et al. 2003), the same for every
vehicle, tree and gantry of a scene; bodies, windows and tyres have shares of all kinds.  So where
most of what is darker than road has one share, that share is shadow.
"""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.types import Floats, Image

BINS, BIN_SMOOTHING = 64, np.array([0.25, 0.5, 0.25])
TOLERANCE = 0.09  # of the share: asphalt's grain, and light from the sky
PEAK_BINS = 4  # on either side
COMMON = 0.5  # of all dark pixels, for one share to be the shadow's,
PROMINENT, PROMINENT_SHARE = 2.5, 0.25  # or so much of a peak over the mean, with so many of them
LEAST_PIXELS = 600.0
FADE = 0.98  # per picture that is learnt from: the sun moves, clouds come
LEARN_EVERY = 3  # pictures
SQUARE = np.ones((3, 3), np.uint8)


class CastShade:
    """Learns how deep the scene's shadows are, and marks them in pictures of road."""

    def __init__(self) -> None:
        self._histogram = np.zeros(BINS)
        self._pictures = 0
        self.depth: float | None = None  # a shadow's share of the road's brightness, once known

    def mask(self, share: Floats, dark: Image) -> Image:
        """Return (255) which of the `dark` pixels are cast shadow, none while that is unknown.

        `share` (h, w) float32 is the picture's brightness as a share of the bare road's.
        """
        if self._pictures % LEARN_EVERY == 0:
            self._learn(share, dark)
        self._pictures += 1
        if self.depth is None:
            return np.zeros_like(dark)
        low, high = self.depth - TOLERANCE, self.depth + TOLERANCE
        core = cv2.bitwise_and(cv2.inRange(share, low, high), dark)
        # At its border a shadow fades within a pixel or two.
        border = cv2.bitwise_and(cv2.dilate(core, SQUARE), cv2.inRange(share, low, 1.0))
        return np.asarray(cv2.bitwise_or(core, cv2.bitwise_and(border, dark)), np.uint8)

    def _learn(self, share: Floats, dark: Image) -> None:
        inner = cv2.erode(dark, SQUARE)
        counts = cv2.calcHist([share], [0], inner, [BINS], [0.0, 1.0]).ravel()
        self._histogram = FADE * self._histogram + counts
        total = self._histogram.sum()
        if total < LEAST_PIXELS:
            return
        smooth = np.convolve(self._histogram, BIN_SMOOTHING, "same")
        peak = int(smooth.argmax())
        window = self._histogram[max(peak - PEAK_BINS, 0) : peak + PEAK_BINS + 1]
        centres = (
            np.arange(max(peak - PEAK_BINS, 0), peak + PEAK_BINS + 1)[: len(window)] + 0.5
        ) / BINS
        common = window.sum() >= COMMON * total
        beside = (total - window.sum()) / max(BINS / 2 - len(window), 1)
        common |= smooth[peak] > PROMINENT * beside and window.sum() > PROMINENT_SHARE * total
        self.depth = float(window @ centres / window.sum()) if common else None
