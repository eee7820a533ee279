"""The accuracy check's routes: errors at known points, offsets that mend them, speeds."""

from __future__ import annotations

from threading import Lock
from typing import Annotated

import numpy as np
from fastapi import FastAPI, HTTPException, Query
from pydantic import BaseModel, Field

from queuetail.accuracy.improve import Improvement, improve
from queuetail.accuracy.points import Errors, KnownPoint, measure
from queuetail.accuracy.speed import check_speed
from queuetail.check import with_offsets
from queuetail.config import MPS_PER_MPH
from queuetail.console.answers import known
from queuetail.console.setup_files import Saving, Used, checked, use
from queuetail.console.setup_moments import Moments, moments_of, number_rows
from queuetail.console.source import ConsoleSource
from queuetail.geo.ground import mapping_from_pose
from queuetail.site_editor import whole_text, with_table
from queuetail.types import GroundMapping

Points = Annotated[
    str,
    Query(max_length=20_000, description="number of a held picture,u,v,latitude,longitude;…"),
]


class PointError(BaseModel):
    """One point: where it truly is, where it is measured, and how far that is off."""

    lat_deg: float
    lon_deg: float
    measured_lat_deg: float | None
    measured_lon_deg: float | None
    error_m: float | None = Field(description="haversine; None at and above the horizon")
    beyond_m: float | None = Field(description="of the error: away from the drone")
    right_m: float | None


class ErrorTable(BaseModel):
    """The errors of all points."""

    points: list[PointError]
    mean_m: float | None
    worst_m: float | None


class OffsetRecord(BaseModel):
    """What is to be added to one quantity."""

    value: float
    sigma: float | None
    is_determined: bool


class ImprovementRecord(BaseModel):
    """Offsets of telemetry, and the errors by telemetry alone before and after."""

    heading_deg: OffsetRecord
    pitch_deg: OffsetRecord
    height_m: OffsetRecord
    before: ErrorTable
    after: ErrorTable
    held_out_m: float | None = Field(description="mean of each point by the others' offsets")
    misfits: list[int] = Field(description="points that do not fit the others, counted from 0")
    helps: bool
    telemetry: dict[str, float] = Field(description="the keys of [telemetry] that would change")


class Applying(Saving):
    """Points whose offsets are applied."""

    points: str = Field(max_length=20_000)


class SpeedRecord(BaseModel):
    """One vehicle's measured speed against its true one."""

    track_id: int
    samples: int
    duration_s: float
    measured_mph: float
    spread_mph: float
    true_mph: float
    factor: float = Field(description="what measured speeds would be multiplied by")


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the check's routes."""
    _add_points(app, source)
    _add_speed(app, source)


def _add_points(app: FastAPI, source: ConsoleSource) -> None:
    moments = moments_of(app)
    solving = Lock()  # it takes a core for a second, which the run needs more

    def improvement(points: str) -> Improvement:
        pairs = [(p, _by_telemetry(m)) for p, m in _known(points, moments)]
        with solving:
            try:
                return improve([p for p, _ in pairs], [m for _, m in pairs])
            except ValueError as error:
                raise HTTPException(422, str(error)) from None

    @app.get("/api/v1/check", tags=["check"])
    def check(points: Points) -> ErrorTable:
        """Return how far off some points are placed."""
        pairs = _known(points, moments)
        return error_table(measure([p for p, _ in pairs], [m for _, m in pairs]))

    @app.get("/api/v1/check/improvement", tags=["check"])
    def improved(points: Points) -> ImprovementRecord:
        """Return the offsets that put the points right; nothing is changed."""
        return improvement_record(improvement(points), source)

    @app.post("/api/v1/check/apply", tags=["check"])
    def apply(applying: Applying) -> Used:
        """Let the run go on with the points' offsets; for operators."""
        found = improvement(applying.points)
        if not found.helps:
            raise HTTPException(422, "the offsets do not make the points better")
        keys = with_offsets(source.about.site.telemetry, found)
        raw = source.about.site.model_dump(mode="json", exclude_unset=True)
        raw["telemetry"] = {**raw.get("telemetry", {}), **keys}
        given = source.about.site_file
        own = given is not None and applying.file == given.name and given.is_file()
        text = given.read_text(encoding="utf-8-sig") if own and given is not None else ""
        site = checked(raw)
        text = with_table(text, "telemetry", keys) if own else whole_text(site)
        used = use(source, site, text, applying)
        moments.forget()  # their poses were those before
        return used


def _add_speed(app: FastAPI, source: ConsoleSource) -> None:
    @app.get("/api/v1/check/speed", tags=["check"])
    def speed(
        track_id: Annotated[int, Query(ge=0, le=10**9)],
        true_mph: Annotated[float, Query(gt=0, lt=200, allow_inf_nan=False)],
        since_s: Annotated[float, Query(ge=0, le=864_000, allow_inf_nan=False)] = 0.0,
        until_s: Annotated[float, Query(ge=0, le=864_000, allow_inf_nan=False)] = 864_000.0,
    ) -> SpeedRecord:
        """Compare a vehicle's measured speed with the one it was driven at."""
        samples = [
            (p.t_s, float(p.speed_mps[i]))
            for p in source.paths(since_s, until_s)
            for i in np.flatnonzero(p.ids == track_id)
        ]
        t_s, speeds = np.array(samples, float).reshape(-1, 2).T
        try:
            found = check_speed(track_id, t_s, speeds, true_mph * MPS_PER_MPH)
        except ValueError as error:
            raise HTTPException(422, str(error)) from None
        return SpeedRecord(
            track_id=track_id,
            samples=found.samples,
            duration_s=round(found.duration_s, 2),
            measured_mph=round(found.measured_mps / MPS_PER_MPH, 2),
            spread_mph=round(found.spread_mps / MPS_PER_MPH, 2),
            true_mph=true_mph,
            factor=round(found.factor, 4),
        )


def error_table(errors: Errors) -> ErrorTable:
    """Return errors for JSON."""
    return ErrorTable(
        points=[
            PointError(
                lat_deg=p.point.lat_deg,
                lon_deg=p.point.lon_deg,
                measured_lat_deg=known(p.lat_deg, 8),
                measured_lon_deg=known(p.lon_deg, 8),
                error_m=known(p.error_m, 4),
                beyond_m=known(p.along_m, 4),
                right_m=known(p.across_m, 4),
            )
            for p in errors.placed
        ],
        mean_m=known(errors.mean_m, 4),
        worst_m=known(errors.worst_m, 4),
    )


def improvement_record(found: Improvement, source: ConsoleSource) -> ImprovementRecord:
    """Return an improvement for JSON."""
    heading, pitch, height = (
        OffsetRecord(
            value=round(o.value, 4), sigma=known(o.sigma, 4), is_determined=o.is_determined
        )
        for o in found.offsets
    )
    return ImprovementRecord(
        heading_deg=heading,
        pitch_deg=pitch,
        height_m=height,
        before=error_table(found.before),
        after=error_table(found.after),
        held_out_m=known(found.held_out_m, 4),
        misfits=list(found.misfits),
        helps=found.helps,
        telemetry=with_offsets(source.about.site.telemetry, found),
    )


def _known(text: str, moments: Moments) -> list[tuple[KnownPoint, GroundMapping]]:
    """Return the points of a query with the mapping of each one's picture."""
    found = []
    for number, u, v, lat, lon in number_rows(text, 5):
        if not -90 <= lat <= 90 or not -180 <= lon <= 180:
            raise HTTPException(422, f"{lat:g}, {lon:g} is no latitude and longitude")
        held = moments.get(int(min(max(number, 0), 1e9)))
        if not (0 <= u <= held.size[0] and 0 <= v <= held.size[1]):
            raise HTTPException(422, f"the pixel {u:g}, {v:g} lies outside the picture")
        if held.placed is None:
            raise HTTPException(422, "the place of the picture is not known")
        found.append((KnownPoint(held.t_s, (u, v), lat, lon), held.placed))
    return found


def _by_telemetry(mapping: GroundMapping) -> GroundMapping:
    """Return where telemetry alone puts the picture: the road's alignment hides its faults."""
    if mapping.pose is None or mapping.origin is None:
        return mapping
    return mapping_from_pose(mapping.pose, mapping.origin)
