"""Answers that say "unknown": while no picture comes, and where an answer must not be believed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from queuetail.pipeline import NO_TRACKS
from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    Observation,
    QueueState,
    QueueStatus,
    Registration,
    Unknown,
)


def blind_observation(
    approaches: tuple[Approach, ...], names: tuple[str, ...], t_s: float, reason: str
) -> Observation:
    """Return the observation of no picture at all: every state is unknown for `reason`.

    `names` are the approaches' where their places are not yet known.
    """
    known = tuple(a.name for a in approaches) or names or ("",)
    return Observation(
        frame_index=-1,
        t_s=t_s,
        mapping=Unknown((reason,)),
        registration=Registration(np.eye(3), 0.0, reason),
        detections_px=np.empty((0, 4)),
        approaches=approaches,
        vehicles=assign(NO_TRACKS, approaches),
        states=tuple(QueueState(name, QueueStatus.UNKNOWN, None, (reason,)) for name in known),
    )


def disbelieved(observation: Observation, reasons: tuple[str, ...]) -> Observation:
    """Return an observation with its states made unknown for `reasons`; as it is without any."""
    if not reasons:
        return observation
    states = tuple(
        QueueState(
            state.approach,
            QueueStatus.UNKNOWN,
            None,
            (*reasons, *(r for r in state.reasons if r not in reasons)),
        )
        for state in observation.states
    )
    return replace(observation, states=states)
