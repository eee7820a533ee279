"""Every record that crosses a stage of the pipeline: frozen, slotted, units in the names.

Coordinates used throughout:

* ``px``  pixels of the input video as a viewer sees it (u to the right, v down, (0, 0) is the outer
  corner of the top-left pixel, so that scaling a picture scales its coordinates);
* ``enu`` metres east and north of a local origin on the ground plane;
* ``station, offset`` metres along an approach's axis in the direction of travel, and to its left.

Sets of things (detections, tracks, vehicles) are records of parallel arrays, one row per thing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Picture = NDArray[np.float32]  # of brightness, or what was made of it
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Frame:
    """One decoded picture; ``t_s`` is its capture time in seconds after the first frame."""

    index: int
    t_s: float
    luma: Image  # (height, width), the decoder's own plane: read, never write
    bgr: Callable[[int, int], Image]  # (width, height) -> (height, width, 3), converted on demand
    chroma: tuple[Image, ...] = ()  # its two colour planes, mostly of half the size; () for none

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.luma.shape[1], self.luma.shape[0]


@dataclass(frozen=True, slots=True)
class TelemetrySample:
    """What the drone said at one time; ``None`` where it said nothing of that quantity then."""

    t_s: float
    lat_deg: float | None = None
    lon_deg: float | None = None
    height_agl_m: float | None = None
    heading_deg: float | None = None  # of the camera, clockwise from true north
    gimbal_pitch_deg: float | None = None  # -90 is straight down
    gimbal_roll_deg: float | None = None
    hfov_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Intrinsics:
    """A pinhole lens; ``distortion`` is Brown–Conrady (k1, k2, p1, p2, k3), empty for none."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraPose:
    """Where the camera is and how it looks; angles as in :class:`TelemetrySample`."""

    lat_deg: float
    lon_deg: float
    height_agl_m: float
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    intrinsics: Intrinsics


@dataclass(frozen=True, slots=True)
class PoseSigma:
    """One standard deviation of each part of a pose, for plain consumer-drone telemetry."""

    horizontal_m: float = 1.5
    height_m: float = 1.0
    yaw_deg: float = 1.0
    pitch_deg: float = 0.5
    roll_deg: float = 0.3
    pixel_px: float = 1.5


@dataclass(frozen=True, slots=True)
class Registration:
    """The measured image motion: ``H_ref_frame`` maps this frame's pixels to the reference's."""

    H_ref_frame: Floats
    quality: float  # 0 (lost) … 1 (every feature agrees)
    reason: str = ""  # why it is lost; empty when it is not
    epoch: int = 0  # counts the reference frames: one chain of anchors each


@dataclass(frozen=True, slots=True)
class Origin:
    """The geodetic place of ENU (0, 0)."""

    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, slots=True)
class GroundMapping:
    """Pixels to ground metres and back, by plane homographies between *undistorted* pixels and ENU.

    ``origin`` is ``None`` where only local metres are known (control points without lat/lon).
    ``pose`` is ``None`` where control points gave the mapping; ``sigma_m`` is then their residual.
    """

    H_enu_px: Floats
    H_px_enu: Floats
    origin: Origin | None
    intrinsics: Intrinsics | None = None  # the lens, where its distortion or centre is known
    pose: CameraPose | None = None
    pose_sigma: PoseSigma = field(default_factory=PoseSigma)
    sigma_m: float = 0.0
    H_true_enu: Floats = field(default_factory=lambda: np.eye(3))  # by which telemetry's were moved


@dataclass(frozen=True, slots=True)
class Unknown:
    """A value that is not known now, and why."""

    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Approach:
    """One carriageway in one direction: its axis is the left edge of the left lane, in ENU.

    Lane 1 is the left-most and covers offsets 0 … −lane_width_m; lane 2 the next, and so on.
    Each is only equal to itself, so that what follows from an axis can be kept by it.
    """

    name: str
    axis_enu: Floats  # (k, 2), k >= 2, in the direction of travel
    start_station_m: float = 0.0
    lanes: int = 1
    lane_width_m: float = 3.5


@dataclass(frozen=True, slots=True)
class Raster:
    """The picture that a preset works on: the whole frame scaled, or the road rectified."""

    image: Image
    H_px_raster: Floats  # maps raster pixels to input-video pixels


@dataclass(frozen=True, slots=True)
class Band:
    """Where one approach lies in a road-view raster, and how the camera sees it."""

    approach_index: int
    rows: tuple[int, int]  # first, and one after the last
    columns: int
    first_column: int  # column 0, counted from the axis' start: tells how a new plan is shifted
    visible_columns: tuple[int, int]  # of those that the picture shows at all lanes
    lane_rows: tuple[float, ...]  # middle of each lane, left-most first, within the band
    lane_width_px: float
    lean_px: Floats  # (blocks, 2) shift (column, row) of a point one metre above the road


@dataclass(frozen=True, slots=True)
class RoadRaster:
    """Every approach rectified into a band of one raster; columns run along the station."""

    image: Image
    px_per_m: float
    bands: tuple[Band, ...]
    plan: int  # counts the layouts: while it stays, every pixel stays on its place of the road
    approaches: tuple[Approach, ...] = ()
    spans: dict[int, tuple[float, float]] = field(default_factory=dict)  # visible stations, metres
    t_s: float = 0.0  # of the frame that it shows
    colour: Image | None = None  # (2, rows / 2, columns / 2), rounded up: its chroma
    H_true_enu: Floats = field(default_factory=lambda: np.eye(3))  # its mapping's


MOVED, MAYBE = 255, 128  # in a mask of known vehicles: has it moved, as only vehicles do?


@dataclass(frozen=True, slots=True)
class Masks:
    """What is not road (255), which of it is no shadow for certain, and which is cast shadow."""

    foreign: Image
    bright: Image  # brighter than road, or of another colour
    shade: Image
    contrast: NDArray[np.float32]  # how far from road, as a share of its brightness


@dataclass(frozen=True, slots=True)
class LaneDetections:
    """What stands in the lanes of a road view, in raster columns and rows."""

    band: Ints  # (n,) index into the raster's bands
    lane: Ints  # (n,) 1 is the left-most
    rear_column: Floats  # (n,)
    front_column: Floats  # (n,)
    row: Floats  # (n,) of its middle
    cut_rear: Bools  # (n,) it reaches out of the picture upstream
    cut_front: Bools  # (n,)
    contrast: Floats  # (n,) mean difference from road, as a share of its brightness
    body: Floats  # (n,) share of its columns that show more than cast shadow
    shadow: Bools  # (n,) it is only the shadow of what is beside it
    roof: Bools  # (n,) it is only what shows beyond a tall vehicle: its ends are rough
    astride: Bools  # (n,) it lies on the edge between its lane and the next to the right
    bodies: tuple[Floats, ...] = ()  # of each (k, 2): rears and fronts of what is no cast shadow
    speed_mps: tuple[Floats, ...] = ()  # of each band (lanes, columns): the picture's, NaN unknown
    hidden: tuple[Bools, ...] = ()  # of each band (lanes, columns): behind a tall vehicle

    def __len__(self) -> int:
        return len(self.band)


@dataclass(frozen=True, slots=True)
class LaneSight:
    """What one lane shows at stations `start_m + i * step_m`, beside its intervals."""

    start_m: float
    step_m: float
    speed_mps: Floats  # (n,) how fast the picture moves along the lane, NaN where nothing tells
    hidden: Bools  # (n,) a tall vehicle stands before it


@dataclass(frozen=True, slots=True)
class RoadPoints:
    """Lane detections in road metres; `spans` are the stations seen of each approach."""

    approach: Ints  # (n,)
    lane: Ints  # (n,)
    rear_m: Floats  # (n,) stations
    front_m: Floats  # (n,)
    offset_m: Floats  # (n,)
    cut_rear: Bools  # (n,)
    cut_front: Bools  # (n,)
    contrast: Floats  # (n,) share of the road's brightness
    body: Floats  # (n,) share of its length that shows more than cast shadow
    shadow: Bools  # (n,) it is only the shadow of what is beside it
    roof: Bools  # (n,) it is only what shows beyond a tall vehicle: its ends are rough
    astride: Bools  # (n,) it lies on the edge between its lane and the next to the right
    spans: dict[int, tuple[float, float]]
    boxes_px: Floats  # (n, 4) in input-video pixels
    sights: dict[tuple[int, int], LaneSight] = field(default_factory=dict)  # (approach, lane)
    bodies: tuple[Floats, ...] = ()  # of each (k, 2): stations of what is no cast shadow

    def __len__(self) -> int:
        return len(self.approach)


@dataclass(frozen=True, slots=True)
class Detections:
    """Blobs in raster pixels: boxes as (x, y, width, height) and the foreground area of each."""

    boxes: Floats  # (n, 4)
    areas: Floats  # (n,)

    def __len__(self) -> int:
        return len(self.boxes)


@dataclass(frozen=True, slots=True)
class GroundPoints:
    """Detections located: input-video pixels and ground metres of each, with its ground extent."""

    px: Floats  # (n, 2)
    boxes_px: Floats  # (n, 4) x, y, width, height in input-video pixels
    enu: Floats  # (n, 2)
    sigma_m: Floats  # (n,) one standard deviation of the position
    length_m: Floats  # (n,)
    width_m: Floats  # (n,)

    def __len__(self) -> int:
        return len(self.px)


@dataclass(frozen=True, slots=True)
class Scene:
    """When and in what the detections of one frame were seen."""

    t_s: float
    raster: Raster | RoadRaster
    mapping: GroundMapping


class TrackState(StrEnum):
    """How far a track is to be believed."""

    TENTATIVE = "tentative"
    CONFIRMED = "confirmed"
    COASTING = "coasting"


@dataclass(frozen=True, slots=True)
class Tracks:
    """Vehicles followed over time: position, velocity and extent on the ground."""

    ids: Ints  # (n,)
    states: tuple[TrackState, ...]
    px: Floats  # (n, 2) input-video pixels
    boxes_px: Floats  # (n, 4) x, y, width, height in input-video pixels
    enu: Floats  # (n, 2)
    velocity_mps: Floats  # (n, 2) east, north
    sigma_m: Floats  # (n,)
    length_m: Floats  # (n,)

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True, slots=True)
class RoadVehicles:
    """Tracks on the road: approach (index, -1 for none), lane (1 is the left-most, 0 for none)."""

    tracks: Tracks
    approach: Ints  # (n,)
    lane: Ints  # (n,)
    station_m: Floats  # (n,) of the track's position
    offset_m: Floats  # (n,)
    speed_mps: Floats  # (n,) along the approach, negative when it goes the other way
    rear_station_m: Floats  # (n,) of the rear bumper
    queued: Bools  # (n,)

    def __len__(self) -> int:
        return len(self.approach)


class QueueStatus(StrEnum):
    """The four answers; ``unknown`` is never confused with ``clear``."""

    CLEAR = "clear"
    QUEUED = "queued"
    BEYOND_VIEW = "beyond_view"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class EndOfQueue:
    """The rear bumper, on the road surface, of the most upstream queued vehicle."""

    station_m: float
    sigma_m: float  # of the station
    enu: tuple[float, float]
    px: tuple[float, float]
    lat_deg: float | None
    lon_deg: float | None
    track_id: int
    length_m: float  # from the end of the queue to its most downstream vehicle
    vehicles: int
    growth_mps: float | None = None  # positive while the queue grows upstream; None until known


@dataclass(frozen=True, slots=True)
class QueueState:
    """The answer for one approach at one time; ``eoq`` only when queued or beyond view."""

    approach: str
    status: QueueStatus
    eoq: EndOfQueue | None = None
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Observation:
    """All that one frame told us."""

    frame_index: int
    t_s: float
    mapping: GroundMapping | Unknown
    registration: Registration
    detections_px: Floats  # (n, 4) boxes of the candidates in input-video pixels
    approaches: tuple[Approach, ...]  # what RoadVehicles.approach and the states refer to
    vehicles: RoadVehicles
    states: tuple[QueueState, ...]
