"""What the store keeps: flights, answers thinned to one a second, events."""

from __future__ import annotations

import math
import uuid
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime

from queuetail.sinks.events import Event, Memory, next_events
from queuetail.sinks.words import known_states
from queuetail.types import Observation, QueueState

HISTORY_EVERY_S = 1.0  # and at once when the status changes


@dataclass(frozen=True, slots=True)
class Flight:
    """One live run, or one imported run of a recorded flight."""

    id: str
    site: str
    source: str  # never with a password
    preset: str
    version: str
    started_utc: datetime
    last_utc: datetime | None = None  # of its newest answer
    is_finished: bool = False  # False while it goes on, and after a kill
    answers: int = 0  # of its history: at most one a second and approach, and the changes
    events: int = 0


@dataclass(frozen=True, slots=True)
class HistoryPoint:
    """The answer for one approach at one time."""

    flight: str
    utc: datetime
    t_s: float
    approach: str
    status: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    station_m: float | None = None
    sigma_m: float | None = None
    length_m: float | None = None
    vehicles: int | None = None
    growth_mps: float | None = None
    reasons: str = ""


@dataclass(frozen=True, slots=True)
class StoredEvent:
    """What changed, and the answer as it then was."""

    flight: str
    utc: datetime
    t_s: float
    approach: str
    event: str
    status: str
    lat_deg: float | None = None
    lon_deg: float | None = None
    station_m: float | None = None
    sigma_m: float | None = None
    length_m: float | None = None
    vehicles: int | None = None
    growth_mps: float | None = None
    reasons: str = ""


@dataclass(frozen=True, slots=True)
class Batch:
    """What one answer adds to the store."""

    history: tuple[HistoryPoint, ...] = ()
    events: tuple[StoredEvent, ...] = ()


def new_flight_id(started_utc: datetime) -> str:
    """Return a name for a flight that sorts by its start and that no other flight has."""
    return f"{started_utc:%Y%m%dT%H%M%SZ}-{uuid.uuid4().hex[:6]}"


@dataclass(slots=True)
class Thinner:
    """Chooses which answers of a flight the history keeps, and notices the events."""

    flight: str
    _kept: dict[str, tuple[datetime, str]] = field(default_factory=dict)
    _memories: dict[str, Memory] = field(default_factory=dict)

    def batch(self, observation: Observation, utc: datetime) -> Batch:
        """Return what an answer adds; often nothing."""
        history, events = [], []
        for state in known_states(observation, tuple(self._memories)):
            events += list(self._events(observation.t_s, utc, state))
            kept = self._kept.get(state.approach)
            if (
                kept is None
                or kept[1] != state.status.value
                or abs((utc - kept[0]).total_seconds()) >= HISTORY_EVERY_S
            ):
                self._kept[state.approach] = utc, state.status.value
                history.append(self._point(observation.t_s, utc, state))
        return Batch(tuple(history), tuple(events))

    def _events(self, t_s: float, utc: datetime, state: QueueState) -> Iterator[StoredEvent]:
        memory = self._memories.get(state.approach, Memory())
        self._memories[state.approach], happened = next_events(memory, state)
        for event in happened:
            yield self._event(t_s, utc, state, event)

    def _point(self, t_s: float, utc: datetime, state: QueueState) -> HistoryPoint:
        return HistoryPoint(
            self.flight, utc, t_s, state.approach, state.status.value, *_figures(state)
        )

    def _event(self, t_s: float, utc: datetime, state: QueueState, event: Event) -> StoredEvent:
        status = state.status.value
        return StoredEvent(
            self.flight, utc, t_s, state.approach, event.value, status, *_figures(state)
        )


Figures = tuple[
    float | None,
    float | None,
    float | None,
    float | None,
    float | None,
    int | None,
    float | None,
    str,
]


def _figures(state: QueueState) -> Figures:
    reasons, eoq = "; ".join(state.reasons), state.eoq
    if eoq is None:
        return None, None, None, None, None, None, None, reasons
    return (
        known(eoq.lat_deg),
        known(eoq.lon_deg),
        known(eoq.station_m),
        known(eoq.sigma_m),
        known(eoq.length_m),
        int(eoq.vehicles),
        known(eoq.growth_mps),
        reasons,
    )


def known(value: float | None) -> float | None:
    """Return a number, or ``None`` where it is none: a database has no NaN."""
    return None if value is None or not math.isfinite(value) else float(value)
