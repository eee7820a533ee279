"""The paper's tracker: one mean-shift window per object, with its past positions.

Source: Messenger et al. (2023); mean shift after Comaniciu & Meer (2002), with the histogram
weighted by its surroundings after Comaniciu, Ramesh & Meer (2003).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.geo.earth import geodetic_from_enu, haversine_m
from queuetail.types import (
    Bools,
    Detections,
    Floats,
    GroundMapping,
    GroundPoints,
    Image,
    Raster,
    Scene,
    Tracks,
    TrackState,
)

Locate = Callable[[Detections, Raster, GroundMapping], GroundPoints]
Box = tuple[float, float, float, float]  # x, y, width, height in raster pixels

MIN_AGE_FRAMES = 8  # the paper's: younger objects are no cars yet
MAX_MISSED_FRAMES = 8
MIN_OVERLAP = 0.15  # intersection over union of a window and the blob that it may take
MAX_STANDING_SPEED_MPS = 3.0
MIN_STANDING_S = 0.6  # no background model absorbs a car sooner
MIN_WEIGHT = 90  # of 255: mean back-projection in the window below which the object is lost
SPEED_WINDOW_S = 0.5  # past positions are compared over this time: one pixel per frame is 15 mph
MAX_SPEED_MPS = 60.0
MIN_TOP_SPEED_MPS = 5.0  # over SPEED_WINDOW_S at some time: what only sways is not a car
LENGTH_RANGE_M = (1.5, 35.0)
WIDTH_RANGE_M = (0.5, 12.0)
CHANNELS, HISTOGRAM_BINS, RANGES = (1, 2), (8, 16), (0, 256, 0, 256)
# Saturation and value, not hue: grey cars differ from asphalt by value.
CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 1.0)


@dataclass(slots=True)
class _Object:
    """One followed object; `past` holds (t_s, east, north)."""

    track_id: int
    window: Box
    histogram: NDArray[np.float32]  # share of the object in each colour, 0 … 255
    past: deque[tuple[float, float, float]] = field(default_factory=deque)
    unseen_frames: int = 0  # since the last blob
    lost_frames: int = 0  # in which its colours were gone from the window
    is_car: bool = False
    top_speed_mps: float = 0.0
    slow_since_s: float | None = None  # by its blobs; None while it drives
    stood_s: float = 0.0  # for how long it had stood when it last had a blob


class MeanShiftTracker:
    """Follows objects in the picture; blobs correct the windows, stopped objects live by colour."""

    def __init__(self, locate: Locate) -> None:
        self._locate = locate
        self._objects: list[_Object] = []
        self._next_id = 1

    def footprints(self) -> None:
        """Say nothing: the paper's background does not ask."""

    def update(self, points: GroundPoints, scene: Scene) -> Tracks:
        """Move every window to its object, take in the new blobs, and return all objects."""
        assert isinstance(scene.raster, Raster)
        image = scene.raster.image
        colour = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
        scale = scene.raster.H_px_raster[0, 0], scene.raster.H_px_raster[1, 1]
        boxes: list[Box] = [tuple(b) for b in (points.boxes_px / np.tile(scale, 2)).tolist()]
        for item in self._objects:
            _shift(item, colour)
        free = self._associate(boxes)
        self._objects = [o for o in self._objects if _is_alive(o, image.shape)]
        for box in free:
            self._objects.append(_new_object(self._next_id, box, colour))
            self._next_id += 1
        self._objects = _without_doubles(self._objects)
        return self._tracks(scene)

    def _associate(self, boxes: list[Box]) -> list[Box]:
        """Give each blob to the window it overlaps most; return the blobs that start objects."""
        pairs = [(_overlap(o.window, b), i, o) for i, b in enumerate(boxes) for o in self._objects]
        pairs = sorted((p for p in pairs if p[0] >= MIN_OVERLAP), key=lambda p: -p[0])
        taken: set[int] = set()
        served: set[int] = set()
        for _, i, item in pairs:
            if i not in taken and item.track_id not in served:
                item.window = boxes[i]
                item.unseen_frames = item.lost_frames = 0
                taken.add(i)
                served.add(item.track_id)
        return [b for i, b in enumerate(boxes) if i not in taken and not self._is_part(b)]

    def _is_part(self, box: Box) -> bool:
        """Return whether a blob is but a piece of an object that is already followed."""
        centre, area = _centre(box), box[2] * box[3]
        return any(
            _contains(o.window, centre) and area < o.window[2] * o.window[3] / 2
            for o in self._objects
        )

    def _tracks(self, scene: Scene) -> Tracks:
        boxes = np.array([o.window for o in self._objects], float).reshape(-1, 4)
        assert isinstance(scene.raster, Raster)
        located = self._locate(
            Detections(boxes, boxes[:, 2] * boxes[:, 3]), scene.raster, scene.mapping
        )
        whole = _inside(boxes, scene.raster.image.shape)
        velocity = self._velocities(located.enu, whole, scene)
        speeds = np.linalg.norm(velocity, axis=1)
        for i, item in enumerate(self._objects):
            if speeds[i] < MAX_SPEED_MPS and len(item.past) >= MIN_AGE_FRAMES:
                item.top_speed_mps = max(item.top_speed_mps, float(speeds[i]))
            if not item.unseen_frames:
                _note_standing(item, float(speeds[i]), scene.t_s)
            item.is_car = _is_car(item, located.length_m[i], located.width_m[i], speeds[i])
        return Tracks(
            ids=np.array([o.track_id for o in self._objects], np.int64),
            states=tuple(_state(o) for o in self._objects),
            px=located.px,
            boxes_px=located.boxes_px,
            enu=located.enu,
            velocity_mps=velocity,
            sigma_m=located.sigma_m,
            length_m=located.length_m,
        )

    def _velocities(self, enu: Floats, whole: Bools, scene: Scene) -> Floats:
        """Haversine distance from the place half a second ago, over the time that passed since.

        Only places where the object was `whole` count: at the picture's edge a cut box lags.
        """
        before = np.empty_like(enu)
        seconds = np.zeros(len(enu))
        for i, item in enumerate(self._objects):
            if not whole[i]:
                item.past.clear()
            item.past.append((scene.t_s, float(enu[i, 0]), float(enu[i, 1])))
            while len(item.past) > 2 and scene.t_s - item.past[1][0] >= SPEED_WINDOW_S:
                item.past.popleft()
            t_s, *place = item.past[0]
            before[i], seconds[i] = place, scene.t_s - t_s
        moved = enu - before
        distance = np.linalg.norm(moved, axis=1)
        if scene.mapping.origin is not None:
            here = geodetic_from_enu(enu, scene.mapping.origin)
            there = geodetic_from_enu(before, scene.mapping.origin)
            great_circle = haversine_m(*there, *here)
            moved = moved * (great_circle / np.maximum(distance, 1e-9))[:, None]
        velocity = moved / np.maximum(seconds, 1e-9)[:, None]
        return np.where(seconds[:, None] > 0, velocity, 0.0)


def _is_car(item: _Object, length_m: float, width_m: float, speed_mps: float) -> bool:
    """The paper's car test: old enough, of a car's size, at a car's speed."""
    return bool(
        len(item.past) >= MIN_AGE_FRAMES
        and LENGTH_RANGE_M[0] <= length_m <= LENGTH_RANGE_M[1]
        and WIDTH_RANGE_M[0] <= width_m <= WIDTH_RANGE_M[1]
        and item.top_speed_mps >= MIN_TOP_SPEED_MPS
        and speed_mps <= MAX_SPEED_MPS
    )


def _state(item: _Object) -> TrackState:
    if not item.is_car or (item.unseen_frames and not _may_fade(item)):
        return TrackState.TENTATIVE
    return TrackState.COASTING if item.unseen_frames else TrackState.CONFIRMED


def _may_fade(item: _Object) -> bool:
    """Return whether an object without a blob may still be there: only a car that stood.

    What drives does not fade from the mask, so a window that loses its blob then lost its car.
    """
    return item.is_car and item.stood_s >= MIN_STANDING_S


def _note_standing(item: _Object, speed_mps: float, t_s: float) -> None:
    if not speed_mps <= MAX_STANDING_SPEED_MPS:
        item.slow_since_s = None
    elif item.slow_since_s is None:
        item.slow_since_s = t_s
    item.stood_s = 0.0 if item.slow_since_s is None else t_s - item.slow_since_s


def _new_object(track_id: int, box: Box, colour: Image) -> _Object:
    """Start an object with the histogram of its box over that of its surroundings."""
    inside, around = _crop(colour, box), _crop(colour, _grown(box))
    own = cv2.calcHist([inside], CHANNELS, None, HISTOGRAM_BINS, RANGES)
    total = cv2.calcHist([around], CHANNELS, None, HISTOGRAM_BINS, RANGES)
    share = np.divide(255 * own, total, out=np.zeros_like(own), where=total > 0)
    return _Object(track_id, box, np.asarray(share, np.float32))


def _shift(item: _Object, colour: Image) -> None:
    """One mean-shift search around the window; a window without its colours counts as missed."""
    item.unseen_frames += 1
    grown = _grown(item.window)
    left, top = max(int(grown[0]), 0), max(int(grown[1]), 0)
    weights = cv2.calcBackProject([_crop(colour, grown)], CHANNELS, item.histogram, RANGES, 1)
    x, y, width, height = item.window
    start = (round(x) - left, round(y) - top, max(round(width), 1), max(round(height), 1))
    _, (u, v, width_px, height_px) = cv2.meanShift(weights, start, CRITERIA)
    held = weights[max(v, 0) : v + height_px, max(u, 0) : u + width_px]
    if held.size and held.mean() >= MIN_WEIGHT:
        item.window = (float(u + left), float(v + top), width, height)
    else:
        item.lost_frames += 1


def _is_alive(item: _Object, shape: tuple[int, ...]) -> bool:
    x, y = _centre(item.window)
    inside = 1 < x < shape[1] - 1 and 1 < y < shape[0] - 1
    # A car that stops fades from the mask and lives on by its colours; anything else does not.
    missed = item.lost_frames if _may_fade(item) else item.unseen_frames
    return inside and missed <= MAX_MISSED_FRAMES


def _inside(boxes: Floats, shape: tuple[int, ...]) -> Bools:
    """Return which boxes the picture's edge does not cut."""
    far = boxes[:, :2] + boxes[:, 2:]
    low_enough = (far < [shape[1] - 1, shape[0] - 1]).all(axis=1)
    return np.asarray((boxes[:, :2] > 1).all(axis=1) & low_enough)


def _without_doubles(objects: list[_Object]) -> list[_Object]:
    """Of two objects whose windows share their centres keep the older."""
    kept: list[_Object] = []
    for item in objects:
        centre = _centre(item.window)
        if not any(
            _contains(o.window, centre) and _contains(item.window, _centre(o.window)) for o in kept
        ):
            kept.append(item)
    return kept


def _crop(image: Image, box: Box) -> Image:
    x, y, width, height = box
    left, top = max(int(x), 0), max(int(y), 0)
    right, bottom = max(int(x + width), left + 1), max(int(y + height), top + 1)
    cropped = image[min(top, image.shape[0] - 1) : bottom, min(left, image.shape[1] - 1) : right]
    return np.ascontiguousarray(cropped)


def _grown(box: Box) -> Box:
    x, y, width, height = box
    margin = max(width, height) / 2
    return x - margin, y - margin, width + 2 * margin, height + 2 * margin


def _overlap(a: Box, b: Box) -> float:
    """Intersection over union."""
    width = min(a[0] + a[2], b[0] + b[2]) - max(a[0], b[0])
    height = min(a[1] + a[3], b[1] + b[3]) - max(a[1], b[1])
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / (a[2] * a[3] + b[2] * b[3] - width * height)


def _centre(box: Box) -> tuple[float, float]:
    return box[0] + box[2] / 2, box[1] + box[3] / 2


def _contains(box: Box, point: tuple[float, float]) -> bool:
    x, y, width, height = box
    return x <= point[0] <= x + width and y <= point[1] <= y + height
