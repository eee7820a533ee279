"""What a live run publishes: the answer, the frame it came from, and how well the run is."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import datetime
from enum import StrEnum

from queuetail.types import Frame, Observation, TelemetrySample


class OutletState(StrEnum):
    """How delivery to one outlet (a feed, a sign, a recording, a store) stands."""

    OFF = "off"
    OK = "ok"
    RETRYING = "retrying"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class OutletHealth:
    """One outlet: what it delivered, what it had to drop, and what went wrong last."""

    name: str
    state: OutletState
    delivered: int = 0
    dropped: int = 0
    waiting: int = 0
    last_error: str = ""
    delivery_age_s: float | None = None  # since the last delivery


@dataclass(frozen=True, slots=True)
class Health:
    """How well a live run is; ``None`` where there is nothing to measure yet."""

    frame_age_s: float | None = None  # since the newest frame was taken, as arrivals tell
    telemetry_age_s: dict[str, float] = field(default_factory=dict)  # of each quantity
    telemetry_rate_hz: dict[str, float] = field(default_factory=dict)
    registration: float | None = None  # quality, 0 … 1
    frames_captured: int = 0
    frames_processed: int = 0
    frames_dropped: int = 0
    reconnects: int = 0
    frame_rate_hz: float | None = None  # of processed frames
    latency_p50_ms: float | None = None  # from a frame's arrival to its published answer
    latency_p99_ms: float | None = None
    memory_mb: float | None = None
    disk_free_mb: float | None = None
    outlets: tuple[OutletHealth, ...] = ()
    warnings: tuple[str, ...] = ()  # one sentence each


@dataclass(frozen=True, slots=True)
class Published:
    """One answer of a live run: what every console page, feed, sign and recording gets.

    While the stream is lost, ``frame`` is ``None`` and every state of the observation is
    ``unknown`` with the reason.
    """

    number: int  # counts the answers of this run
    utc: datetime  # when the frame was captured (when the answer was made, without a frame)
    frame: Frame | None
    observation: Observation
    health: Health
    telemetry: TelemetrySample | None = None  # what the pipeline was given with the frame
    session: int = 0  # counts the video connections of this run
    pts_s: float | None = None  # the frame's own time in its session's stream
    captured_s: float | None = None  # when the frame was taken, on the clock of telemetry's samples
    doubts: tuple[str, ...] = ()  # why the run did not believe the pipeline's states, if it did not
