"""The end of the queue at one instant: who is queued, and where the last of them ends."""

from __future__ import annotations

import numpy as np

from queuetail.geo.ground import enu_to_px
from queuetail.geo.near_origin import fast_geodetic
from queuetail.traffic.road import is_on, place
from queuetail.types import (
    Approach,
    Bools,
    EndOfQueue,
    GroundMapping,
    RoadVehicles,
    TrackState,
)

MAX_REVERSE_SPEED_MPS = 1.0  # noise of a standing vehicle's speed; faster is the other way


def slow_vehicles(vehicles: RoadVehicles, index: int, queue_speed_mps: float) -> Bools:
    """Return which confirmed vehicles of an approach go its way slower than the queue speed."""
    confirmed = np.array([s is not TrackState.TENTATIVE for s in vehicles.tracks.states], np.bool_)
    speed = vehicles.speed_mps
    with np.errstate(invalid="ignore"):
        slow = (speed < queue_speed_mps) & (speed > -MAX_REVERSE_SPEED_MPS)
    return np.asarray(is_on(vehicles, index) & confirmed & slow, np.bool_)


def end_of_queue(
    vehicles: RoadVehicles,
    queued: Bools,
    approach: Approach,
    mapping: GroundMapping,
) -> EndOfQueue | None:
    """Return the rear of the most upstream queued vehicle, or None where none is queued.

    Its growth is left unknown: that takes more than an instant.
    """
    rows = np.flatnonzero(queued)
    if not len(rows):
        return None
    last = int(rows[np.argmin(vehicles.rear_station_m[rows])])
    station = float(vehicles.rear_station_m[last])
    fronts = vehicles.rear_station_m[rows] + vehicles.tracks.length_m[rows]
    enu = place(approach, np.array([station]), vehicles.offset_m[[last]])
    px = enu_to_px(mapping, enu)[0]
    lat: float | None = None
    lon: float | None = None
    if mapping.origin is not None:
        lat, lon = (float(v[0]) for v in fast_geodetic(enu, mapping.origin))
    return EndOfQueue(
        station_m=station,
        sigma_m=float(vehicles.tracks.sigma_m[last]),
        enu=(float(enu[0, 0]), float(enu[0, 1])),
        px=(float(px[0]), float(px[1])),
        lat_deg=lat,
        lon_deg=lon,
        track_id=int(vehicles.tracks.ids[last]),
        length_m=float(fronts.max() - station),
        vehicles=len(rows),
    )
