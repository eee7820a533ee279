"""The state machine of one sign: a table, a clock for what has to last, and nothing else.

What warns more comes at once (the queue's own state has hysteresis already: traffic.state); what
warns less has to last.  So a sign never flickers, and errs on the side of the warning.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from queuetail.signs.distances import Readable, Units, readable
from queuetail.signs.records import SignEvent as E
from queuetail.signs.records import SignState as S

STEADY_S = 3.0  # of answers, after they were missing, before a sign believes them again
FARTHER = 1.05  # a longer distance is told when it is exceeded by this much


class Wait(StrEnum):
    """How long an event has to last before its transition happens."""

    NOW = "now"
    STEADY = "steady"  # 3 s
    RELEASE = "release"  # the site's release_s


NOW, STEADY, RELEASE = Wait.NOW, Wait.STEADY, Wait.RELEASE

TRANSITIONS: dict[tuple[S, E], tuple[S, Wait]] = {
    (S.DEFAULT, E.CLEAR): (S.CLEAR, STEADY),
    (S.DEFAULT, E.DISTANCE): (S.WARNING, NOW),
    (S.DEFAULT, E.AHEAD): (S.AHEAD, NOW),
    (S.DEFAULT, E.PASSED): (S.PASSED, NOW),
    (S.DEFAULT, E.UNKNOWN): (S.DEFAULT, NOW),
    (S.DEFAULT, E.EXPIRED): (S.DEFAULT, NOW),
    (S.CLEAR, E.CLEAR): (S.CLEAR, NOW),
    (S.CLEAR, E.DISTANCE): (S.WARNING, NOW),
    (S.CLEAR, E.AHEAD): (S.AHEAD, NOW),
    (S.CLEAR, E.PASSED): (S.PASSED, NOW),
    (S.CLEAR, E.UNKNOWN): (S.CAUTION, NOW),
    (S.CLEAR, E.EXPIRED): (S.DEFAULT, NOW),
    (S.WARNING, E.CLEAR): (S.CLEAR, RELEASE),
    (S.WARNING, E.DISTANCE): (S.WARNING, NOW),
    (S.WARNING, E.AHEAD): (S.AHEAD, NOW),
    (S.WARNING, E.PASSED): (S.PASSED, NOW),
    (S.WARNING, E.UNKNOWN): (S.CAUTION, NOW),
    (S.WARNING, E.EXPIRED): (S.DEFAULT, NOW),
    (S.AHEAD, E.CLEAR): (S.CLEAR, RELEASE),
    (S.AHEAD, E.DISTANCE): (S.WARNING, RELEASE),
    (S.AHEAD, E.AHEAD): (S.AHEAD, NOW),
    (S.AHEAD, E.PASSED): (S.PASSED, NOW),
    (S.AHEAD, E.UNKNOWN): (S.CAUTION, NOW),
    (S.AHEAD, E.EXPIRED): (S.DEFAULT, NOW),
    (S.PASSED, E.CLEAR): (S.CLEAR, RELEASE),
    (S.PASSED, E.DISTANCE): (S.WARNING, RELEASE),
    (S.PASSED, E.AHEAD): (S.AHEAD, STEADY),
    (S.PASSED, E.PASSED): (S.PASSED, NOW),
    (S.PASSED, E.UNKNOWN): (S.CAUTION, NOW),
    (S.PASSED, E.EXPIRED): (S.DEFAULT, NOW),
    (S.CAUTION, E.CLEAR): (S.CLEAR, RELEASE),
    (S.CAUTION, E.DISTANCE): (S.WARNING, STEADY),
    (S.CAUTION, E.AHEAD): (S.AHEAD, STEADY),
    (S.CAUTION, E.PASSED): (S.PASSED, STEADY),
    (S.CAUTION, E.UNKNOWN): (S.CAUTION, NOW),
    (S.CAUTION, E.EXPIRED): (S.DEFAULT, NOW),
}


@dataclass(slots=True)
class SignMachine:
    """One sign's state; `release_s` is the site's."""

    release_s: float
    state: S = S.DEFAULT
    _pending: tuple[S, float] | None = None  # where to, and since when

    def step(self, event: E, now_s: float) -> S:
        """Take what the newest answer means and return the state."""
        goal, wait = TRANSITIONS[self.state, event]
        if goal is self.state:
            self._pending = None
            return self.state
        if self._pending is None or self._pending[0] is not goal:
            self._pending = (goal, now_s)
        if now_s - self._pending[1] >= self._seconds(wait):
            self.state, self._pending = goal, None
        return self.state

    def _seconds(self, wait: Wait) -> float:
        lengths = {NOW: 0.0, STEADY: STEADY_S, RELEASE: self.release_s}
        return lengths[wait]


@dataclass(slots=True)
class DistanceHold:
    """The distance that a sign tells: a nearer one at once, a farther one when it lasts."""

    release_s: float
    units: Units
    shown: Readable | None = field(default=None)
    _farther_since_s: float | None = None

    def step(self, distance_m: float, now_s: float) -> Readable | None:
        """Return what to tell at a conservative distance; never more than that distance."""
        told = readable(distance_m, self.units)
        if told is None or self.shown is None or told.metres < self.shown.metres:
            self.shown, self._farther_since_s = told, None
            return self.shown
        farther = readable(distance_m / FARTHER, self.units)
        if farther is None or farther.metres <= self.shown.metres:
            self._farther_since_s = None
        elif self._farther_since_s is None:
            self._farther_since_s = now_s
        elif now_s - self._farther_since_s >= self.release_s:
            self.shown, self._farther_since_s = farther, None
        return self.shown

    def forget(self) -> None:
        """Start anew: the sign tells no distance now."""
        self.shown, self._farther_since_s = None, None
