"""The layout of the road view: every approach gets a band of one small metric raster.

A band's columns run along the station and its rows across the road, from left to right.  Curved
roads are cut into straight tiles, so that each tile is one perspective warp and only the road's own
pixels are touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.geo.ground import enu_to_px
from queuetail.traffic.road import length_m, place
from queuetail.types import Approach, Bools, Floats, GroundMapping, Ints

MARGIN_M = 2.5  # of shoulder beside the lanes: a sample of bare road at every station
SAGITTA_M = 0.12  # how far a straight tile may leave a curved axis
MIN_TILE_M = 8.0
GRID_M = 2.0  # spacing of the points at which the view is tested
FINEST_M, COARSEST_M = 0.12, 0.4
MIN_ALONG_PX_PER_M = 1.0  # a car is then 4 or 5 pixels long
MIN_ACROSS_PX_PER_M = 1.8
MAX_ROAD_M = 1200.0
REPLAN_M = 12.0  # of road that came into or left the picture before it is laid out anew
EDGE_PX = 3.0  # the outermost pixels of a picture are left out


@dataclass(frozen=True, slots=True)
class Tile:
    """A straight piece of a band: its columns, and the homography from raster to ENU."""

    first_column: int
    columns: int
    H_enu_raster: Floats  # of raster coordinates within the whole raster


@dataclass(frozen=True, slots=True)
class StripBand:
    """One approach in the raster: where its rows and columns lie on the road."""

    approach: Approach
    approach_index: int
    first_row: int
    rows: int
    columns: int
    start_station_m: float  # of column 0's left edge
    left_offset_m: float  # of row 0's upper edge
    metres_per_px: float
    tiles: tuple[Tile, ...]

    def station_m(self, column: Floats | Ints) -> Floats:
        """Return the stations of raster columns."""
        return np.asarray(self.start_station_m + column * self.metres_per_px, float)


@dataclass(frozen=True, slots=True)
class StripPlan:
    """All bands, stacked into one raster of `rows` × `columns`."""

    bands: tuple[StripBand, ...]
    rows: int
    columns: int
    metres_per_px: float


def plan_strip(
    approaches: Sequence[Approach],
    mapping: GroundMapping,
    size: tuple[int, int],
    resolution: float | None = None,
) -> StripPlan | None:
    """Lay out the raster for what the picture shows of the approaches; None where it shows none.

    `resolution` in metres per pixel is chosen from the picture's own where it is not given.
    """
    spans = [_visible_span(approach, mapping, size) for approach in approaches]
    seen = [(i, a, s) for i, (a, s) in enumerate(zip(approaches, spans, strict=True)) if s]
    if not seen:
        return None
    if resolution is None:
        finest = min(_ground_sample_m(a, s, mapping) for _, a, s in seen)
        resolution = float(np.clip(finest, FINEST_M, COARSEST_M))
    bands: list[StripBand] = []
    row = 0
    for index, approach, span in seen:
        band = _band(approach, index, span, row, resolution)
        bands.append(band)
        row += band.rows
    return StripPlan(tuple(bands), row, max(b.columns for b in bands), resolution)


def visible_columns(
    band: StripBand, mapping: GroundMapping, size: tuple[int, int]
) -> tuple[int, int]:
    """Return the first column that the picture shows at all lanes, and the one after the last."""
    stations = np.arange(0, band.columns + 1, max(round(GRID_M / band.metres_per_px), 1))
    half = band.approach.lane_width_m / 2
    inside = np.ones(len(stations), np.bool_)
    for offset in (-half, half - band.approach.lanes * band.approach.lane_width_m):
        enu = place(band.approach, band.station_m(stations), np.full(len(stations), offset))
        inside &= _inside(enu_to_px(mapping, enu), size)
    if not inside.any():
        return 0, 0
    seen = np.flatnonzero(inside)
    return int(stations[seen[0]]), int(min(stations[seen[-1]], band.columns))


def covers(old: StripPlan | None, new: StripPlan | None) -> bool:
    """Tell whether an old plan still serves: it shows nearly all that a new one would."""
    if old is None or new is None:
        return old is new
    if [b.approach_index for b in old.bands] != [b.approach_index for b in new.bands]:
        return False
    for a, b in zip(old.bands, new.bands, strict=True):
        a_end, b_end = (float(x.station_m(np.array(x.columns))) for x in (a, b))
        if abs(a.start_station_m - b.start_station_m) > REPLAN_M or abs(a_end - b_end) > REPLAN_M:
            return False
    return True


def _visible_span(
    approach: Approach, mapping: GroundMapping, size: tuple[int, int]
) -> tuple[float, float] | None:
    """Return the longest stretch of stations that is in the picture and near enough."""
    stations = approach.start_station_m + np.arange(0.0, length_m(approach) + GRID_M, GRID_M)
    middle = np.full(len(stations), -approach.lanes * approach.lane_width_m / 2)
    enu = place(approach, stations, middle)
    px = enu_to_px(mapping, enu)
    ahead = enu_to_px(mapping, place(approach, stations + 1.0, middle))
    aside = enu_to_px(mapping, place(approach, stations, middle + 1.0))
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(ahead - px, axis=1) >= MIN_ALONG_PX_PER_M
        near &= np.linalg.norm(aside - px, axis=1) >= MIN_ACROSS_PX_PER_M
    good = _inside(px, size) & near
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(np.int8), [0]])))
    if not len(edges):
        return None
    starts, ends = edges[::2], edges[1::2] - 1
    longest = int(np.argmax(ends - starts))
    first, last = float(stations[starts[longest]]), float(stations[ends[longest]])
    return (first, min(last, first + MAX_ROAD_M)) if last - first >= 4 * GRID_M else None


def _inside(px: Floats, size: tuple[int, int]) -> Bools:
    with np.errstate(invalid="ignore"):
        return (
            (px[:, 0] > EDGE_PX)
            & (px[:, 1] > EDGE_PX)
            & (px[:, 0] < size[0] - EDGE_PX)
            & (px[:, 1] < size[1] - EDGE_PX)
        )


def _ground_sample_m(
    approach: Approach, span: tuple[float, float], mapping: GroundMapping
) -> float:
    """Return the metres per pixel across the road where it is seen best."""
    stations = np.linspace(*span, 16)
    middle = np.full(16, -approach.lanes * approach.lane_width_m / 2)
    px = enu_to_px(mapping, place(approach, stations, middle))
    ahead = enu_to_px(mapping, place(approach, stations + 1.0, middle))
    return float(1.0 / np.nanmedian(np.linalg.norm(ahead - px, axis=1)))


def _band(
    approach: Approach, index: int, span: tuple[float, float], first_row: int, resolution: float
) -> StripBand:
    width_m = approach.lanes * approach.lane_width_m + 2 * MARGIN_M
    # Columns lie on one grid from the axis' start, whatever stretch of it is seen.
    start_m = np.floor(span[0] / resolution) * resolution
    columns = max(int((span[1] - start_m) / resolution), 1)
    rows = max(round(width_m / resolution), 1)
    tiles = tuple(
        _tile(approach, start_m, first_row, resolution, first, last)
        for first, last in _tile_columns(approach, start_m, columns, resolution)
    )
    return StripBand(
        approach, index, first_row, rows, columns, start_m, MARGIN_M, resolution, tiles
    )


def _tile_columns(
    approach: Approach, start_m: float, columns: int, resolution: float
) -> list[tuple[int, int]]:
    """Cut the columns so that the axis leaves its chord by at most the sagitta in each piece."""
    pieces, first = [], 0
    while first < columns:
        last = columns
        while last - first > MIN_TILE_M / resolution:
            inner = start_m + np.linspace(first, last, 9) * resolution
            points = place(approach, inner, np.zeros(9))
            chord = points[-1] - points[0]
            aside = points - points[0]
            bow = np.abs(chord[0] * aside[:, 1] - chord[1] * aside[:, 0]) / np.linalg.norm(chord)
            if bow.max() <= SAGITTA_M:
                break
            last = first + max((last - first) * 2 // 3, 1)
        pieces.append((first, last))
        first = last
    return pieces


def _tile(
    approach: Approach, start_m: float, first_row: int, resolution: float, first: int, last: int
) -> Tile:
    """Fit raster → ENU to a tile's four corners: exact on straights, continuous on bends."""
    stations = start_m + np.array([first, last, last, first]) * resolution
    width_m = approach.lanes * approach.lane_width_m + 2 * MARGIN_M
    rows = round(width_m / resolution)
    offsets = MARGIN_M - np.array([0, 0, rows, rows]) * resolution
    enu = place(approach, stations, offsets)
    raster = np.array(
        [[first, first_row], [last, first_row], [last, first_row + rows], [first, first_row + rows]]
    )
    H = cv2.getPerspectiveTransform(raster.astype(np.float32), enu.astype(np.float32))
    return Tile(first, last - first, np.asarray(H, float))
