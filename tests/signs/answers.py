"""Answers of a live run, made up for tests of what listens to them."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np

from queuetail.live.records import Health, Published
from queuetail.pipeline import NO_TRACKS
from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    EndOfQueue,
    Observation,
    QueueState,
    QueueStatus,
    Registration,
    Unknown,
)

ROAD = Approach("NB", np.array([[0.0, 0.0], [3000.0, 0.0]]), 0.0, 2, 3.6)


def answer(state: QueueState, number: int = 0) -> Published:
    """Return what a live run would publish with one state."""
    seen = Observation(
        frame_index=number,
        t_s=number / 10,
        mapping=Unknown(("made up",)),
        registration=Registration(np.eye(3), 1.0),
        detections_px=np.empty((0, 4)),
        approaches=(ROAD,),
        vehicles=assign(NO_TRACKS, (ROAD,)),
        states=(state,),
    )
    return Published(number, datetime.now(UTC), None, seen, Health())


def queue(station_m: float, growth_mps: float = 0.0) -> QueueState:
    """Return a queue whose end is at a station, to the metre."""
    eoq = EndOfQueue(
        station_m, 0.5, (station_m, -3.0), (0.0, 0.0), None, None, 1, 50.0, 6, growth_mps
    )
    return QueueState("NB", QueueStatus.QUEUED, eoq)


CLEAR = QueueState("NB", QueueStatus.CLEAR)
UNKNOWN = QueueState("NB", QueueStatus.UNKNOWN, None, ("the stream is lost",))
