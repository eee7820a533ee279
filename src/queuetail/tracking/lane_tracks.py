"""Vehicles of lanes as tracks: places on the ground and in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from queuetail.geo.ground import enu_to_px, px_to_enu
from queuetail.tracking.lane_belief import surely_drives
from queuetail.tracking.lane_vehicle import LaneVehicle
from queuetail.traffic.road import assign, place
from queuetail.types import (
    Approach,
    Floats,
    GroundMapping,
    RoadRaster,
    Scene,
    Tracks,
    TrackState,
)

CAR_M, CAR_HALF_WIDTH_M, TRUCK_HALF_WIDTH_M = 6.5, 0.95, 1.25


def tracks_of(
    vehicles: Sequence[LaneVehicle], approaches: Sequence[Approach], scene: Scene
) -> Tracks:
    """Return the vehicles of the approaches as they are at the scene's time."""
    rows = [v for v in vehicles if v.approach < len(approaches)]
    n = len(rows)
    enu, course = np.empty((n, 2)), np.empty((n, 2))
    corners = np.empty((n, 4, 2))
    for index, approach in enumerate(approaches):
        at = [i for i, v in enumerate(rows) if v.approach == index]
        if not at:
            continue
        rear = np.array([rows[i].rear_m for i in at])
        length = np.array([rows[i].length_m for i in at])
        offset = np.array([rows[i].offset_m for i in at])
        enu[at], course[at], corners[at] = _on_ground(approach, rear, length, offset)
    px = enu_to_px(scene.mapping, enu)
    corners_px = enu_to_px(scene.mapping, corners.reshape(-1, 2)).reshape(n, 4, 2)
    low, high = corners_px.min(axis=1), corners_px.max(axis=1)
    speed = np.array([v.speed_mps for v in rows])
    return Tracks(
        ids=np.array([v.track_id for v in rows], np.int64),
        states=tuple(_state(v, scene) for v in rows),
        px=px,
        boxes_px=np.concatenate([low, high - low], axis=1),
        enu=enu,
        velocity_mps=course * speed[:, None],
        sigma_m=np.sqrt(np.array([v.var_station for v in rows])),
        length_m=np.array([v.length_m for v in rows]),
    )


def carried_over(
    vehicles: Sequence[LaneVehicle],
    tracks: Tracks,
    approaches: Sequence[Approach],
    mapping: GroundMapping,
) -> list[LaneVehicle]:
    """Return the vehicles that are on the road as it is laid out anew, placed on it.

    `tracks` are the same vehicles as they were last; in the picture they are where they were.
    """
    row_of = {track_id: row for row, track_id in enumerate(tracks.ids.tolist())}
    there = assign(replace(tracks, enu=px_to_enu(mapping, tracks.px)), approaches)
    kept = []
    for vehicle in vehicles:
        row = row_of.get(vehicle.track_id)
        if row is None or there.approach[row] < 0:
            continue
        rear_m = float(there.station_m[row]) - vehicle.length_m / 2
        vehicle.move(rear_m - vehicle.rear_m)
        vehicle.approach, vehicle.lane = int(there.approach[row]), int(there.lane[row])
        vehicle.offset_m = float(there.offset_m[row])
        kept.append(vehicle)
    return kept


def _state(vehicle: LaneVehicle, scene: Scene) -> TrackState:
    """Return how sure a vehicle is.

    Of what has never moved where the picture begins, its rear outside, nobody can say: road that
    the sun lights begins there too.
    """
    assert isinstance(scene.raster, RoadRaster)
    begin_m = scene.raster.spans.get(vehicle.approach, (-np.inf, np.inf))[0]
    inside = vehicle.moved or vehicle.in_row or vehicle.rear_m > begin_m or surely_drives(vehicle)
    if not (vehicle.shown and inside):
        return TrackState.TENTATIVE
    return TrackState.CONFIRMED if vehicle.seen_s == scene.t_s else TrackState.COASTING


def _on_ground(
    approach: Approach, rear: Floats, length: Floats, offset: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return centres (n, 2), courses (n, 2) and footprint corners (n, 4, 2) in ENU."""
    half_width = np.where(length > CAR_M, TRUCK_HALF_WIDTH_M, CAR_HALF_WIDTH_M)
    at = np.concatenate([rear + length / 2, rear, rear + length])
    points = place(approach, at, np.tile(offset, 3)).reshape(3, -1, 2)
    ahead = points[2] - points[1]
    course = ahead / np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
    left = np.column_stack([-course[:, 1], course[:, 0]]) * half_width[:, None]
    corners = np.stack(
        [points[1] - left, points[1] + left, points[2] + left, points[2] - left], axis=1
    )
    return points[0], course, corners
