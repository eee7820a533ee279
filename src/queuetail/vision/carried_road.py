"""Learnt road taken along when the road view is laid out anew: the ground itself has not moved.

A new layout shows other road, or has better axes, or knows better where the picture lies; all of
these only move the pixels that show a place.
"""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.geo.ground import apply_homography
from queuetail.traffic.road import locate, place
from queuetail.types import Band, Floats, Image, Picture, RoadRaster

ROWS_APART = 16  # at which places are computed: between them they lie evenly
NOWHERE = -10.0


def carried(
    road: Picture, bare: Image, old: RoadRaster, new: RoadRaster, band: Band
) -> tuple[Picture, Image]:
    """Return what an old raster's `road`, seen `bare` (255) there, shows of a band of the new one.

    Both are (rows, columns); where nothing is known the second value is 0.
    """
    across, down = places_before(old, new, band)
    shown = cv2.remap(road, across, down, cv2.INTER_LINEAR)
    known = cv2.remap(bare, across, down, cv2.INTER_NEAREST, borderValue=0)
    return np.asarray(shown), np.asarray(known, np.uint8)


def places_before(old: RoadRaster, new: RoadRaster, band: Band) -> tuple[Picture, Picture]:
    """Return the column and row that each pixel of a band has in the old raster, -10 in none."""
    height = band.rows[1] - band.rows[0]
    knots = np.unique(np.append(np.arange(0, height, ROWS_APART), height - 1))
    column, row = np.meshgrid(np.arange(band.columns), knots)
    enu = _enu(new, band, column.ravel() + 0.5, row.ravel() + 0.5)
    H_old_new = old.H_true_enu @ np.linalg.inv(new.H_true_enu)
    enu = apply_homography(H_old_new, enu)
    weights = np.array([np.interp(np.arange(height), knots, k) for k in np.eye(len(knots))]).T
    across = np.full((height, band.columns), NOWHERE, np.float32)
    down = across.copy()
    for before in old.bands:
        x, y = (weights @ v.reshape(column.shape) for v in _columns_and_rows(old, before, enu))
        # Beyond its rows another band begins, or nothing.
        inside = (x > 0) & (x < before.columns) & (y > before.rows[0]) & (y < before.rows[1])
        inside &= across == NOWHERE
        across[inside], down[inside] = x[inside] - 0.5, y[inside] - 0.5
    return across, down


def _enu(raster: RoadRaster, band: Band, column: Floats, row: Floats) -> Floats:
    approach = raster.approaches[band.approach_index]
    station = (band.first_column + column) / raster.px_per_m
    return place(approach, station, _left_offset_m(raster, band) - row / raster.px_per_m)


def _columns_and_rows(raster: RoadRaster, band: Band, enu: Floats) -> tuple[Floats, Floats]:
    """Return the columns, and rows of the whole raster, at points (n, 2)."""
    station, offset, _ = locate(raster.approaches[band.approach_index], enu)
    column = station * raster.px_per_m - band.first_column
    return column, band.rows[0] + (_left_offset_m(raster, band) - offset) * raster.px_per_m


def _left_offset_m(raster: RoadRaster, band: Band) -> float:
    """Return the offset of a band's upper edge."""
    return (band.lane_rows[0] - band.lane_width_px / 2) / raster.px_per_m
