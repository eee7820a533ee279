"""What sign advice and sign control hand to each other: frozen records, units in the names."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

Phases = tuple[tuple[str, ...], ...]  # of lines; no phase at all is a blank sign


class SignKind(StrEnum):
    """What stands beside the road."""

    PORTABLE = "portable"  # a portable changeable message sign, which can be moved
    FIXED = "fixed"  # a dynamic message sign on a gantry or a pole
    BEACON = "beacon"  # a static sign whose beacons can only be switched


class SignState(StrEnum):
    """What a sign is doing; see docs/signs.md for the table of transitions."""

    DEFAULT = "default"  # nothing is known for long: the sign's own default message
    CLEAR = "clear"  # no queue that matters to this sign
    WARNING = "warning"  # a queue ahead, with its distance
    AHEAD = "ahead"  # a queue ahead, nearer than a distance can be given for, or beyond view
    PASSED = "passed"  # the queue reaches the sign or has passed it
    CAUTION = "caution"  # the answer is unknown or old: a cautious message without a distance


class SignEvent(StrEnum):
    """What the newest answer means for one sign."""

    CLEAR = "clear"
    DISTANCE = "distance"
    AHEAD = "ahead"
    PASSED = "passed"
    UNKNOWN = "unknown"
    EXPIRED = "expired"


class Fit(StrEnum):
    """Whether a portable sign stands where it should."""

    OK = "ok"
    TOO_CLOSE = "too_close"
    TOO_FAR = "too_far"


@dataclass(frozen=True, slots=True)
class Placement:
    """Where a portable sign stands against the queue, and where it should be moved."""

    fit: Fit
    move_to_station_m: float | None = None
    move_m: float = 0.0  # upstream when positive
    move_to_lat_deg: float | None = None
    move_to_lon_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Decision:
    """What one sign should show now, and why."""

    sign: str
    state: SignState
    phases: Phases  # empty: blank
    beacon: bool  # whether beacons flash
    changed: bool  # the sign shows something else than in the decision before
    distance_m: float | None = None  # conservative, from the sign to where a driver meets the end
    shown_m: float | None = None  # the distance that the message tells
    required_m: float = 0.0  # the warning distance that the posted speed asks for
    passes_in_s: float | None = None  # until the queue reaches the sign, at its present growth
    placement: Placement | None = None
    reasons: tuple[str, ...] = ()


def as_text(phases: Phases) -> str:
    """Return phases on one line, as logs and screens show them."""
    return " | ".join(" / ".join(lines) for lines in phases) or "(blank)"
