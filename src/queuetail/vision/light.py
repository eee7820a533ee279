"""The light on the road, stretch by stretch: clouds' shadows and exposure are no vehicles."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from queuetail.types import Image, Picture

WINDOW_M = 9.0  # stretch of road over which brightness is compared
SHORTEST_M, STEP_M = 36.0, 1.0  # a shadow of less than half of that is a tree's, not a cloud's
LIMITS = (0.25, 4.0)
LEAST_BARE = 0.08  # of a column's rows, for its light to be seen


def light_along(image: Image, free: Image, road: Picture, px_per_m: float) -> Picture:
    """Return by how much each column of a band is brighter than the learnt road, (columns,).

    `image`, `free` (255 where road is seen bare) and `road` are (rows, columns).
    """
    seen = cv2.reduce(cv2.bitwise_and(image, free), 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F)
    known = cv2.reduce(cv2.copyTo(road, free), 0, cv2.REDUCE_SUM, dtype=cv2.CV_32F)
    seen, known = evened(seen, px_per_m), evened(known, px_per_m)
    light = _ratio_or_neighbour(seen[0], known[0], len(image))
    return without_trees(np.clip(light, *LIMITS), px_per_m)


def evened(values: Picture, px_per_m: float) -> Picture:
    """Return the means of values (1, columns) over a stretch of road."""
    window = max(round(WINDOW_M * px_per_m), 1)
    return np.asarray(cv2.blur(values, (window, 1), borderType=cv2.BORDER_REPLICATE))


def without_trees(light: Picture, px_per_m: float) -> Picture:
    """Return the light (columns,) without what is too short for a cloud's shadow."""
    step = max(round(STEP_M * px_per_m), 1)
    half = round(SHORTEST_M / STEP_M / 2)
    around = sliding_window_view(np.pad(light[::step], half, "symmetric"), 2 * half + 1)
    columns = np.arange(len(light))
    usual = np.partition(around, half, axis=1)[:, half]
    return np.interp(columns, columns[::step], usual).astype(np.float32)


def _ratio_or_neighbour(seen: Picture, road: Picture, rows: int) -> Picture:
    """Return seen / road per column; columns with too little bare road take the nearest ones'."""
    enough = road > LEAST_BARE * rows * max(float(np.median(road)) / max(rows, 1), 1.0)
    if enough.all():
        return seen / road
    if not enough.any():
        return np.ones_like(seen)
    columns = np.arange(len(seen))
    good = columns[enough]
    return np.interp(columns, good, seen[enough] / road[enough]).astype(np.float32)
