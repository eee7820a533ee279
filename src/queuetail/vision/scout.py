"""The scout: moving vehicles anywhere in the picture, at low resolution, before the road is known.

The luma is scaled down and laid on a canvas that the ground stands still on; what differs from a
slowly learnt background is foreground, its blobs are placed on the ground, and those of a
vehicle's size are followed.  It is made for learning where the road is, not for measuring queues.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from dataclasses import dataclass
from statistics import median

import cv2
import numpy as np

from queuetail.geo.ground import apply_homography, covariance, px_to_enu
from queuetail.tracking.scouting import GroundTracker
from queuetail.traffic.paths import Trajectory
from queuetail.types import Bools, Floats, GroundMapping, GroundPoints, Image, Ints, Tracks
from queuetail.vision.canvas import Canvas
from queuetail.vision.foot import camera_above_ground
from queuetail.vision.shade import CastShade

MIN_STEP_S = 0.115  # at most about 8 pictures a second
PAUSE_S = 3.0  # after so long without a picture nothing is followed on
MIN_BLOB_PX = 5
MIN_LENGTH_M, MAX_LENGTH_M = 1.5, 25.0
MIN_WIDTH_M, MAX_WIDTH_M = 0.8, 6.5
CAR_HEIGHT_M, TRUCK_HEIGHT_M = 1.5, 3.6
CAR_LENGTH_M, TRUCK_LENGTH_M = 6.5, 9.0  # up to, and from: in between the height grows
NARROWEST_M = 1.7  # of a footprint: the rest of a silhouette's width is lean or shadow
MAX_BLOBS = 400
MOSTLY, WIDEST_SEEN_M, DOUBTS = 0.6, 3.5, 200  # a car's silhouette with its lean is so wide
# What may be cast shadow counts for little beside other pixels of its blob, yet a car that is as
# dark all over keeps its shape.  Until the shadows' depth is known, all that is so dark may be one.
SHADE, SHADE_WEIGHT = (0.4, 0.95), 0.02


class RoadScout:
    """Follows whatever of a vehicle's size moves in the picture."""

    def __init__(self) -> None:
        self._canvas: Canvas | None = None
        self._shade = CastShade()
        self._doubts_m: deque[float] = deque(maxlen=DOUBTS)
        self._tracker = GroundTracker()
        self._mapping: GroundMapping | None = None  # of the last picture
        self._last_s = -np.inf

    def update(self, luma: Image, mapping: GroundMapping, H_ref_frame: Floats, t_s: float) -> None:
        """Take in a picture (h, w), its mapping, and its registration to the reference.

        Pictures that follow the last one too closely are passed over.
        """
        if t_s - self._last_s < MIN_STEP_S:
            return
        if t_s - self._last_s > PAUSE_S or (self._canvas and not self._canvas.fits(luma)):
            self._canvas = None
        if self._canvas is None:
            self._canvas = Canvas(luma, mapping, H_ref_frame)
        mask = self._canvas.foreground(luma, mapping, H_ref_frame)
        share = self._canvas.share
        dark = cv2.bitwise_and(mask, cv2.inRange(share, 0.0, SHADE[1]))
        shade = self._shade.mask(share, dark)
        if self._shade.depth is None:
            shade = cv2.bitwise_and(dark, cv2.inRange(share, *SHADE))
        points, shaded = locate_blobs(mask, shade, self._canvas, mapping)
        blurred = np.maximum(points.width_m - WIDEST_SEEN_M, 0.0) / 2
        self._doubts_m.extend(np.where(shaded > MOSTLY, blurred, 0.0).tolist())
        self._tracker.update(points, t_s)
        self._mapping, self._last_s = mapping, t_s

    @property
    def doubt_m(self) -> float:
        """How far aside vehicles may be where long shadows, seen coarsely, hide them."""
        return median(self._doubts_m) if self._doubts_m else 0.0

    @property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """Return where every vehicle went that moved far enough, gone or in view."""
        return self._tracker.trajectories

    def tracks(self, t_s: float) -> Tracks:
        """Return the vehicles followed now, moved on to `t_s`."""
        tracks = self._tracker.tracks(t_s)
        if self._mapping is None or not len(tracks):
            return tracks
        spread = covariance(self._mapping, tracks.px)
        sigma_m = np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2)
        return dataclasses.replace(tracks, sigma_m=sigma_m)


def locate_blobs(
    mask: Image, shade: Image, canvas: Canvas, mapping: GroundMapping
) -> tuple[GroundPoints, Floats]:
    """Place the vehicle-sized blobs of a canvas mask (h, w) on the ground; -> them, their shade.

    `shade` (h, w) is what may be cast shadow; the second value is its share of every blob, (n,).
    Blobs that the canvas' edge cuts are left out.
    """
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    found = cv2.findNonZero(mask)
    columns, rows = (np.zeros((0, 2), int) if found is None else found.reshape(-1, 2)).T
    label = labels[rows, columns]
    cut = np.zeros(count, np.bool_)
    cut[label[canvas.inside[rows, columns] == 0]] = True
    keep = (stats[:, cv2.CC_STAT_AREA] >= MIN_BLOB_PX) & ~cut
    keep[0] = False
    used = keep[label]
    label = label[used]
    canvas_px = np.column_stack([columns[used] + 0.5, rows[used] + 0.5])
    ground = px_to_enu(mapping, apply_homography(canvas.H_frame_canvas, canvas_px))
    shaded = shade[rows[used], columns[used]] > 0
    weight = np.where(shaded, SHADE_WEIGHT, 1.0)
    shapes = _shapes(ground, label, weight, count)
    keep &= _vehicle_sized(shapes.length_m, shapes.width_m)
    chosen = np.flatnonzero(keep)[:MAX_BLOBS]
    points = _ground_points(shapes.rows(chosen), stats[chosen], canvas.H_frame_canvas, mapping)
    share = np.bincount(label, shaded, count) / np.maximum(np.bincount(label, minlength=count), 1)
    return points, share[chosen]


@dataclass(frozen=True, slots=True)
class Shapes:
    """Silhouettes laid flat on the ground: their middles, long axes and extents."""

    centre: Floats  # (n, 2) ENU
    axis: Floats  # (n, 2) unit vectors along the longer side
    length_m: Floats  # (n,)
    width_m: Floats  # (n,)

    def rows(self, rows: Ints) -> Shapes:
        """Return the shapes of some rows."""
        return Shapes(self.centre[rows], self.axis[rows], self.length_m[rows], self.width_m[rows])


def _shapes(ground: Floats, label: Ints, weight: Floats, count: int) -> Shapes:
    """Return the shape of every blob's pixels on the ground, from their weighted moments."""
    total = np.bincount(label, weight, minlength=count)
    with np.errstate(invalid="ignore", divide="ignore"):
        centre = np.column_stack(
            [np.bincount(label, weight * ground[:, i], minlength=count) / total for i in (0, 1)]
        )
        gap = ground - centre[label]
        xx, yy, xy = (
            np.bincount(label, weight * gap[:, i] * gap[:, j], minlength=count) / total
            for i, j in ((0, 0), (1, 1), (0, 1))
        )
    mean, half = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    # A uniform rectangle's variance along a side is a twelfth of its square.
    length_m = np.sqrt(12 * np.maximum(mean + half, 0))
    width_m = np.sqrt(12 * np.maximum(mean - half, 0))
    angle = np.arctan2(2 * xy, xx - yy) / 2
    return Shapes(centre, np.column_stack([np.cos(angle), np.sin(angle)]), length_m, width_m)


def _vehicle_sized(length_m: Floats, width_m: Floats) -> Bools:
    with np.errstate(invalid="ignore"):
        long_enough = (length_m > MIN_LENGTH_M) & (length_m < MAX_LENGTH_M)
        return np.asarray(long_enough & (width_m > MIN_WIDTH_M) & (width_m < MAX_WIDTH_M))


def _ground_points(
    shapes: Shapes, stats: Ints, H_frame_canvas: Floats, mapping: GroundMapping
) -> GroundPoints:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    boxes = stats[:, None, :2] + corners * stats[:, None, 2:4]
    frame = apply_homography(H_frame_canvas, boxes.reshape(-1, 2)).reshape(-1, 4, 2)
    low, high = frame.min(axis=1), frame.max(axis=1)
    return GroundPoints(
        px=(low + high) / 2,
        boxes_px=np.concatenate([low, high - low], axis=1),
        enu=shapes.centre - lean_m(shapes, mapping),
        sigma_m=np.full(len(low), np.nan),  # only tracks need it
        length_m=shapes.length_m,
        width_m=shapes.width_m,
    )


def lean_m(shapes: Shapes, mapping: GroundMapping) -> Floats:
    """Return how far the middles of silhouettes lie beyond those of their footprints, (n, 2).

    What stands up hides the ground behind it: a point at height z appears z/(H − z) of its distance
    farther from the camera's foot, the roof's most, the wheels' not at all.
    """
    foot, above_m = camera_above_ground(mapping)
    height_m = np.interp(
        shapes.length_m, [CAR_LENGTH_M, TRUCK_LENGTH_M], [CAR_HEIGHT_M, TRUCK_HEIGHT_M]
    )
    if above_m <= 2 * TRUCK_HEIGHT_M:
        return np.zeros_like(shapes.centre)
    roof = (shapes.centre - foot) * (height_m / (above_m - height_m))[:, None]
    axis, aside = shapes.axis, shapes.axis[:, ::-1] * [-1.0, 1.0]
    # Two cars in a row are as long as a truck, but no wider than a car and its lean.
    widest = np.maximum(shapes.width_m - NARROWEST_M, 0.0)
    across = np.clip((roof * aside).sum(axis=1), -widest, widest)
    along = (roof * axis).sum(axis=1)
    return np.asarray(along[:, None] * axis + across[:, None] * aside) / 2
