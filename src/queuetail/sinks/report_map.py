"""What the report's map shows: the kept frame laid on the ground, the road, the ends of queues."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import enu_to_px, px_to_enu
from queuetail.sinks.folder import QueueTable
from queuetail.traffic.road import place
from queuetail.types import Approach, Floats, Frame, GroundMapping, Image, Observation, Origin

MAX_SIDE_PX = 1100
MIN_GSD_M = 0.1
MAX_ENDS = 400  # places of one approach's end of queue; more would only lie on each other
FAR_M = 400.0  # ground farther than this from what lies nearest the drone is not shown
NEAR_DRONE_M = 200.0  # a drone farther than this from the road is left off the map


@dataclass(frozen=True, slots=True)
class Still:
    """The one frame that the report shows, with what was found in it."""

    frame: Frame
    observation: Observation


@dataclass(frozen=True, slots=True)
class MapScene:
    """Everything on the map, in metres east and north of `origin`."""

    extent: tuple[float, float, float, float]  # west, east, south, north
    origin: Origin | None
    axes: tuple[tuple[str, Floats], ...]
    ends: tuple[tuple[str, Floats], ...]
    drone: Floats | None
    base: Image | None  # BGR, its first row in the north


def map_scene(
    run: dict[str, Any], tables: tuple[QueueTable, ...], still: Still | None
) -> MapScene | None:
    """Return what there is to show, or ``None`` where neither road nor end of queue is known."""
    mapping = still.observation.mapping if still else None
    if not isinstance(mapping, GroundMapping):
        mapping, still = None, None
    records = [r for r in run.get("approaches") or () if isinstance(r, dict)]
    origin = mapping.origin if mapping else _first_place(records, tables)
    approaches = tuple(a for a in (_approach(r, origin) for r in records) if a)
    if not approaches and still:
        approaches = still.observation.approaches
    ends = tuple((t.approach, e) for t in tables if len(e := _ends(t, approaches, origin)))
    seen = _footprint(mapping, still) if mapping and still else np.empty((0, 2))
    shown = [e for _, e in ends]
    if len(seen) or not shown:
        shown += [_in_picture(a.axis_enu, mapping, still) for a in approaches]
    points = np.concatenate([*shown, np.empty((0, 2))])
    if not len(points):
        points = seen
    if not len(points):
        return None
    drone = _drone(mapping, origin)
    if drone is not None and np.linalg.norm(points - drone, axis=1).min() < NEAR_DRONE_M:
        points = np.vstack([points, drone])
    else:
        drone = None
    extent = _extent(points, seen)
    base = _ground_picture(still, mapping, extent) if still and mapping else None
    axes = tuple((a.name, a.axis_enu) for a in approaches)
    return MapScene(extent, origin, axes, ends, drone, base)


def _drone(mapping: GroundMapping | None, origin: Origin | None) -> Floats | None:
    """Return the place on the ground below the drone, (2,), where the pose is known."""
    if mapping is None or mapping.pose is None or origin is None:
        return None
    return enu_from_geodetic(np.array(mapping.pose.lat_deg), np.array(mapping.pose.lon_deg), origin)


def _first_place(records: list[dict[str, Any]], tables: tuple[QueueTable, ...]) -> Origin | None:
    for record in records:
        if record.get("axis_lat_lon"):
            return Origin(*map(float, record["axis_lat_lon"][0]))
    for table in tables:
        known = np.flatnonzero(np.isfinite(table.lat) & np.isfinite(table.lon))
        if len(known):
            return Origin(float(table.lat[known[0]]), float(table.lon[known[0]]))
    return None


def _approach(record: dict[str, Any], origin: Origin | None) -> Approach | None:
    """Return run.json's approach in metres of `origin`."""
    places, enu = record.get("axis_lat_lon"), record.get("axis_enu_m")
    if places and origin:
        lat, lon = np.array(places, float).T
        axis = enu_from_geodetic(lat, lon, origin)
    elif enu and not places:
        axis = np.array(enu, float)
    else:
        return None
    return Approach(str(record.get("name", "")), axis, float(record.get("start_station_m", 0.0)))


def _ends(table: QueueTable, approaches: tuple[Approach, ...], origin: Origin | None) -> Floats:
    known = np.flatnonzero(np.isfinite(table.station_m))
    known = known[:: max(len(known) // MAX_ENDS, 1)]
    located = np.isfinite(table.lat[known]) & np.isfinite(table.lon[known])
    if origin and located.any():
        chosen = known[located]
        return enu_from_geodetic(table.lat[chosen], table.lon[chosen], origin)
    mine = [a for a in approaches if a.name == table.approach]
    if not mine or not len(known):
        return np.empty((0, 2))
    return place(mine[0], table.station_m[known], np.zeros(len(known)))


def _footprint(mapping: GroundMapping, still: Still) -> Floats:
    """Return ground points under the picture, near enough to mean something, (n, 2)."""
    width, height = still.frame.size
    u, v = np.meshgrid(np.linspace(0, width, 17), np.linspace(0, height, 17))
    ground = px_to_enu(mapping, np.column_stack([u.ravel(), v.ravel()]))
    ground = ground[np.isfinite(ground).all(axis=1)]
    if not len(ground):
        return ground
    near = px_to_enu(mapping, np.array([[width / 2, height * 0.98]]))[0]
    return np.asarray(ground[np.linalg.norm(ground - near, axis=1) < FAR_M])


def _in_picture(axis: Floats, mapping: GroundMapping | None, still: Still | None) -> Floats:
    """Return points of the axis that the picture shows; all its own where there is no picture."""
    if mapping is None or still is None:
        return axis
    steps = np.linspace(0, 1, 20)[:, None, None]
    dense = (axis[:-1] * (1 - steps) + axis[1:] * steps).reshape(-1, 2)
    px = enu_to_px(mapping, dense)
    return np.asarray(dense[((px >= 0) & (px <= still.frame.size)).all(axis=1)])


def _extent(points: Floats, seen: Floats) -> tuple[float, float, float, float]:
    """Return the box around the points with a margin, no thinner than a third of its length."""
    low, high = points.min(axis=0), points.max(axis=0)
    margin = max(0.06 * float((high - low).max()), 12.0)
    low, high = low - margin, high + margin
    if len(seen):
        low, high = np.maximum(low, seen.min(axis=0)), np.minimum(high, seen.max(axis=0))
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    size = np.maximum(high - low, max(float((high - low).max()) / 3, 20.0))
    middle = (low + high) / 2
    low, high = middle - size / 2, middle + size / 2
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _ground_picture(
    still: Still, mapping: GroundMapping, extent: tuple[float, float, float, float]
) -> Image:
    """Lay the frame on the ground: every pixel of the map looks up its place in the picture."""
    west, east, south, north = extent
    gsd_m = max((east - west) / MAX_SIDE_PX, (north - south) / MAX_SIDE_PX, MIN_GSD_M)
    columns, rows = max(round((east - west) / gsd_m), 2), max(round((north - south) / gsd_m), 2)
    x = np.linspace(west, east, columns, endpoint=False) + (east - west) / columns / 2
    y = np.linspace(north, south, rows, endpoint=False) - (north - south) / rows / 2
    ground = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    size = still.frame.size
    px = np.nan_to_num(enu_to_px(mapping, ground), nan=-1e4).clip(-1e4, 1e5) - 0.5
    lookup = px.reshape(rows, columns, 2).astype(np.float32)
    picture = still.frame.bgr(*size)
    return np.asarray(
        cv2.remap(picture, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR,
                  borderMode=cv2.BORDER_CONSTANT, borderValue=(236, 241, 243)),
        np.uint8,
    )  # fmt: skip
