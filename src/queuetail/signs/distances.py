"""How far ahead of a queue drivers must be warned, and which distances they can read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

MPS_PER_MPH = 0.44704
REACTION_S = 2.5  # AASHTO Green Book (2018), section 3.2.2: brake reaction time
BRAKING_MPS2 = 3.4  # the same: comfortable for most drivers, also on wet roads
READING_S = 8.0  # MUTCD 6F.60: the longest cycle of a two-phase message, read once in full
UNPOSTED_MPH = 65.0  # where no limit is given, the distance errs on the long side
FOOT_M, MILE_M = 0.3048, 1609.344

Units = Literal["us", "metric"]
# What a message can tell, with at most eight characters; metres below it are told as "ahead".
STEPS: dict[Units, tuple[tuple[float, str], ...]] = {
    "us": (
        (500 * FOOT_M, "500 FT"),
        (1000 * FOOT_M, "1000 FT"),
        (MILE_M / 4, "1/4 MILE"),
        (MILE_M / 2, "1/2 MILE"),
        (MILE_M * 3 / 4, "3/4 MILE"),
        (MILE_M, "1 MILE"),
        (MILE_M * 3 / 2, "1 1/2 MI"),
        (MILE_M * 2, "2 MILES"),
        (MILE_M * 3, "3 MILES"),
    ),
    "metric": (
        (150.0, "150 M"),
        (300.0, "300 M"),
        (400.0, "400 M"),
        (600.0, "600 M"),
        (800.0, "800 M"),
        (1000.0, "1 KM"),
        (1500.0, "1.5 KM"),
        (2000.0, "2 KM"),
        (3000.0, "3 KM"),
        (5000.0, "5 KM"),
    ),
}


@dataclass(frozen=True, slots=True)
class Readable:
    """A distance as a sign tells it."""

    metres: float
    text: str


def stopping_sight_m(speed_mps: float) -> float:
    """Return AASHTO's stopping sight distance in metres (Green Book 2018, equation 3-2)."""
    return speed_mps * REACTION_S + speed_mps**2 / (2 * BRAKING_MPS2)


def warning_distance_m(posted_mph: float | None, override_m: float | None = None) -> float:
    """Return how far before the end of the queue a sign must warn, in metres.

    Stopping sight distance, and the way driven while a two-phase message is read in full.
    """
    if override_m is not None:
        return override_m
    speed_mps = (posted_mph if posted_mph is not None else UNPOSTED_MPH) * MPS_PER_MPH
    return stopping_sight_m(speed_mps) + speed_mps * READING_S


def readable(distance_m: float, units: Units) -> Readable | None:
    """Return the longest readable distance that is not longer; None below the shortest."""
    found = None
    for metres, text in STEPS[units]:
        if metres <= distance_m:
            found = Readable(metres, text)
    return found
