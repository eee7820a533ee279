"""The paper's three background models, each on a blurred colour picture.

Source: Messenger et al. (2023): Gaussian blur, then the first frame, a running average or MOG2
(Zivkovic 2004) with its shadows removed, then dilation with a circle.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import cv2
import numpy as np

from queuetail.types import Image, Raster

DIFFERENCE_THRESHOLD = 30  # grey levels, for the first frame and the running average
AVERAGE_RATE = 0.01  # share of each new frame in the running average
MOG2_HISTORY = 500  # frames
MOG2_VARIANCE = 16.0  # squared Mahalanobis distance
MOG2_FOREGROUND = 255  # MOG2 marks shadows 127


class Background(Protocol):
    """Separates what moves from the road."""

    def apply(self, image: Image) -> Image:
        """Return the foreground mask, 255 where there is something, of a (h, w, 3) picture."""


class Mog2:
    """A mixture of Gaussians per pixel, shadows removed."""

    def __init__(self) -> None:
        self._model = cv2.createBackgroundSubtractorMOG2(MOG2_HISTORY, MOG2_VARIANCE, True)

    def apply(self, image: Image) -> Image:
        """Learn from `image` and return what does not fit."""
        mask = self._model.apply(image)
        return np.asarray(cv2.compare(mask, MOG2_FOREGROUND, cv2.CMP_EQ), np.uint8)


class RunningAverage:
    """An exponentially forgetting mean."""

    def __init__(self) -> None:
        self._mean: np.ndarray[tuple[int, ...], np.dtype[np.float32]] | None = None

    def apply(self, image: Image) -> Image:
        """Return what differs from the mean so far, then learn from `image`."""
        if self._mean is None:
            self._mean = image.astype(np.float32)
        mask = _differs(image, cv2.convertScaleAbs(self._mean))
        cv2.accumulateWeighted(image, self._mean, AVERAGE_RATE)
        return mask


class FirstFrame:
    """The first frame for ever."""

    def __init__(self) -> None:
        self._first: Image | None = None

    def apply(self, image: Image) -> Image:
        """Return what differs from the first frame."""
        if self._first is None:
            self._first = image.copy()
        return _differs(image, self._first)


MODELS: dict[str, Callable[[], Background]] = {
    "mog2": Mog2,
    "average": RunningAverage,
    "first": FirstFrame,
}


class PaperBackground:
    """Blur, background model, dilation: the paper's chain from picture to mask."""

    def __init__(self, model: Background, blur_px: int, dilate_px: int) -> None:
        odd = blur_px | 1  # a Gaussian kernel has a centre pixel
        self._blur = (odd, odd)
        self._circle = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (dilate_px, dilate_px))
        self._model = model

    def apply(self, raster: Raster, t_s: float, protect: Image) -> Image:
        """Return the dilated foreground mask of a colour picture; the paper protects nothing."""
        mask = self._model.apply(cv2.GaussianBlur(raster.image, self._blur, 0))
        return np.asarray(cv2.dilate(mask, self._circle), np.uint8)


def _differs(image: Image, background: Image) -> Image:
    largest = cv2.absdiff(image, background).max(axis=2)
    return np.asarray(cv2.compare(largest, DIFFERENCE_THRESHOLD, cv2.CMP_GT), np.uint8)
