"""Answers of a live run without a run: a camera above a straight road, cars, and a queue."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np

from queuetail.config import Site, parse_settings
from queuetail.console.live_source import LiveSource
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import enu_to_px, mapping_from_pose
from queuetail.live.blind import blind_observation
from queuetail.live.records import Health, OutletHealth, OutletState, Published
from queuetail.traffic.road import assign, place
from queuetail.types import (
    Approach,
    CameraPose,
    EndOfQueue,
    Frame,
    Image,
    Observation,
    Origin,
    QueueState,
    QueueStatus,
    Registration,
    Tracks,
    TrackState,
)

SIZE = (640, 360)
ORIGIN = Origin(36.11, -97.057)
START_UTC = datetime(2026, 5, 14, 15, 30, tzinfo=UTC)
ROAD = Approach("NB", np.array([[-200.0, 60.0], [200.0, 60.0]]), 1000.0, lanes=2, lane_width_m=3.6)
POSE = CameraPose(36.11, -97.057, 60.0, 0.0, -45.0, 0.0, intrinsics_from_hfov(*SIZE, 84.0))
MAPPING = mapping_from_pose(POSE, ORIGIN)
SITE = parse_settings(
    Site,
    {
        "site": {"name": "A <b>site</b>", "posted_speed_mph": 65},
        "approach": [
            {
                "name": "NB",
                "lanes": 2,
                "axis_enu_m": ROAD.axis_enu.tolist(),
                "start_station_m": 1000.0,
                "taper_station_m": 1300.0,
            }
        ],
        "sign": [{"name": "PCMS 1", "station_m": 700.0}],
    }
    | {"site": {"name": "A <b>site</b>", "posted_speed_mph": 65, "origin": [36.11, -97.057]}},
    "test",
)
HEALTH = Health(
    frame_age_s=0.05,
    telemetry_age_s={"position": 0.1},
    telemetry_rate_hz={"position": 10.0},
    registration=0.9,
    frames_captured=900,
    frames_processed=450,
    outlets=(OutletHealth("queue.csv", OutletState.OK, delivered=450),),
)


def picture(width_px: int, height_px: int) -> Image:
    """Return grey noise."""
    return np.random.default_rng(0).integers(80, 160, (height_px, width_px, 3)).astype(np.uint8)


def answer(number: int, eoq_m: float | None = 1190.0, growth_mps: float = 1.0) -> Published:
    """Return an answer with two standing cars and one that comes."""
    stations = np.array([1195.0, 1210.0, 1150.0])
    enu = place(ROAD, stations, np.array([-1.8, -1.8, -5.4]))
    px = enu_to_px(MAPPING, enu)
    tracks = Tracks(
        ids=np.array([1, 2, 3]),
        states=(TrackState.CONFIRMED, TrackState.COASTING, TrackState.CONFIRMED),
        px=px,
        boxes_px=np.column_stack([px - 8, np.full((3, 2), 16.0)]),
        enu=enu,
        velocity_mps=np.array([[0.0, 0.0], [0.0, 0.0], [20.0, 0.0]]),
        sigma_m=np.ones(3),
        length_m=np.full(3, 5.0),
    )
    vehicles = assign(tracks, (ROAD,))
    state = QueueState("NB", QueueStatus.CLEAR)
    if eoq_m is not None:
        state = QueueState("NB", QueueStatus.QUEUED, end_of_queue(eoq_m, growth_mps))
        vehicles.queued[:2] = True
    t_s = number / 10
    observation = Observation(
        frame_index=number,
        t_s=t_s,
        mapping=MAPPING,
        registration=Registration(np.eye(3), 0.9),
        detections_px=np.empty((0, 4)),
        approaches=(ROAD,),
        vehicles=vehicles,
        states=(state,),
    )
    frame = Frame(number, t_s, np.zeros(SIZE[::-1], np.uint8), picture)
    utc = START_UTC + timedelta(seconds=t_s)
    return Published(number, utc, frame, observation, HEALTH)


def end_of_queue(station_m: float, growth_mps: float) -> EndOfQueue:
    """Return an end of queue in lane 1."""
    enu = place(ROAD, np.array([station_m]), np.array([-1.8]))
    lat, lon = geodetic_from_enu(enu, ORIGIN)
    px = enu_to_px(MAPPING, enu)[0]
    return EndOfQueue(
        station_m=station_m,
        sigma_m=0.6,
        enu=(float(enu[0, 0]), float(enu[0, 1])),
        px=(float(px[0]), float(px[1])),
        lat_deg=float(lat[0]),
        lon_deg=float(lon[0]),
        track_id=1,
        length_m=20.0,
        vehicles=2,
        growth_mps=growth_mps,
    )


def lost(number: int) -> Published:
    """Return an answer while no picture comes."""
    observation = blind_observation(
        (ROAD,), ("NB",), number / 10, "no picture for 1.2 s: it is off"
    )
    return Published(number, START_UTC, None, observation, HEALTH)


def live_source() -> LiveSource:
    """Return a live run's source that has no answer yet."""
    return LiveSource(lambda: HEALTH, "udp://0.0.0.0:5600", "road", SITE, None)
