"""What the API answers: plain numbers with units in their names, None where nothing is known."""

from __future__ import annotations

from datetime import datetime

from pydantic import BaseModel, Field

from queuetail.types import QueueStatus


class EndOfQueueRecord(BaseModel):
    """The rear bumper of the most upstream queued vehicle; a bound where it is beyond view."""

    station_m: float
    sigma_m: float = Field(description="one standard deviation of the station")
    lat_deg: float | None
    lon_deg: float | None
    u_px: float | None
    v_px: float | None
    length_m: float = Field(description="from here to the most downstream queued vehicle")
    vehicles: int
    growth_mps: float | None = Field(description="positive while the queue grows upstream")


class SignDistance(BaseModel):
    """One warning sign, seen from the end of the queue."""

    name: str
    station_m: float
    distance_m: float | None = Field(description="from the sign to the end of the queue")
    reached_in_s: float | None = Field(description="until the queue has grown to the sign")


class ApproachState(BaseModel):
    """The answer for one approach."""

    approach: str
    status: QueueStatus
    reasons: list[str]
    eoq: EndOfQueueRecord | None
    signs: list[SignDistance]
    taper_distance_m: float | None = Field(description="from the end of the queue to the taper")


class State(BaseModel):
    """The newest answer, for every approach."""

    number: int = Field(description="counts the answers of the run; 0 before the first")
    utc: datetime | None
    t_s: float | None = Field(description="seconds after the first picture")
    age_s: float | None = Field(description="since the answer was made; None for a finished run")
    live: bool
    approaches: list[ApproachState]


class Track(BaseModel):
    """One vehicle, in the newest picture."""

    track_id: int
    state: str
    approach: str
    lane: int | None
    lat_deg: float | None
    lon_deg: float | None
    station_m: float | None
    offset_m: float | None
    speed_mps: float | None
    length_m: float | None
    queued: bool
    u_px: float | None
    v_px: float | None
    box_px: list[float] | None = Field(description="x, y, width, height")


class Tracks(BaseModel):
    """All vehicles in the newest picture."""

    number: int
    utc: datetime | None
    t_s: float | None
    tracks: list[Track]


class HistoryRow(BaseModel):
    """One approach's answer at one time."""

    number: int
    utc: datetime
    t_s: float
    approach: str
    status: QueueStatus
    reasons: list[str]
    station_m: float | None
    sigma_m: float | None
    lat_deg: float | None
    lon_deg: float | None
    length_m: float | None
    growth_mps: float | None


class History(BaseModel):
    """Answers in order of time, thinned to `limit` rows per approach at most."""

    rows: list[HistoryRow]


class Outlet(BaseModel):
    """One file, feed, sign or store that answers are delivered to."""

    name: str
    state: str
    delivered: int
    dropped: int
    waiting: int
    last_error: str
    delivery_age_s: float | None


class HealthRecord(BaseModel):
    """How well the run is; None where there is nothing to measure."""

    ok: bool
    problems: list[str]
    live: bool
    video: str
    preset: str
    frame_age_s: float | None
    telemetry_age_s: dict[str, float]
    telemetry_rate_hz: dict[str, float]
    registration: float | None
    frames_captured: int
    frames_processed: int
    frames_dropped: int
    reconnects: int
    frame_rate_hz: float | None
    latency_p50_ms: float | None
    latency_p99_ms: float | None
    memory_mb: float | None
    disk_free_mb: float | None
    outlets: list[Outlet]
    warnings: list[str]


class Me(BaseModel):
    """Who asks."""

    role: str
