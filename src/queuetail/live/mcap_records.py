"""The messages of a recording, made from what a live run publishes, and read back exactly.

Numbers are written in full, so that a replay can be compared digit by digit.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any

from queuetail import __version__
from queuetail.config import Site
from queuetail.live.records import Health, Published
from queuetail.sinks.events import Event, Memory, event_line, next_events
from queuetail.sinks.words import known_states, status_words
from queuetail.types import Observation, QueueState, TelemetrySample, Unknown

FORMAT = 1  # of the messages; a reader refuses a later one
TIME_SHIFT_S = 10.0  # added to the video's times: containers cannot hold those before zero
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
DIAGONAL_KNOWN = 2
INFO, WARNING = 2, 3
HEALTH_EVERY_S = 1.0

Record = dict[str, Any]


@dataclass(frozen=True, slots=True)
class RunAbout:
    """What a run was started with; `source` must hold no password."""

    preset: str
    site: Site
    source: str
    started_utc: datetime

    def record(self) -> Record:
        """Return the message on ``/run``."""
        return {
            "format": FORMAT,
            "queuetail_version": __version__,
            "preset": self.preset,
            "site": self.site.model_dump(mode="json"),
            "source": self.source,
            "started_utc": self.started_utc.isoformat(),
            "time_shift_s": TIME_SHIFT_S,
        }


@dataclass(frozen=True, slots=True)
class Message:
    """One message of a recording, with the time that it belongs to."""

    topic: str
    time_ns: int
    record: Record

    def data(self) -> bytes:
        """Return it as JSON."""
        return json.dumps(self.record, ensure_ascii=False, allow_nan=False).encode()


class AnswerMessages:
    """Turns answers into messages; remembers what events and the health's pace need."""

    def __init__(self) -> None:
        self._memories: dict[str, Memory] = {}
        self._health_at: datetime | None = None

    def of(self, published: Published) -> Iterator[Message]:
        """Yield the messages of one answer, the frame's first."""
        time_ns = nanoseconds(published.utc)
        observation = published.observation
        if published.frame is not None:
            yield Message("/frame", time_ns, frame_record(published))
            yield from _camera(published, time_ns)
        yield Message("/answer", time_ns, answer_record(published))
        for state in known_states(observation, tuple(self._memories)):
            yield from _place(state, time_ns)
            memory = self._memories.get(state.approach, Memory())
            self._memories[state.approach], events = next_events(memory, state)
            for event in events:
                line = json.loads(event_line(observation.t_s, event, state))
                yield Message("/event", time_ns, line)
                yield Message("/log", time_ns, _log(time_ns, event, state))
        last = self._health_at
        if last is None or abs((published.utc - last).total_seconds()) >= HEALTH_EVERY_S:
            self._health_at = published.utc
            yield Message("/health", time_ns, health_record(published.health))


def frame_record(published: Published) -> Record:
    """Return the message on ``/frame``: all that a replay needs beside the picture."""
    frame, observation = published.frame, published.observation
    assert frame is not None
    mapping, registration = observation.mapping, observation.registration
    origin = None if isinstance(mapping, Unknown) else mapping.origin
    told = published.telemetry
    return {
        "number": published.number,
        "session": published.session,
        "pts_s": published.pts_s,
        "index": frame.index,
        "t_s": frame.t_s,
        "utc": published.utc.isoformat(),
        "size_px": list(frame.size),
        "origin": [origin.lat_deg, origin.lon_deg] if origin else None,
        "registration": {
            "quality": float(registration.quality),
            "reason": registration.reason,
            "epoch": registration.epoch,
        },
        "telemetry": sample_record(told) if told is not None else None,
        "telemetry_t_s": told.t_s if told is not None else None,
    }


def answer_record(published: Published) -> Record:
    """Return the message on ``/answer``."""
    return {
        "number": published.number,
        "t_s": published.observation.t_s,
        "utc": published.utc.isoformat(),
        "of_frame": published.frame is not None,
        "doubts": list(published.doubts),
        "states": state_records(published.observation),
    }


def state_records(observation: Observation) -> list[Record]:
    """Return an observation's states; equal answers give equal records."""
    return [_state(state) for state in observation.states]


def telemetry_message(sample: TelemetrySample, utc: datetime, source: str) -> Message:
    """Return the message on ``/telemetry`` of a sample as it arrived."""
    record = {
        "utc": utc.isoformat(),
        "t_s": sample.t_s,
        "source": source,
        "sample": sample_record(sample),
    }
    return Message("/telemetry", nanoseconds(utc), record)


def sample_record(sample: TelemetrySample) -> Record:
    """Return a sample's quantities without its time."""
    record = dataclasses.asdict(sample)
    del record["t_s"]
    return {name: finite(value) for name, value in record.items()}


def health_record(health: Health) -> Record:
    """Return the message on ``/health``."""
    record: Record = _finite_all(dataclasses.asdict(health))
    return record


def nanoseconds(utc: datetime) -> int:
    """Return a moment as MCAP counts time: whole nanoseconds since 1970."""
    return (utc - EPOCH) // timedelta(microseconds=1) * 1000


def finite(value: float | None) -> float | None:
    """Return a number that JSON can hold, or ``None``."""
    if value is None or not math.isfinite(value):
        return None
    return float(value)


def _finite_all(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _finite_all(v) for name, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite_all(v) for v in value]
    return finite(value) if isinstance(value, float) else value


def _state(state: QueueState) -> Record:
    eoq = state.eoq
    return {
        "approach": state.approach,
        "status": state.status.value,
        "reasons": list(state.reasons),
        "eoq": None
        if eoq is None
        else {
            "station_m": finite(eoq.station_m),
            "sigma_m": finite(eoq.sigma_m),
            "enu_m": [finite(v) for v in eoq.enu],
            "px": [finite(v) for v in eoq.px],
            "lat_deg": finite(eoq.lat_deg),
            "lon_deg": finite(eoq.lon_deg),
            "track_id": int(eoq.track_id),
            "length_m": finite(eoq.length_m),
            "vehicles": int(eoq.vehicles),
            "growth_mps": finite(eoq.growth_mps),
        },
    }


def _camera(published: Published, time_ns: int) -> Iterator[Message]:
    told = published.telemetry
    if told is None:
        return
    lat, lon, height = finite(told.lat_deg), finite(told.lon_deg), finite(told.height_agl_m)
    if lat is not None and lon is not None:
        fix = _fix(time_ns, "camera", lat, lon, height or 0.0, [0.0] * 9, 0)
        yield Message("/camera", time_ns, fix)


def _place(state: QueueState, time_ns: int) -> Iterator[Message]:
    """Yield the end of the queue as a map panel takes it."""
    if state.eoq is None:
        return
    lat, lon = finite(state.eoq.lat_deg), finite(state.eoq.lon_deg)
    variance = (finite(state.eoq.sigma_m) or 0.0) ** 2
    covariance = [variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0]
    if lat is not None and lon is not None:
        fix = _fix(time_ns, state.approach, lat, lon, 0.0, covariance, DIAGONAL_KNOWN)
        yield Message(f"/eoq/{state.approach}", time_ns, fix)


def _fix(
    time_ns: int,
    frame_id: str,
    lat: float,
    lon: float,
    height_m: float,
    covariance: list[float],
    kind: int,
) -> Record:
    return {
        "timestamp": _stamp(time_ns),
        "frame_id": frame_id,
        "latitude": lat,
        "longitude": lon,
        "altitude": height_m,
        "position_covariance": covariance,
        "position_covariance_type": kind,
    }


def _log(time_ns: int, event: Event, state: QueueState) -> Record:
    name = f"{state.approach}: " if state.approach else ""
    return {
        "timestamp": _stamp(time_ns),
        "level": WARNING if event is Event.VIEW_LOST else INFO,
        "message": f"{name}{event.value.replace('_', ' ')}: {status_words(state)}",
        "name": "queuetail",
        "file": "",
        "line": 0,
    }


def _stamp(time_ns: int) -> Record:
    return {"sec": time_ns // 1_000_000_000, "nsec": time_ns % 1_000_000_000}
