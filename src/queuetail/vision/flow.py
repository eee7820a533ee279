"""How fast what stands in each lane moves: one road view compared with the one before.

The road view holds the ground still, so along a lane only vehicles move, and they move along it: a
search in one dimension.  It tells how fast a vehicle is even where its ends are not seen, because
it merges with others or is half hidden, and at once: no track is needed.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from queuetail.types import Band, Floats, Image, Picture, RoadRaster

FASTEST_MPS, BACKWARD_MPS = 42.0, 2.0  # what is searched; a little backward, so that 0 is no end
HALF_WIDTH_M = 0.9  # of the lane's middle that is compared
MIDDLE_HEIGHT_M = 0.8  # of a vehicle: where its middle appears, by the lean there
STRIPS = 3  # across the lane: near side, middle and far side have textures of their own
WINDOW_M = 3.0  # along the road, over which one speed is taken,
STEP_M = 0.5  # at stations so far apart
LONGEST_S = 0.35  # between two pictures that are compared
MOST_UNLIKE = 0.5  # mismatch at the best shift, as a share of that at the worst
LEAST_TEXTURE = 4.0  # grey levels of mismatch at the worst shift


class LaneFlow:
    """Compares every road view with the one before it, lane by lane."""

    def __init__(self) -> None:
        self._plan = -1
        self._t_s = -math.inf
        self._before: list[Image] = []

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
        return [
            _speeds(a, b, raster.px_per_m, dt_s, band.visible_columns)
            for a, b, band in zip(now, before, raster.bands, strict=True)
        ]


def _signatures(raster: RoadRaster, band: Band) -> Image:
    """Return each lane's brightness along the road, in strips: (lanes · STRIPS, columns)."""
    lean = float(band.lean_px[:, 1].mean()) * MIDDLE_HEIGHT_M
    half = HALF_WIDTH_M * raster.px_per_m
    height = band.rows[1] - band.rows[0]
    strips = np.empty((len(band.lane_rows) * STRIPS, band.columns), np.uint8)
    for lane, row in enumerate(band.lane_rows):
        top = max(round(row + lean - half), 0)
        bottom = min(max(round(row + lean + half), top + STRIPS), height)
        rows = slice(band.rows[0] + min(top, bottom - STRIPS), band.rows[0] + bottom)
        strips[lane * STRIPS : (lane + 1) * STRIPS] = cv2.resize(
            raster.image[rows, : band.columns],
            (band.columns, STRIPS),
            interpolation=cv2.INTER_AREA,
        )
    return strips


def _speeds(
    now: Image, before: Image, px_per_m: float, dt_s: float, visible: tuple[int, int]
) -> Floats:
    """Return the speed at every column of every lane, (lanes, columns), alike over STEP_M.

    Nothing is told of where the picture does not show all that may have come there.
    """
    rows, columns = now.shape
    lanes = rows // STRIPS
    backward = min(math.ceil(BACKWARD_MPS * dt_s * px_per_m), columns - 1)
    forward = min(math.ceil(FASTEST_MPS * dt_s * px_per_m), columns - 1)
    count = backward + forward + 1
    padded = cv2.copyMakeBorder(before, 0, 0, forward, backward, cv2.BORDER_REPLICATE)
    unlike = np.empty((count, rows, columns), np.uint8)
    for i, shift in enumerate(range(-backward, forward + 1)):
        # Column x is compared with column x − shift of the picture before.
        since = forward - shift
        cv2.absdiff(now, padded[:, since : since + columns], dst=unlike[i])
    step = min(max(round(STEP_M * px_per_m), 1), columns)
    smooth = _smoothed(unlike, lanes, step, px_per_m)
    speeds = _best(smooth, backward, px_per_m * dt_s)
    speeds = speeds[:, np.minimum(np.arange(columns) // step, speeds.shape[1] - 1)]
    speeds[:, : visible[0] + forward] = np.nan
    speeds[:, max(visible[1] - backward, 0) :] = np.nan
    return speeds


def _smoothed(unlike: Image, lanes: int, step: int, px_per_m: float) -> Picture:
    """Return the mismatch (shifts, lanes, steps), averaged over a lane's strips and a window."""
    count, _, columns = unlike.shape
    steps = columns // step
    rows = unlike.reshape(count * lanes * STRIPS, columns)[:, : steps * step]
    coarse = cv2.resize(rows, (steps, count * lanes), interpolation=cv2.INTER_AREA)
    window = 2 * round(WINDOW_M * px_per_m / step / 2) + 1
    smooth = cv2.boxFilter(coarse, cv2.CV_32F, (window, 1), normalize=True)
    return np.asarray(smooth.reshape(count, lanes, steps))


def _best(unlike: Picture, backward: int, px_per_mps: float) -> Floats:
    """Return the speed of least mismatch, (lanes, columns); NaN where no shift stands out."""
    count = len(unlike)
    best = unlike.argmin(axis=0)
    inner = np.clip(best, 1, max(count - 2, 1))
    at = np.stack([inner - 1, inner, np.minimum(inner + 1, count - 1)])
    less, least, more = np.take_along_axis(unlike, at, axis=0)
    # The mismatch of absolute values is a valley with straight sides.
    slope = np.maximum(np.maximum(less, more) - least, 1e-6)
    shift = inner - backward + np.clip((less - more) / (2 * slope), -0.5, 0.5)
    worst = unlike.max(axis=0)
    known = (least < MOST_UNLIKE * worst) & (worst > LEAST_TEXTURE)
    known &= (best > 0) & (best < count - 1)
    return np.where(known, shift / px_per_mps, np.nan).astype(np.float32)
