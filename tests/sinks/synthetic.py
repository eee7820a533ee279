"""Observations made by hand, so that sinks can be tested without a pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from queuetail.config import Site, SiteInfo
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import enu_to_px, mapping_from_pose
from queuetail.sinks import RunInfo
from queuetail.types import (
    Approach,
    CameraPose,
    EndOfQueue,
    Frame,
    GroundMapping,
    Observation,
    Origin,
    QueueState,
    QueueStatus,
    Registration,
    RoadVehicles,
    Tracks,
    TrackState,
    Unknown,
)

ORIGIN = Origin(36.11, -97.057)
EAST = Approach("EB", np.array([[-80.0, 20.0], [80.0, 20.0]]), 500.0, lanes=2)


def info(out: Path, size: tuple[int, int] = (320, 180), name: str = "a test") -> RunInfo:
    """Return a run's facts for a small video."""
    site = Site(site=SiteInfo(name=name, posted_speed_mph=55))
    return RunInfo(out, "flight.mp4", *size, 25.0, "road", site)


def frame(index: int, t_s: float, size: tuple[int, int] = (320, 180)) -> Frame:
    """Return a grey picture whose colour grows with its index."""
    width, height = size
    luma = np.full((height, width), 90 + index % 60, np.uint8)
    return Frame(index, t_s, luma, lambda w, h: np.full((h, w, 3), 90 + index % 60, np.uint8))


def mapping(size: tuple[int, int] = (320, 180)) -> GroundMapping:
    """Return the ground as a drone 100 m up sees it, looking north and 60° down."""
    lens = intrinsics_from_hfov(*size, 84.0)
    pose = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, 100.0, 0.0, -60.0, 0.0, lens)
    return mapping_from_pose(pose, ORIGIN)


def vehicles(
    stations_m: Sequence[float],
    speeds_mps: Sequence[float],
    ground: GroundMapping,
    states: Sequence[TrackState] | None = None,
) -> RoadVehicles:
    """Return vehicles in the right lane of EAST, 5 m long, heading east."""
    count = len(stations_m)
    station, speed = np.array(stations_m, float), np.array(speeds_mps, float)
    enu = np.column_stack([station - 580.0, np.full(count, 14.75)]).reshape(-1, 2)
    px = enu_to_px(ground, enu)
    tracks = Tracks(
        ids=np.arange(1, count + 1),
        states=tuple(states or [TrackState.CONFIRMED] * count),
        px=px,
        boxes_px=np.column_stack([px - 3, np.full((count, 2), 6.0)]).reshape(-1, 4),
        enu=enu,
        velocity_mps=np.column_stack([speed, np.zeros(count)]).reshape(-1, 2),
        sigma_m=np.full(count, 0.5),
        length_m=np.full(count, 5.0),
    )
    return RoadVehicles(
        tracks,
        approach=np.zeros(count, np.int64),
        lane=np.full(count, 2),
        station_m=station,
        offset_m=np.full(count, -5.25),
        speed_mps=speed,
        rear_station_m=station - 2.5,
        queued=speed < 5,
    )


def eoq(station_m: float, ground: GroundMapping, length_m: float = 40.0) -> EndOfQueue:
    """Return the end of a queue on EAST."""
    point = np.array([[station_m - 580.0, 14.75]])
    px = enu_to_px(ground, point)[0]
    lat = lon = None
    if ground.origin is not None:
        lats, lons = geodetic_from_enu(point, ground.origin)
        lat, lon = float(lats[0]), float(lons[0])
    place = (float(point[0, 0]), float(point[0, 1]))
    at_px = (float(px[0]), float(px[1]))
    return EndOfQueue(station_m, 1.5, place, at_px, lat, lon, 1, length_m, 3, 0.4)


def observation(
    index: int,
    t_s: float,
    states: Sequence[QueueState] = (),
    seen: RoadVehicles | None = None,
    ground: GroundMapping | Unknown | None = None,
    *,
    approaches: tuple[Approach, ...] = (EAST,),
) -> Observation:
    """Return what one frame told, with empty parts unless given."""
    ground = ground or mapping()
    base = mapping() if isinstance(ground, Unknown) else ground
    return Observation(
        frame_index=index,
        t_s=t_s,
        mapping=ground,
        registration=Registration(np.eye(3), 1.0),
        detections_px=np.array([[10.0, 10.0, 8.0, 5.0]]),
        approaches=approaches,
        vehicles=seen if seen is not None else vehicles([], [], base),
        states=tuple(states),
    )


def short_run(frames: int = 60, step_s: float = 0.5) -> list[tuple[Frame, Observation]]:
    """Return a run in which a queue forms, grows, is lost from view, and dissolves."""
    ground = mapping()
    run = []
    for i in range(frames):
        t_s, part = i * step_s, i / frames
        if part < 0.2 or part >= 0.9:
            state = QueueState("EB", QueueStatus.CLEAR)
        elif 0.5 <= part < 0.6:
            state = QueueState("EB", QueueStatus.UNKNOWN, None, ("registration lost",))
        else:
            end = eoq(600.0 - 100 * (part - 0.2), ground, 20 + 100 * (part - 0.2))
            far = 0.7 <= part < 0.8
            state = QueueState("EB", QueueStatus.BEYOND_VIEW if far else QueueStatus.QUEUED, end)
        seen = vehicles([520 + 60 * part, 610, 625], [20 - 15 * part, 1, 0], ground)
        run.append((frame(i, t_s), observation(i, t_s, [state], seen)))
    return run
