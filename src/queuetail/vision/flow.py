"""How fast what stands in each lane moves: one road view compared with the one before.

The road view holds the ground still, so along a lane only vehicles move, and they move along it: a
search in one dimension.  It tells how fast a vehicle is even where its ends are not seen, because
it merges with others or is half hidden, and at once: no track is needed.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from queuetail.types import Band, Floats, RoadRaster

FASTEST_MPS, BACKWARD_MPS = 42.0, 2.0  # what is searched; a little backward, so that 0 is no end
HALF_WIDTH_M = 0.9  # of the lane's middle that is compared
MIDDLE_HEIGHT_M = 0.8  # of a vehicle: where its middle appears, by the lean there
STRIPS = 3  # across the lane: near side, middle and far side have textures of their own
WINDOW_M = 3.0  # along the road, over which one speed is taken
LONGEST_S = 0.35  # between two pictures that are compared
MOST_UNLIKE = 0.5  # mismatch at the best shift, as a share of that at the worst
LEAST_TEXTURE = 4.0  # grey levels of mismatch at the worst shift

Signature = NDArray[np.float32]


class LaneFlow:
    """Compares every road view with the one before it, lane by lane."""

    def __init__(self) -> None:
        self._plan = -1
        self._t_s = -math.inf
        self._before: list[Signature] = []

    def measure(self, raster: RoadRaster) -> list[Floats]:
        """Return for every band the speed (lanes, columns) in m/s; NaN where nothing tells it.

        Speeds are along the road, downstream positive.
        """
        now = [_signatures(raster, band) for band in raster.bands]
        before, dt_s = self._before, raster.t_s - self._t_s
        comparable = self._plan == raster.plan and 0 < dt_s <= LONGEST_S
        self._before, self._plan, self._t_s = now, raster.plan, raster.t_s
        if not comparable:
            return [
                np.full((len(b.lane_rows), b.columns), np.nan, np.float32) for b in raster.bands
            ]
        return [_speeds(a, b, raster.px_per_m, dt_s) for a, b in zip(now, before, strict=True)]


def _signatures(raster: RoadRaster, band: Band) -> Signature:
    """Return each lane's brightness along the road, in strips: (lanes, STRIPS, columns)."""
    lean = float(band.lean_px[:, 1].mean()) * MIDDLE_HEIGHT_M
    half = HALF_WIDTH_M * raster.px_per_m
    rows = []
    for row in band.lane_rows:
        top = max(round(row + lean - half), 0)
        bottom = min(max(round(row + lean + half), top + STRIPS), band.rows[1] - band.rows[0])
        top = min(top, bottom - STRIPS)
        lane = raster.image[band.rows[0] + top : band.rows[0] + bottom, : band.columns]
        rows.append(cv2.resize(lane, (band.columns, STRIPS), interpolation=cv2.INTER_AREA))
    return np.array(rows, np.float32)


def _speeds(now: Signature, before: Signature, px_per_m: float, dt_s: float) -> Floats:
    """Return the speed at every column of every lane, (lanes, columns)."""
    lanes, _, columns = now.shape
    backward = math.ceil(BACKWARD_MPS * dt_s * px_per_m)
    forward = math.ceil(FASTEST_MPS * dt_s * px_per_m)
    count = backward + forward + 1
    # Shift s compares column x with column x − s of the picture before.
    padded = np.pad(before, ((0, 0), (0, 0), (forward, backward)), mode="edge")
    shifted = sliding_window_view(padded, columns, axis=2)[:, :, ::-1]
    unlike = np.abs(now[:, :, None] - shifted).sum(axis=1) / STRIPS  # (lanes, count, columns)
    window = 2 * round(WINDOW_M * px_per_m / 2) + 1
    unlike = cv2.blur(unlike.reshape(lanes * count, columns), (window, 1))
    unlike = unlike.reshape(lanes, count, columns)
    best = unlike.argmin(axis=1)
    inner = np.clip(best, 1, count - 2)
    at = np.stack([inner - 1, inner, inner + 1], axis=1)
    less, least, more = np.moveaxis(np.take_along_axis(unlike, at, axis=1), 1, 0)
    # Mismatch of absolute values is a valley with straight sides.
    slope = np.maximum(np.maximum(less, more) - least, 1e-6)
    shift = inner - backward + np.clip((less - more) / (2 * slope), -0.5, 0.5)
    worst = unlike.max(axis=1)
    known = (least < MOST_UNLIKE * worst) & (worst > LEAST_TEXTURE)
    known &= (best > 0) & (best < count - 1)
    return np.where(known, shift / (px_per_m * dt_s), np.nan).astype(np.float32)
