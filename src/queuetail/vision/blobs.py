"""Blobs of a foreground mask by OpenCV's SimpleBlobDetector: by colour and by area."""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.types import Detections, Image, Raster

MAX_AREA_SHARE = 0.1  # of the picture: anything larger is a change of light, not a vehicle


class SimpleBlobs:
    """The paper's detector: white blobs of at least `min_area_px2`."""

    def __init__(self, min_area_px2: float) -> None:
        self._min_area_px2 = min_area_px2
        self._shape: tuple[int, ...] | None = None
        self._detector: cv2.SimpleBlobDetector | None = None

    def find(self, mask: Image, raster: Raster, low: None = None) -> Detections:
        """Return the blobs of a (h, w) mask of 0 and 255, in its pixels."""
        if self._detector is None or self._shape != mask.shape:
            self._detector, self._shape = self._make(mask.size), mask.shape
        # A frame of background lets blobs at the picture's edge be closed contours.
        self._detector.detect(cv2.copyMakeBorder(mask, 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0))
        contours = self._detector.getBlobContours()
        boxes = np.array([cv2.boundingRect(c) for c in contours], float).reshape(-1, 4)
        boxes[:, :2] -= 1
        areas = np.array([cv2.contourArea(c) for c in contours], float)
        return Detections(boxes, areas)

    def _make(self, picture_area_px2: int) -> cv2.SimpleBlobDetector:
        parameters = cv2.SimpleBlobDetector.Params()
        parameters.minThreshold, parameters.maxThreshold, parameters.thresholdStep = 100, 200, 100
        parameters.minRepeatability = 1
        parameters.minDistBetweenBlobs = 1
        parameters.filterByColor, parameters.blobColor = True, 255
        parameters.filterByArea = True
        parameters.minArea = self._min_area_px2
        parameters.maxArea = max(MAX_AREA_SHARE * picture_area_px2, 2 * self._min_area_px2)
        parameters.filterByCircularity = False
        parameters.filterByConvexity = False
        parameters.filterByInertia = False
        parameters.collectContours = True
        return cv2.SimpleBlobDetector.create(parameters)
