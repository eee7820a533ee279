"""Tracks made by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from queuetail.types import Tracks, TrackState


def fleet(
    places_m: Sequence[tuple[float, float]],
    velocities_mps: Sequence[tuple[float, float]] | None = None,
    *,
    length_m: float = 5.0,
    states: Sequence[TrackState] | None = None,
    first_id: int = 1,
) -> Tracks:
    """Return vehicles at ENU places, standing unless told otherwise."""
    n = len(places_m)
    return Tracks(
        ids=np.arange(first_id, first_id + n),
        states=tuple(states or [TrackState.CONFIRMED] * n),
        px=np.zeros((n, 2)),
        boxes_px=np.zeros((n, 4)),
        enu=np.array(places_m, float).reshape(n, 2),
        velocity_mps=np.array(velocities_mps or [(0.0, 0.0)] * n, float).reshape(n, 2),
        sigma_m=np.full(n, 0.7),
        length_m=np.full(n, length_m),
    )
