"""events.jsonl: what changed and when, one JSON object per line."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from queuetail.sinks import RunInfo
from queuetail.sinks.lines import LineFile
from queuetail.sinks.words import known_states
from queuetail.types import Frame, Observation, QueueState, QueueStatus

MOVED_M = 25.0  # five car lengths: less is the accordion of a queue that breathes
HAS_QUEUE = (QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)


class Event(StrEnum):
    """What can happen to the answer for one approach."""

    WATCH_STARTED = "watch_started"
    QUEUE_FORMED = "queue_formed"
    QUEUE_MOVED = "queue_moved"
    QUEUE_DISSOLVED = "queue_dissolved"
    BEYOND_VIEW = "beyond_view"
    BACK_IN_VIEW = "back_in_view"
    VIEW_LOST = "view_lost"
    VIEW_RECOVERED = "view_recovered"


@dataclass(frozen=True, slots=True)
class Memory:
    """What the event machine remembers of one approach."""

    status: QueueStatus | None = None  # of the last frame; None before the first
    known: QueueStatus = QueueStatus.CLEAR  # the last one that was not unknown
    station_m: float | None = None  # of the end of the queue at the last event that had one


def next_events(
    memory: Memory, state: QueueState, moved_m: float = MOVED_M
) -> tuple[Memory, tuple[Event, ...]]:
    """Return what the new state means and what to remember of it; a pure state machine."""
    status = state.status
    events: list[Event] = []
    if memory.status is None:
        events.append(Event.WATCH_STARTED)
    if status is QueueStatus.UNKNOWN:
        if memory.status not in (None, QueueStatus.UNKNOWN):
            events.append(Event.VIEW_LOST)
        return Memory(status, memory.known, memory.station_m), tuple(events)
    if memory.status is QueueStatus.UNKNOWN:
        events.append(Event.VIEW_RECOVERED)
    had, has = memory.known in HAS_QUEUE, status in HAS_QUEUE
    if has and not had:
        events.append(Event.QUEUE_FORMED)
    if had and not has:
        events.append(Event.QUEUE_DISSOLVED)
    if status is not memory.known:
        if status is QueueStatus.BEYOND_VIEW:
            events.append(Event.BEYOND_VIEW)
        elif had and has:
            events.append(Event.BACK_IN_VIEW)
    station_m = state.eoq.station_m if state.eoq else None
    if not events and has and _far(station_m, memory.station_m, moved_m):
        events.append(Event.QUEUE_MOVED)
    if not has:
        remembered = None
    else:
        remembered = station_m if events and station_m is not None else memory.station_m
    return Memory(status, status, remembered), tuple(events)


class EventsJsonl:
    """events.jsonl: one line per event, with the answer as it then was."""

    def __init__(self, info: RunInfo) -> None:
        self._file = LineFile(info.out / "events.jsonl")
        self._memories: dict[str, Memory] = {}

    def write(self, frame: Frame, observation: Observation) -> None:
        """Add the events of one frame, if any."""
        lines = []
        for state in known_states(observation, tuple(self._memories)):
            memory = self._memories.get(state.approach, Memory())
            self._memories[state.approach], events = next_events(memory, state)
            lines += [event_line(observation.t_s, event, state) for event in events]
        if lines:
            self._file.extend(lines)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def event_line(t_s: float, event: Event, state: QueueState) -> str:
    """Return one event as JSON; ``null`` where there is no value."""
    eoq = state.eoq
    record: dict[str, Any] = {
        "t_s": round(t_s, 3),
        "approach": state.approach,
        "event": event.value,
        "status": state.status.value,
        "eoq_lat": _number(eoq.lat_deg, 8) if eoq else None,
        "eoq_lon": _number(eoq.lon_deg, 8) if eoq else None,
        "eoq_station_m": _number(eoq.station_m, 2) if eoq else None,
        "eoq_sigma_m": _number(eoq.sigma_m, 2) if eoq else None,
        "length_m": _number(eoq.length_m, 2) if eoq else None,
        "vehicles": int(eoq.vehicles) if eoq else None,
        "growth_mps": _number(eoq.growth_mps, 2) if eoq else None,
        "reasons": list(state.reasons),
    }
    return json.dumps(record, ensure_ascii=False, allow_nan=False)


def _number(value: float | None, decimals: int) -> float | None:
    """Round for JSON, which has no NaN."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), decimals) + 0.0


def _far(station_m: float | None, last_m: float | None, moved_m: float) -> bool:
    if station_m is None:
        return False
    return last_m is None or abs(station_m - last_m) > moved_m
