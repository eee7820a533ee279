"""What a single picture tells of the road: the most common brightness of each row is asphalt.

Asphalt is alike along a lane, and vehicles are of many colours, so a queue that stands on the road
from the first picture on is told from it without any history.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.types import Band, Bools, Picture
from queuetail.vision.light import LIMITS, evened, without_trees

ALIKE = 20.0  # grey levels from its row's road that a pixel of road may differ by at the least,
GRAIN_SIGMAS = 2.5  # and so many sigmas of asphalt's own grain
CLOUD_RATIO = 1.25  # of the lightest to the darkest stretch of road: less is no cloud's edge
OTHER_ROAD, BROAD_M = 0.2, 1.0  # share of brightness by which lanes differ; broader than a line
LITTLE = 0.1
HALF_WIDTH = 1.18  # sigmas at which a bell has half its height


@dataclass(frozen=True, slots=True)
class FirstRoad:
    """A band's road as one picture tells it."""

    road: Picture  # (rows, columns) its brightness
    alike: Bools  # (rows, columns) where the picture itself shows it
    grain: float  # one sigma of its brightness along a row
    occluded: Bools  # (columns,) what may be a bridge or gantry, and is taken for part of the scene


def first_road(picture: Picture, band: Band, px_per_m: float) -> FirstRoad:
    """Return a band's road in a picture (rows, columns).

    What does not look like its row's road is left out, but for bridges and gantries.
    """
    even = _evenly_lit(picture, px_per_m)
    profile = road_profile(even, band, px_per_m)[:, None]
    grain = _grain(even - profile)
    alike = np.abs(even - profile) < max(ALIKE, GRAIN_SIGMAS * grain)
    road = np.where(alike, even, profile)
    occluded = _occluded(alike)
    road[:, occluded] = even[:, occluded]
    return FirstRoad(road, alike, grain, occluded)


def road_profile(picture: Picture, band: Band, px_per_m: float) -> Picture:
    """Return the brightness of each row's road, (rows,).

    A lane that is full of trucks is no other road than the lanes beside it.
    """
    counts = row_counts(picture)
    modes = counts.argmax(axis=1).astype(np.float32)
    half = band.lane_width_px / 2
    lanes = slice(max(round(band.lane_rows[0] - half), 0), round(band.lane_rows[-1] + half))
    of_all = counts[lanes].mean(axis=0)
    usual = int(of_all.argmax())
    size = 2 * round(BROAD_M * px_per_m / 2) + 1
    broad = cv2.medianBlur(modes.astype(np.uint8)[:, None], size)[:, 0].astype(np.float32)
    # A line, or the side of a truck, is a row's road only where more of it shows that than asphalt.
    paint = _common(counts, broad) > _common(counts, modes)
    modes[paint] = broad[paint]
    odd = np.zeros(len(modes), np.bool_)
    odd[lanes] = np.abs(broad[lanes] - usual) > max(OTHER_ROAD * usual, ALIKE)
    low, high = round((1 - OTHER_ROAD) * usual), round((1 + OTHER_ROAD) * usual)
    own = counts[odd] + LITTLE * of_all  # where a row shows no road at all, that of all lanes
    modes[odd] = low + own[:, low : high + 1].argmax(axis=1)
    return modes


def _common(counts: Picture, level: Picture) -> Picture:
    """Return how common a brightness (rows,), and what is like it, is in each row: (rows,)."""
    below = np.pad(np.cumsum(counts, axis=1), ((0, 0), (1, 0)))
    row, at = np.arange(len(level)), level.astype(np.intp)
    high, low = np.minimum(at + int(ALIKE), 255) + 1, np.maximum(at - int(ALIKE), 0)
    return np.asarray(below[row, high] - below[row, low], np.float32)


def row_modes(picture: Picture) -> Picture:
    """Return each row's most common brightness, (rows,)."""
    return row_counts(picture).argmax(axis=1).astype(np.float32)


def row_counts(picture: Picture) -> Picture:
    """Return how common each brightness, and what is next to it, is in each row: (rows, 256)."""
    rows = len(picture)
    levels = np.clip(picture, 0, 255).astype(np.intp)
    levels += np.arange(rows)[:, None] * 256
    counts = np.bincount(levels.ravel(), minlength=rows * 256).reshape(rows, 256)
    counts[:, 0] = 0  # nothing is seen there
    return np.asarray(cv2.GaussianBlur(counts.astype(np.float32), (25, 1), 4.0))


def _grain(residual: Picture) -> float:
    """Return the spread (one sigma) of road about its rows' own brightness."""
    counts = np.bincount(np.abs(residual).ravel().astype(np.intp), minlength=64)[:64]
    smooth = np.convolve(counts, np.ones(5) / 5, "valid")
    lower = np.flatnonzero(smooth < smooth[0] / 2)
    return float(lower[0] + 2) / HALF_WIDTH if len(lower) else 0.0


def _evenly_lit(picture: Picture, px_per_m: float) -> Picture:
    """Divide a first picture by its light along the road, so that clouds do not look like road.

    Most rows of a column are bare road or shoulder, even beside a queue.
    """
    profile = np.maximum(row_modes(picture), 1.0)[:, None]
    light = np.median(picture / profile, axis=0).astype(np.float32)
    columns = np.arange(len(light))
    seen = light > LIMITS[0]  # darker is only what the picture does not show
    if not seen.any():
        return picture
    light = np.interp(columns, columns[seen], light[seen]).astype(np.float32)
    light = evened(without_trees(light, px_per_m)[None], px_per_m)
    low, high = np.percentile(light, [5, 95])
    if high < CLOUD_RATIO * low:
        return picture
    return np.asarray(picture / np.clip(light, *LIMITS), np.float32)


def _occluded(alike: Bools) -> Bools:
    """Tell in which columns a bridge or gantry, which also covers both shoulders, hides the road.

    A truck between the shadows of trees may look like one.
    """
    shoulder = max(len(alike) // 8, 1)
    odd = np.logical_not(alike)
    across = (odd[:shoulder].mean(axis=0) > 0.7) & (odd[-shoulder:].mean(axis=0) > 0.7)
    return np.asarray(across & (odd.mean(axis=0) > 0.7))
