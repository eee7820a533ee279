"""Answers of a live run on a known road, made up for tests of feeds."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from threading import Event
from time import monotonic

import numpy as np

from queuetail.feeds.answers import Answer, Reader
from queuetail.live.records import Health, Published
from queuetail.pipeline import NO_TRACKS
from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    EndOfQueue,
    GroundMapping,
    Observation,
    Origin,
    QueueState,
    QueueStatus,
    Registration,
    Unknown,
)

START = datetime(2026, 5, 14, 15, 30, tzinfo=UTC)
ORIGIN = Origin(36.11, -97.05)
ROAD = Approach("NB", np.array([[0.0, 0.0], [0.0, 3000.0]]), 0.0, 2, 3.6)  # due north
MAPPING = GroundMapping(np.eye(3), np.eye(3), ORIGIN)
LIMIT_S = 15.0

CLEAR = QueueState("NB", QueueStatus.CLEAR)
LOST = QueueState("NB", QueueStatus.UNKNOWN, None, ("no picture for 3.0 s",))


def queue(
    station_m: float = 2000.0, sigma_m: float = 1.5, status: QueueStatus = QueueStatus.QUEUED
) -> QueueState:
    """Return a queue whose end was measured at a station."""
    eoq = EndOfQueue(
        station_m, sigma_m, (0.0, station_m), (0.0, 0.0), None, None, 1, 180.0, 12, 0.5
    )
    return QueueState("NB", status, eoq)


def published(
    *states: QueueState, at_s: float = 0.0, is_placed: bool = True, utc: datetime | None = None
) -> Published:
    """Return what a live run would publish with these states."""
    blind = all(state.status is QueueStatus.UNKNOWN for state in states)
    seen = Observation(
        frame_index=0,
        t_s=at_s,
        mapping=MAPPING if is_placed and not blind else Unknown(("made up",)),
        registration=Registration(np.eye(3), 1.0),
        detections_px=np.empty((0, 4)),
        approaches=(ROAD,),
        vehicles=assign(NO_TRACKS, (ROAD,)),
        states=states,
    )
    return Published(0, utc or START + timedelta(seconds=at_s), None, seen, Health())


def answer(state: QueueState, at_s: float = 0.0, made_s: float = 0.0) -> Answer:
    """Return one answer, as a reader that knows the road reads it."""
    reader = Reader(2.0)
    reader.read(published(queue()))
    read = reader.read(published(state, at_s=at_s))[0]
    return Answer(
        *(getattr(read, name) if name != "made_s" else made_s for name in Answer.__slots__)
    )


def wait_until(condition: Callable[[], bool], limit_s: float = LIMIT_S) -> None:
    """Wait for what another thread does; fails after `limit_s`."""
    end_s, pause = monotonic() + limit_s, Event()
    while not condition():
        assert monotonic() < end_s
        pause.wait(0.005)
