"""The set-up's routes: what is known of the road, a draft as a site file, and its use."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
from fastapi import FastAPI
from pydantic import BaseModel, Field

from queuetail.config import DEFAULT_QUEUE_SPEED_MPH, MPS_PER_MPH, Site
from queuetail.console.answers import origin_of
from queuetail.console.setup_files import Saving, Used, checked, folder_of, use
from queuetail.console.setup_moments import moments_of
from queuetail.console.source import ConsoleSource
from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.geo.ground import enu_to_px
from queuetail.site_editor import whole_text
from queuetail.types import Approach, Floats, GroundMapping, Origin

STEP_M = 5.0
MOST_STEPS = 2000
STRAIGHT_POINTS = 4  # of an axis, whose course its end goes on in
FARTHEST_M = 400.0
Latitude = Annotated[float, Field(ge=-90, le=90, allow_inf_nan=False)]
Longitude = Annotated[float, Field(ge=-180, le=180, allow_inf_nan=False)]
Place = tuple[Latitude, Longitude]
Mph = Annotated[float, Field(ge=1, le=120, allow_inf_nan=False)]
Name = Annotated[str, Field(min_length=1, max_length=60)]


class RoadDraft(BaseModel):
    """One approach: its axis is the left edge of the left lane, in the direction of travel."""

    name: Name
    lanes: Annotated[int, Field(ge=1, le=12)] = 1
    lane_width_m: Annotated[float, Field(gt=1.5, lt=10, allow_inf_nan=False)] = 3.6
    start_station_m: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] = 0.0
    axis: Annotated[list[Place], Field(min_length=2, max_length=500)]


class SignDraft(BaseModel):
    """One warning sign."""

    name: Name
    at: Place | None = None
    approach: Name | None = None


class Draft(BaseModel):
    """What the set-up asks for; everything else of the settings stays as it is."""

    name: Annotated[str, Field(max_length=100)] = "unnamed site"
    posted_speed_mph: Mph | None = None
    queue_speed_mph: Mph | None = None
    roads: Annotated[list[RoadDraft], Field(max_length=12)] = []
    signs: Annotated[list[SignDraft], Field(max_length=40)] = []


class SavedDraft(Saving):
    """A draft that is put to use."""

    draft: Draft


class KnownRoad(RoadDraft):
    """An approach that the run uses now."""

    length_m: float
    is_found: bool = Field(description="from the traffic, not from a site file")


class Known(BaseModel):
    """What the run uses now, to begin a draft from."""

    draft: Draft
    roads: list[KnownRoad]
    preset: str
    file: str | None
    folder: str
    files: list[str] = Field(description="site files that are there already")
    is_live: bool
    telemetry: dict[str, str] = Field(description="what the newest picture was placed with")


class Lines(BaseModel):
    """Places that are to be drawn in a held picture."""

    number: Annotated[int, Field(ge=0, le=10**9)]
    lines: Annotated[list[Annotated[list[Place], Field(max_length=500)]], Field(max_length=12)] = []
    points: Annotated[list[Place], Field(max_length=40)] = []


class Pixels(BaseModel):
    """The same in pixels: of each line the parts in view, of each point None where it is not."""

    lines: list[list[list[list[float]]]]
    points: list[list[float] | None]


class Preview(BaseModel):
    """A draft as a site file."""

    toml: str
    queue_speed_mph: float


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the set-up's routes."""
    moments = moments_of(app)

    @app.get("/api/v1/setup", tags=["setup"])
    def now() -> Known:
        """Return what the run uses now."""
        about = source.about
        site, folder = about.site, folder_of(source)
        roads = known_roads(source)
        return Known(
            draft=Draft(
                name=site.site.name[:100],
                posted_speed_mph=_at_least_1(site.site.posted_speed_mph),
                queue_speed_mph=_at_least_1(site.queue.speed_mph),
                roads=[RoadDraft.model_validate(r.model_dump()) for r in roads if not r.is_found],
                signs=[SignDraft(name=s.name, at=s.at, approach=s.approach) for s in site.sign],
            ),
            roads=roads,
            preset=about.preset,
            file=about.site_file.name if about.site_file else None,
            folder=str(folder),
            files=sorted(p.name for p in folder.glob("*.toml"))[:200] if folder.is_dir() else [],
            is_live=about.is_live,
            telemetry=told(source),
        )

    @app.post("/api/v1/setup/preview", tags=["setup"])
    def preview(draft: Draft) -> Preview:
        """Return a draft as a site file; nothing is kept."""
        site = checked(merged(source.about.site, draft))
        speed = site.queue_speed_mps / MPS_PER_MPH or DEFAULT_QUEUE_SPEED_MPH
        return Preview(toml=whole_text(site), queue_speed_mph=round(speed, 2))

    @app.post("/api/v1/setup/pixels", tags=["setup"])
    def pixels(wanted: Lines) -> Pixels:
        """Return where places lie in a held picture; nothing is kept."""
        held = moments.get(wanted.number)
        mapping = held.placed
        if mapping is None:
            return Pixels(lines=[[] for _ in wanted.lines], points=[None for _ in wanted.points])
        return Pixels(
            lines=[in_view(line_px(line, mapping), held.size) for line in wanted.lines],
            points=[
                row if 0 <= row[0] <= held.size[0] and 0 <= row[1] <= held.size[1] else None
                for row in line_px(wanted.points, mapping, fine=False)
            ],
        )

    @app.post("/api/v1/setup/save", tags=["setup"])
    def save(saved: SavedDraft) -> Used:
        """Put a draft to use and keep it; for operators."""
        site = checked(merged(source.about.site, saved.draft))
        used = use(source, site, whole_text(site), saved)
        moments.forget()
        return used


def merged(site: Site, draft: Draft) -> dict[str, Any]:
    """Return the settings with a draft's name, speeds, roads and signs."""
    raw = site.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    given: dict[str, dict[str, Any]] = {
        "site": {"name": draft.name, "posted_speed_mph": draft.posted_speed_mph},
        "queue": {"speed_mph": draft.queue_speed_mph},
    }
    for table, values in given.items():
        whole = {**raw.get(table, {}), **values}
        raw[table] = {k: v for k, v in whole.items() if v is not None}
    if draft.roads:
        old = {entry["name"]: entry for entry in raw.get("approach", [])}
        raw["approach"] = [road_entry(r, old.get(r.name, {})) for r in draft.roads]
    before = {s.name: s for s in site.sign}
    raw["sign"] = [sign_entry(s, before, draft) for s in draft.signs]
    return {k: v for k, v in raw.items() if v}


def road_entry(road: RoadDraft, old: dict[str, Any]) -> dict[str, Any]:
    """Return an `[[approach]]` with what the settings said of it before, in degrees.

    A point that was clicked twice counts once.
    """
    old = {k: v for k, v in old.items() if k != "axis_enu_m"}
    axis = [road.axis[0], *(b for a, b in zip(road.axis, road.axis[1:], strict=False) if a != b)]
    return {**old, **road.model_dump(), "axis": [list(p) for p in axis]}


def sign_entry(sign: SignDraft, before: dict[str, Any], draft: Draft) -> dict[str, Any]:
    """Return a `[[sign]]`, with what the settings said of it before."""
    old = before.get(sign.name)
    raw: dict[str, Any] = (
        old.model_dump(mode="json", exclude_defaults=True, exclude_none=True) if old else {}
    )
    raw["name"] = sign.name
    if sign.at is not None:
        raw["at"] = list(sign.at)
        raw.pop("station_m", None)
    if sign.approach is not None:
        raw["approach"] = sign.approach
    elif len(draft.roads) <= 1:
        raw.pop("approach", None)
    return raw


def _at_least_1(mph: float | None) -> float | None:
    return None if mph is None else max(mph, 1.0)


def told(source: ConsoleSource) -> dict[str, str]:
    """Return telemetry's newest quantities in words; those it does not tell are left out."""
    published = source.newest()
    sample = published.telemetry if published is not None else None
    if sample is None:
        return {}
    found = {}
    if sample.lat_deg is not None and sample.lon_deg is not None:
        found["position"] = f"{sample.lat_deg:.6f}, {sample.lon_deg:.6f}"
    for name, value, unit in (
        ("height", sample.height_agl_m, " m"),
        ("heading", sample.heading_deg, "°"),
        ("gimbal_pitch", sample.gimbal_pitch_deg, "°"),
        ("gimbal_roll", sample.gimbal_roll_deg, "°"),
        ("hfov", sample.hfov_deg, "°"),
    ):
        if value is not None:
            found[name] = f"{round(value, 1) + 0.0:.1f}{unit}"
    return found


def known_roads(source: ConsoleSource) -> list[KnownRoad]:
    """Return the approaches that the newest answer refers to, in degrees."""
    published = source.newest()
    if published is None:
        return []
    origin = origin_of(published.observation)
    if origin is None:
        return []
    given = {a.name for a in source.about.site.approach}
    mapping, frame = published.observation.mapping, published.frame
    found = []
    for approach in published.observation.approaches:
        is_found = approach.name not in given
        whole = approach
        if is_found and frame is not None and isinstance(mapping, GroundMapping):
            whole = through_view(approach, mapping, frame.size)
        found.append(known_road(whole, origin, is_found))
    return found


def through_view(approach: Approach, mapping: GroundMapping, size: tuple[int, int]) -> Approach:
    """Return a found road gone straight on to the picture's edges.

    Traffic shows it piece by piece, and a queue is not looked for beyond its ends.
    """
    axis = approach.axis_enu
    before = beyond(axis[::-1], mapping, size)[::-1]
    after = beyond(axis, mapping, size)
    begun_m = float(np.hypot(*(axis[0] - before[0]))) if len(before) else 0.0
    return replace(
        approach,
        axis_enu=np.concatenate([before, axis, after]),
        start_station_m=approach.start_station_m - begun_m,
    )


def beyond(axis: Floats, mapping: GroundMapping, size: tuple[int, int]) -> Floats:
    """Return the point at which a line, gone straight on, leaves the picture: (1, 2) or (0, 2)."""
    back = axis[max(len(axis) - 1 - STRAIGHT_POINTS, 0)]
    way = axis[-1] - back
    length = float(np.hypot(*way))
    if length < STEP_M:
        return np.empty((0, 2))
    points = axis[-1] + way / length * np.arange(STEP_M, FARTHEST_M, STEP_M)[:, None]
    px = enu_to_px(mapping, points)
    with np.errstate(invalid="ignore"):
        inside = ((px >= 0) & (px <= np.array(size))).all(axis=1)
    count = int(np.argmin(inside)) if not inside.all() else len(points)
    return points[count - 1 : count] if count else np.empty((0, 2))


def known_road(approach: Approach, origin: Origin, is_found: bool) -> KnownRoad:
    """Return an approach in degrees."""
    lat, lon = geodetic_from_enu(approach.axis_enu, origin)
    axis = [(round(float(a), 8), round(float(b), 8)) for a, b in zip(lat, lon, strict=True)]
    steps = np.diff(enu_from_geodetic(lat, lon, origin), axis=0)
    return KnownRoad(
        name=approach.name or "road",
        lanes=approach.lanes,
        lane_width_m=round(min(max(approach.lane_width_m, 1.6), 9.9), 2),
        start_station_m=round(approach.start_station_m, 2),
        axis=axis,
        length_m=round(float(np.hypot(*steps.T).sum()), 1),
        is_found=is_found,
    )


def line_px(places: list[Place], mapping: GroundMapping, *, fine: bool = True) -> list[list[float]]:
    """Return places in pixels, NaN behind the camera; `fine` adds points every few metres."""
    assert mapping.origin is not None
    if not places:
        return []
    lat, lon = np.array(places, float).T
    enu = enu_from_geodetic(lat, lon, mapping.origin)
    if fine:
        lengths = np.append(0.0, np.cumsum(np.hypot(*np.diff(enu, axis=0).T)))
        count = int(min(max(lengths[-1] / STEP_M, 1.0), MOST_STEPS)) + 1
        at = np.linspace(0.0, lengths[-1], count)
        enu = np.column_stack([np.interp(at, lengths, enu[:, k]) for k in (0, 1)])
    return enu_to_px(mapping, enu).round(1).tolist()


def in_view(line: list[list[float]], size: tuple[int, int]) -> list[list[list[float]]]:
    """Return the parts of a line that lie in the picture."""
    parts: list[list[list[float]]] = [[]]
    for u, v in line:
        if 0 <= u <= size[0] and 0 <= v <= size[1]:
            parts[-1].append([u, v])
        elif parts[-1]:
            parts.append([])
    return [part for part in parts if len(part) > 1]
