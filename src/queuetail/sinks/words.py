"""The answer in words, the same on the annotated video and in the report."""

from __future__ import annotations

import math
from collections.abc import Sequence

from queuetail.config import MPS_PER_MPH
from queuetail.types import EndOfQueue, Observation, QueueState, QueueStatus, Unknown

STEADY_MPS = 0.05  # a queue that grows or shrinks by less is called steady
NO_REASON = "no reason given"


def status_words(state: QueueState) -> str:
    """Return one approach's answer as a short sentence."""
    if state.status is QueueStatus.UNKNOWN:
        return f"UNKNOWN: {'; '.join(state.reasons) or NO_REASON}"
    if state.status is QueueStatus.CLEAR or state.eoq is None:
        return state.status.value.replace("_", " ").upper()
    eoq = state.eoq
    at_least = ""
    head = "QUEUED"
    if state.status is QueueStatus.BEYOND_VIEW:
        head, at_least = "QUEUE BEYOND VIEW", "at least "
    parts = [f"{head} {at_least}{eoq.length_m:.0f} m", f"EOQ {place_words(eoq)}"]
    if eoq.growth_mps is not None and math.isfinite(eoq.growth_mps):
        parts.append(growth_words(eoq.growth_mps))
    return " · ".join(parts)


def place_words(eoq: EndOfQueue) -> str:
    """Return where the end of the queue is and how sure that is."""
    sigma = f" ± {max(eoq.sigma_m, 0.1):.{0 if eoq.sigma_m >= 2 else 1}f} m"
    if eoq.lat_deg is None or eoq.lon_deg is None:
        return f"station {eoq.station_m:.0f} m".replace("-", "−") + sigma
    return f"{eoq.lat_deg:.5f}, {eoq.lon_deg:.5f}".replace("-", "−") + sigma


def growth_words(growth_mps: float) -> str:
    """Return how the queue's length changes."""
    if abs(growth_mps) < STEADY_MPS:
        return "steady"
    return f"{'growing' if growth_mps > 0 else 'shrinking'} {abs(growth_mps):.1f} m/s"


def mph_words(speed_mps: float) -> str:
    """Return a speed as a label, without the unit; the sign says it goes the other way."""
    mph = round(speed_mps / MPS_PER_MPH)
    return f"−{-mph}" if mph < 0 else f"{mph}"


def known_states(observation: Observation, names: Sequence[str] = ()) -> tuple[QueueState, ...]:
    """Return the states, or ``unknown`` for each of `names` where the frame has none."""
    if observation.states:
        return observation.states
    mapping = observation.mapping
    reasons = mapping.reasons if isinstance(mapping, Unknown) else ("no approach is known yet",)
    return tuple(QueueState(name, QueueStatus.UNKNOWN, None, reasons) for name in names or ("",))
