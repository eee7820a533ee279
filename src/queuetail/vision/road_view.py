"""The road view: what the picture shows of every approach, rectified into a metric raster."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from queuetail.geo.ground import apply_homography, enu_to_px
from queuetail.traffic.road import place
from queuetail.types import (
    MAYBE,
    MOVED,
    Approach,
    Band,
    Bools,
    Floats,
    Frame,
    GroundMapping,
    Image,
    Ints,
    LaneDetections,
    LaneSight,
    RoadPoints,
    RoadRaster,
)
from queuetail.vision.flow import MIDDLE_HEIGHT_M
from queuetail.vision.foot import camera_above_ground
from queuetail.vision.strip import (
    StripBand,
    StripPlan,
    Tile,
    covers,
    plan_strip,
    visible_columns,
)

RECHECK_S = 0.2  # how often it is looked at what the picture shows,
HARDLY_PX, RECHECK_STILL_S = 3.0, 2.0  # but less often while it hardly moves
LEAN_BLOCKS = 12  # along a band: the lean changes slowly
# Of a followed vehicle: approach, lane, stations of its rear and front, whether it is surely a car,
# and whether it has moved.
Footprint = tuple[int, int, float, float, bool, bool]
CAR_HEIGHT_M, TRUCK_HEIGHT_M, TRUCK_LENGTH_M = 1.6, 4.0, 6.5


class RoadView:
    """Renders the approaches of a frame, and places what is found there on the road."""

    def __init__(self) -> None:
        self._plan: StripPlan | None = None
        self._serial = 0
        self._approaches: tuple[Approach, ...] = ()
        self._image = np.zeros((0, 0), np.uint8)
        self._colour = np.zeros((2, 0, 0), np.uint8)
        self._bands: tuple[Band, ...] = ()
        self._shrinks: list[list[int]] = []  # of each band's tiles, at the last look
        self._checked_s = -np.inf
        self._height_m = np.inf  # of the camera above the road
        self._corners_enu: Floats | None = None  # of the lower half of the picture, then

    def render(
        self, frame: Frame, mapping: GroundMapping, approaches: tuple[Approach, ...]
    ) -> RoadRaster:
        """Return the raster of this frame; its image is overwritten by the next call."""
        if approaches is not self._approaches or self._has_moved(frame, mapping):
            self._lay_out(frame, mapping, approaches)
        if self._plan is None:
            return RoadRaster(self._image, 1.0, (), self._serial, approaches, t_s=frame.t_s)
        for band, shrinks in zip(self._plan.bands, self._shrinks, strict=True):
            for tile, shrink in zip(band.tiles, shrinks, strict=True):
                self._render_tile(frame, mapping, band, tile, shrink)
        return RoadRaster(
            image=self._image,
            px_per_m=1.0 / self._plan.metres_per_px,
            bands=self._bands,
            plan=self._serial,
            approaches=approaches,
            spans=self._spans(),
            t_s=frame.t_s,
            colour=self._colour if frame.chroma else None,
            H_true_enu=mapping.H_true_enu,
        )

    def cover(self, footprints: Sequence[Footprint]) -> Image:
        """Mask the raster where vehicles are: MOVED, or MAYBE what has never moved."""
        mask = np.zeros_like(self._image)
        for strip, band in zip(self._plan.bands if self._plan else (), self._bands, strict=True):
            half = strip.approach.lane_width_m / 2 / strip.metres_per_px
            lean_px = band.lean_px.tolist()
            for approach, lane, rear_m, front_m, _, moved in footprints:
                if approach != strip.approach_index or lane > len(band.lane_rows):
                    continue
                middle = band.lane_rows[lane - 1]
                first = (rear_m - strip.start_station_m) / strip.metres_per_px
                last = (front_m - strip.start_station_m) / strip.metres_per_px
                block = int(min(max(first / strip.columns, 0.0), 0.999) * len(lean_px))
                height_m = CAR_HEIGHT_M if front_m - rear_m < TRUCK_LENGTH_M else TRUCK_HEIGHT_M
                across, up = lean_px[block][0] * height_m, lean_px[block][1] * height_m
                top = max(int(middle - half + min(up, 0)), 0)
                bottom = min(int(middle + half + max(up, 0)) + 1, strip.rows)
                left, right = int(first + min(across, 0)), int(last + max(across, 0)) + 1
                rows = slice(strip.first_row + top, strip.first_row + max(bottom, top))
                part = mask[rows, max(left, 0) : max(right, 0)]
                np.maximum(part, MOVED if moved else MAYBE, out=part)
        return mask

    def low(self, footprints: Sequence[Footprint]) -> tuple[Bools, ...]:
        """Say of each band (lanes, columns) where cars are: they hide nothing of the next lane."""
        lows = []
        for strip in self._plan.bands if self._plan else ():
            low = np.zeros((strip.approach.lanes, strip.columns), np.bool_)
            for approach, lane, rear_m, front_m, is_car, _ in footprints:
                if is_car and approach == strip.approach_index and lane <= len(low):
                    first = (rear_m - strip.start_station_m) / strip.metres_per_px
                    last = (front_m - strip.start_station_m) / strip.metres_per_px
                    low[lane - 1, max(int(first), 0) : max(int(last) + 1, 0)] = True
            lows.append(low)
        return tuple(lows)

    def locate(
        self, detections: LaneDetections, raster: RoadRaster, mapping: GroundMapping
    ) -> RoadPoints:
        """Turn columns and rows into stations and offsets."""
        strips = self._plan.bands if self._plan else ()
        index = np.array([b.approach_index for b in strips], np.int64)
        start = np.array([b.start_station_m for b in strips])
        left = np.array([b.left_offset_m for b in strips])
        scale = 1.0 / raster.px_per_m
        band = detections.band
        if not len(band):
            empty = np.empty(0)
            return RoadPoints(
                detections.band, detections.lane, empty, empty, empty,
                detections.cut_rear, detections.cut_front, empty, empty, detections.shadow,
                detections.roof, detections.astride, raster.spans, np.empty((0, 4)),
                self._sights(detections),
            )  # fmt: skip
        rear = start[band] + detections.rear_column * scale
        front = start[band] + detections.front_column * scale
        offset = left[band] - detections.row * scale
        return RoadPoints(
            approach=index[band],
            lane=detections.lane,
            rear_m=rear,
            front_m=front,
            offset_m=offset,
            cut_rear=detections.cut_rear,
            cut_front=detections.cut_front,
            contrast=detections.contrast,
            body=detections.body,
            shadow=detections.shadow,
            roof=detections.roof,
            astride=detections.astride,
            spans=raster.spans,
            boxes_px=_boxes_px(raster.approaches, index[band], rear, front, offset, mapping),
            sights=self._sights(detections),
            bodies=tuple(
                s + b * scale for s, b in zip(start[band], detections.bodies, strict=False)
            ),
        )

    def _sights(self, detections: LaneDetections) -> dict[tuple[int, int], LaneSight]:
        strips = self._plan.bands if self._plan else ()
        sights = {}
        # What is seen of a vehicle is nearer to the camera than the road, and seems to move faster.
        slower = 1.0 - MIDDLE_HEIGHT_M / max(self._height_m, 10.0)
        for strip, speeds, hidden in zip(
            strips, detections.speed_mps, detections.hidden, strict=False
        ):
            for lane, (speed, hides) in enumerate(zip(speeds, hidden, strict=True), 1):
                sights[strip.approach_index, lane] = LaneSight(
                    strip.start_station_m, strip.metres_per_px, speed * slower, hides
                )
        return sights

    def _spans(self) -> dict[int, tuple[float, float]]:
        assert self._plan is not None
        spans = {}
        for strip, band in zip(self._plan.bands, self._bands, strict=True):
            first, last = band.visible_columns
            if last > first:
                ends = strip.station_m(np.array([first, last]))
                spans[strip.approach_index] = (float(ends[0]), float(ends[1]))
        return spans

    def _has_moved(self, frame: Frame, mapping: GroundMapping) -> bool:
        """Tell whether the picture shows enough else than when it was last looked at."""
        since_s = frame.t_s - self._checked_s
        if since_s < RECHECK_S:
            return False
        if since_s >= RECHECK_STILL_S or self._corners_enu is None:
            return True
        width, height = frame.size
        moved = apply_homography(mapping.H_px_enu, self._corners_enu) - _corners(width, height)
        return not bool((np.abs(moved) < HARDLY_PX).all())

    def _lay_out(
        self, frame: Frame, mapping: GroundMapping, approaches: tuple[Approach, ...]
    ) -> None:
        """Refresh what is visible, and plan anew where the picture now shows other road."""
        self._checked_s = frame.t_s
        self._corners_enu = apply_homography(mapping.H_enu_px, _corners(*frame.size))
        known = approaches is self._approaches
        resolution = self._plan.metres_per_px if known and self._plan else None
        plan = plan_strip(approaches, mapping, frame.size, resolution)
        if not known or not covers(self._plan, plan):
            self._plan, self._approaches = plan, approaches
            self._serial += 1
            shape = (plan.rows, plan.columns) if plan else (0, 0)
            self._image = np.zeros(shape, np.uint8)
            self._colour = np.zeros((2, *((n + 1) // 2 for n in shape)), np.uint8)
        camera = camera_above_ground(mapping)
        self._height_m = camera[1]
        strips = self._plan.bands if self._plan else ()
        self._bands = tuple(_seen_band(b, mapping, frame.size, camera) for b in strips)
        self._shrinks = [[_shrink(mapping, b, tile) for tile in b.tiles] for b in strips]

    def _render_tile(
        self, frame: Frame, mapping: GroundMapping, band: StripBand, tile: Tile, shrink: int
    ) -> None:
        """Draw the tile's part of the raster, and of its colour at half the size."""
        left, right = tile.first_column, tile.first_column + tile.columns
        top, bottom = band.first_row, band.first_row + band.rows
        H_px_tile = _tile_to_px(mapping, band, tile)
        size = (right - left, bottom - top)
        (self._image[top:bottom, left:right],) = _warped((frame.luma,), H_px_tile, size, shrink)
        if not frame.chroma:
            return
        # Half pixels that two tiles or bands share go to the later one.
        H_tile_half = np.array([[2.0, 0, -(left % 2)], [0, 2.0, -(top % 2)], [0, 0, 1]])
        left, right, top, bottom = left // 2, (right + 1) // 2, top // 2, (bottom + 1) // 2
        size = (right - left, bottom - top)
        across, down = np.array(frame.chroma[0].shape[::-1]) / frame.size
        H_chroma_half = np.diag([across, down, 1.0]) @ H_px_tile @ H_tile_half
        warped = _warped(frame.chroma, H_chroma_half, size, shrink)
        for colour, part in zip(self._colour, warped, strict=True):
            colour[top:bottom, left:right] = part


def _corners(width: int, height: int) -> Floats:
    """Return the corners of the lower half of a picture: what lies below every horizon."""
    return np.array([[0.0, height / 2], [width, height / 2], [width, height], [0.0, height]])


def _seen_band(
    strip: StripBand, mapping: GroundMapping, size: tuple[int, int], camera: tuple[Floats, float]
) -> Band:
    """Return how the camera sees a band of the plan at present."""
    width = strip.approach.lane_width_m
    return Band(
        approach_index=strip.approach_index,
        rows=(strip.first_row, strip.first_row + strip.rows),
        columns=strip.columns,
        first_column=round(strip.start_station_m / strip.metres_per_px),
        visible_columns=visible_columns(strip, mapping, size),
        lane_rows=tuple(
            (strip.left_offset_m + (lane + 0.5) * width) / strip.metres_per_px
            for lane in range(strip.approach.lanes)
        ),
        lane_width_px=width / strip.metres_per_px,
        lean_px=_lean_px(strip, camera),
    )


def _lean_px(strip: StripBand, camera: tuple[Floats, float]) -> Floats:
    """Return how far a point one metre up is displaced away from the camera, per block."""
    foot, height_m = camera
    columns = (np.arange(LEAN_BLOCKS) + 0.5) * strip.columns / LEAN_BLOCKS
    stations = strip.station_m(columns)
    middle = np.full(LEAN_BLOCKS, -strip.approach.lanes * strip.approach.lane_width_m / 2)
    here = place(strip.approach, stations, middle)
    along = place(strip.approach, stations + 1.0, middle) - here
    lean = (here - foot) / height_m
    right = np.column_stack([along[:, 1], -along[:, 0]])
    shift = np.column_stack([(lean * along).sum(axis=1), (lean * right).sum(axis=1)])
    return shift / strip.metres_per_px


def _boxes_px(
    approaches: tuple[Approach, ...],
    index: Ints,
    rear: Floats,
    front: Floats,
    offset: Floats,
    mapping: GroundMapping,
) -> Floats:
    """Return boxes (x, y, width, height) around the ground that detections cover, in pixels."""
    boxes = np.empty((len(index), 4))
    for number in sorted(set(index.tolist())):
        at = np.flatnonzero(index == number)
        stations = np.concatenate([rear[at], front[at], front[at], rear[at]])
        sides = np.repeat([1.0, 1.0, -1.0, -1.0], len(at))
        enu = place(approaches[number], stations, np.tile(offset[at], 4) + sides)
        px = enu_to_px(mapping, enu).reshape(4, -1, 2)
        low = px.min(axis=0)
        boxes[at] = np.concatenate([low, px.max(axis=0) - low], axis=1)
    return boxes


def _source_window(
    H_px_tile: Floats, columns: int, rows: int, shape: tuple[int, ...]
) -> tuple[int, int, int, int]:
    """Return the pixels (left, top, right, bottom) of the frame that a tile needs."""
    corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]], float)
    px = apply_homography(H_px_tile, corners)
    if not np.isfinite(px).all():
        return 0, 0, shape[1], shape[0]
    low, high = np.floor(px.min(axis=0)) - 2, np.ceil(px.max(axis=0)) + 2
    return (
        int(np.clip(low[0], 0, shape[1])),
        int(np.clip(low[1], 0, shape[0])),
        int(np.clip(high[0], 0, shape[1])),
        int(np.clip(high[1], 0, shape[0])),
    )


def _warped(
    planes: Sequence[Image], H_px_tile: Floats, size: tuple[int, int], shrink: int
) -> list[Image]:
    """Return what planes of one size show of a tile of `size` (columns, rows); 0 for nothing."""
    left, top, right, bottom = _source_window(H_px_tile, *size, planes[0].shape)
    if right - left < 2 or bottom - top < 2:
        return [np.zeros(size[::-1], np.uint8) for _ in planes]
    to_window = np.array([[1 / shrink, 0, -left / shrink], [0, 1 / shrink, -top / shrink]])
    M = _centred(np.vstack([to_window, [0, 0, 1]]) @ H_px_tile)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = []
    for plane in planes:
        source = plane[top:bottom, left:right]
        if shrink > 1:
            # Averaging first keeps fine texture of a large picture from turning into noise.
            height, width = (max(n // shrink, 1) for n in source.shape)
            source = source[: height * shrink, : width * shrink]
            source = cv2.resize(source, (width, height), interpolation=cv2.INTER_AREA)
        warped.append(np.asarray(cv2.warpPerspective(source, M, size, flags=flags), np.uint8))
    return warped


def _tile_to_px(mapping: GroundMapping, band: StripBand, tile: Tile) -> Floats:
    """Return the homography from a tile's own pixels to those of the frame."""
    corner = np.array([[1, 0, tile.first_column], [0, 1, band.first_row], [0, 0, 1.0]])
    return np.asarray(mapping.H_px_enu @ tile.H_enu_raster @ corner)


def _shrink(mapping: GroundMapping, band: StripBand, tile: Tile) -> int:
    """Return how many frame pixels one raster pixel covers each way, at least 1."""
    middle = np.array([tile.columns / 2, band.rows / 2])
    beside = middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    centre, ahead, aside = apply_homography(_tile_to_px(mapping, band, tile), beside)
    scale = min(np.linalg.norm(ahead - centre), np.linalg.norm(aside - centre))
    return max(int(scale), 1) if np.isfinite(scale) else 1


def _centred(H: Floats) -> Floats:
    """Convert a homography between pixel corners to one between pixel centres, as OpenCV counts."""
    to_corner = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    to_centre = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    return to_centre @ H @ to_corner
