"""The map's content as GeoJSON, and the drone's own picture laid flat as its base."""

from __future__ import annotations

import asyncio
import json
import math
from dataclasses import dataclass
from functools import partial
from threading import Lock
from time import monotonic
from typing import Annotated, Any

import cv2
import numpy as np
from fastapi import FastAPI, Query, Response

from queuetail.console.answers import sign_station_m
from queuetail.console.source import ConsoleSource
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import enu_to_px, px_to_enu
from queuetail.live.records import Published
from queuetail.sinks.overlay import axis_stations, road_edges_m
from queuetail.traffic.road import place
from queuetail.types import Approach, Floats, GroundMapping, Origin

GEOJSON = "application/geo+json"
REACH_HEIGHTS = 5.0  # ground farther off than so many heights is a smear
LEAST_REACH_M = 200.0
RIM = 24  # samples down each side of the picture
BASE_PX = 900  # the longer side of the flat picture
GRID = 16  # pixels between the points that are projected exactly
PAST_S = 600.0  # of the queue's end, on the map
LONGEST_PX = 1280
FRESH_S = 1.5  # all viewers share a flat picture for so long
PAST_POINTS = 200


@dataclass(frozen=True, slots=True)
class Base:
    """The picture laid flat: north up, and where its corners lie."""

    webp: bytes
    south_west: tuple[float, float]  # latitude, longitude
    north_east: tuple[float, float]


def features(published: Published | None, source: ConsoleSource) -> dict[str, Any]:
    """Return drone, field of view, road, signs, and the end of the queue with its past."""
    found: list[dict[str, Any]] = []
    if published is not None:
        mapping = published.observation.mapping
        if isinstance(mapping, GroundMapping) and mapping.origin is not None:
            origin = mapping.origin
            found += _camera(published, mapping)
            for approach in published.observation.approaches:
                found += _road(approach, origin, source)
        found += _ends(published)
        found += _past(published, source)
    return {"type": "FeatureCollection", "features": found}


def _camera(published: Published, mapping: GroundMapping) -> list[dict[str, Any]]:
    found = []
    if mapping.pose is not None:
        pose = mapping.pose
        found.append(
            feature(
                "Point",
                [round(pose.lon_deg, 7), round(pose.lat_deg, 7)],
                kind="drone",
                heading_deg=round(pose.yaw_deg, 1),
                height_agl_m=round(pose.height_agl_m, 1),
            )
        )
    if published.frame is not None and mapping.origin is not None and is_placed(mapping):
        rim = seen_rim(mapping, published.frame.size)
        if len(rim) >= 3:
            ring = lon_lat(rim, mapping.origin)
            found.append(feature("Polygon", [[*ring, ring[0]]], kind="view"))
    return found


def _road(approach: Approach, origin: Origin, source: ConsoleSource) -> list[dict[str, Any]]:
    stations = axis_stations(approach, 10.0)
    found = []
    for i, offset_m in enumerate(road_edges_m(approach)):
        line = lon_lat(place(approach, stations, np.full(len(stations), offset_m)), origin)
        kind = "axis" if i == 0 else "edge"
        found.append(feature("LineString", line, kind=kind, approach=approach.name))
    for sign in source.about.site.sign:
        if sign.approach not in (None, approach.name):
            continue
        if sign.at is not None:
            where = [sign.at[1], sign.at[0]]
        else:
            station_m = sign_station_m(sign, approach, origin)
            assert station_m is not None  # a sign has either a place or a station
            beside = np.array([road_edges_m(approach)[-1] - 2.0])
            where = lon_lat(place(approach, np.array([station_m]), beside), origin)[0]
        found.append(feature("Point", where, kind="sign", name=sign.name))
    return found


def _ends(published: Published) -> list[dict[str, Any]]:
    found = []
    for state in published.observation.states:
        eoq = state.eoq
        if eoq is not None and eoq.lat_deg is not None and eoq.lon_deg is not None:
            found.append(
                feature(
                    "Point",
                    [round(eoq.lon_deg, 7), round(eoq.lat_deg, 7)],
                    kind="eoq",
                    approach=state.approach,
                    status=state.status.value,
                    station_m=round(eoq.station_m, 2),
                    sigma_m=round(eoq.sigma_m, 2),
                )
            )
    return found


def _past(published: Published, source: ConsoleSource) -> list[dict[str, Any]]:
    """Return where the end of the queue was in the last minutes."""
    now_s = published.observation.t_s
    past = source.past(max(now_s - PAST_S, 0.0), now_s)
    step = len(past) // PAST_POINTS + 1
    return [
        feature(
            "Point",
            [round(eoq.lon_deg, 7), round(eoq.lat_deg, 7)],
            kind="past",
            approach=p.state.approach,
            t_s=round(p.t_s, 2),
        )
        for p in past[::step]
        if (eoq := p.state.eoq) is not None and eoq.lat_deg is not None and eoq.lon_deg is not None
    ]


def seen_rim(mapping: GroundMapping, size: tuple[int, int]) -> Floats:
    """Return the rim of the ground that the picture shows near enough to be clear, ENU (n, 2)."""
    width, height = size
    rows = np.linspace(0.0, height, RIM)
    centre = px_to_enu(mapping, np.array([[width / 2, height]]))[0]
    height_m = mapping.pose.height_agl_m if mapping.pose is not None else 0.0
    reach_m = max(REACH_HEIGHTS * height_m, LEAST_REACH_M)
    sides = []
    for column in (0.0, width / 2, float(width)):
        enu = px_to_enu(mapping, np.column_stack([np.full(RIM, column), rows]))
        with np.errstate(invalid="ignore"):
            near = np.hypot(*(enu - centre).T) <= reach_m
        sides.append(enu[near & np.isfinite(enu).all(axis=1)])
    left, middle, right = sides
    if not len(left) or not len(right) or not len(middle):
        return np.empty((0, 2))
    return np.concatenate([left[::-1], middle[:1], right])


def is_placed(mapping: GroundMapping) -> bool:
    """Tell whether a mapping holds beside the road, too: one fitted to vehicles alone does not."""
    return mapping.pose is not None or mapping.intrinsics is not None


def flat_picture(published: Published) -> Base | None:
    """Return the picture as seen from straight above; None where its place is not known."""
    mapping, frame = published.observation.mapping, published.frame
    if frame is None or not isinstance(mapping, GroundMapping) or mapping.origin is None:
        return None
    if not is_placed(mapping):
        return None
    rim = seen_rim(mapping, frame.size)
    if len(rim) < 3:
        return None
    low, high = rim.min(axis=0), rim.max(axis=0)
    step_m = float((high - low).max()) / BASE_PX
    if not math.isfinite(step_m) or step_m <= 0:
        return None
    columns, rows = (max(math.ceil(v / step_m), 2) for v in (high - low).tolist())
    # A coarse grid is projected exactly, lens and all; between its points a straight line will do.
    across = np.linspace(low[0], high[0], columns // GRID + 2)
    down = np.linspace(high[1], low[1], rows // GRID + 2)
    grid = np.stack(np.meshgrid(across, down), axis=-1)
    px = enu_to_px(mapping, grid.reshape(-1, 2)).reshape(grid.shape)
    px = np.nan_to_num(px, nan=-1e4).clip(-1e4, 1e5).astype(np.float32)
    scale = min(LONGEST_PX / max(frame.size), 1.0)
    image = frame.bgr(*(max(round(v * scale), 1) for v in frame.size))
    where = cv2.resize(px * np.float32(scale), (columns, rows), interpolation=cv2.INTER_LINEAR)
    opaque = np.dstack([image, np.full(image.shape[:2], 255, np.uint8)])
    flat = cv2.remap(opaque, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    shape = np.zeros((rows, columns), np.uint8)
    corners = np.column_stack([rim[:, 0] - low[0], high[1] - rim[:, 1]]) / step_m
    cv2.fillPoly(shape, [np.round(corners).astype(np.int32)], 255)
    flat[..., 3] &= shape
    webp = cv2.imencode(".webp", flat, [cv2.IMWRITE_WEBP_QUALITY, 60])[1].tobytes()
    lat, lon = geodetic_from_enu(np.array([low, high]), mapping.origin)
    return Base(webp, (float(lat[0]), float(lon[0])), (float(lat[1]), float(lon[1])))


def lon_lat(enu: Floats, origin: Origin) -> list[list[float]]:
    """Return ground points as GeoJSON wants them: longitude first."""
    lat, lon = geodetic_from_enu(enu, origin)
    found: list[list[float]] = np.round(np.column_stack([lon, lat]), 7).tolist()
    return found


def feature(geometry: str, coordinates: Any, **properties: Any) -> dict[str, Any]:
    """Return one feature of GeoJSON (RFC 7946)."""
    return {
        "type": "Feature",
        "geometry": {"type": geometry, "coordinates": coordinates},
        "properties": properties,
    }


class SharedBase:
    """Lays a picture flat once for all viewers."""

    def __init__(self, source: ConsoleSource) -> None:
        self._source = source
        self._lock = Lock()
        self._made_s = -math.inf
        self._base: Base | None = None

    def newest(self) -> Base | None:
        """Return the newest picture laid flat, at most FRESH_S old."""
        with self._lock:
            if monotonic() - self._made_s > FRESH_S:
                published = self._source.newest()
                self._base = flat_picture(published) if published is not None else None
                self._made_s = monotonic()
            return self._base

    def at(self, t_s: float) -> Base | None:
        """Return a finished run's picture laid flat."""
        published = self._source.at(t_s)
        return flat_picture(published) if published is not None else None


Moment = Annotated[float | None, Query(ge=0, le=864_000, allow_inf_nan=False)]


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the map's routes."""

    @app.get(
        "/api/v1/map",
        tags=["places"],
        response_class=Response,
        responses={200: {"content": {GEOJSON: {}}, "description": "a FeatureCollection"}},
    )
    async def geojson(t_s: Moment = None) -> Response:
        """Return drone, field of view, road, signs and the end of the queue as GeoJSON."""

        def made() -> str:
            published = source.newest() if t_s is None else source.at(t_s)
            return json.dumps(features(published, source), allow_nan=False)

        return Response(await asyncio.to_thread(made), media_type=GEOJSON)

    shared = SharedBase(source)

    @app.get(
        "/api/v1/map/picture",
        tags=["places"],
        response_class=Response,
        responses={
            200: {"content": {"image/webp": {}}, "description": "north up; the header says where"},
            404: {"description": "the picture's place is not known now"},
        },
    )
    async def base(t_s: Moment = None) -> Response:
        """Return the picture as seen from above; X-Bounds has south, west, north, east."""

        found = await asyncio.to_thread(shared.newest if t_s is None else partial(shared.at, t_s))
        if found is None:
            return Response(status_code=404)
        bounds = ",".join(f"{v:.7f}" for v in (*found.south_west, *found.north_east))
        headers = {"X-Bounds": bounds, "Cache-Control": "no-store"}
        return Response(found.webp, media_type="image/webp", headers=headers)
