"""From the answers of the pipeline to what every sign should show, with reasons; pure.

The end of the queue is taken `sigma_factor` standard deviations further upstream than estimated,
and nearer still by what the queue grows until a driver gets there: every distance errs on the
short side.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.signs.distances import MPS_PER_MPH, STEPS, UNPOSTED_MPH, warning_distance_m
from queuetail.signs.machine import TRANSITIONS, DistanceHold, SignMachine
from queuetail.signs.messages import fit, with_distance
from queuetail.signs.records import (
    Decision,
    Fit,
    Phases,
    Placement,
    SignEvent,
    SignKind,
    SignState,
)
from queuetail.signs.settings import SignSite, SignsSettings
from queuetail.traffic.road import locate, place
from queuetail.types import Approach, EndOfQueue, Origin, QueueState, QueueStatus

MOVE_S = 600.0  # moving a portable sign takes about so long: it should then still be far enough
MOVE_ROOM = 1.25  # times the warning distance
TOO_FAR = 4.0  # times the warning distance: drivers forget a warning that proves nothing
MOVE_STEP_M = 10.0
TREND_REACH = 5.0  # a trend is drawn out for so many times as long as it was watched
BESIDE_M = 2.0  # from the right edge of the right lane to a portable sign
SMOOTH_S = 5.0  # over which growth is averaged for a driver
TREND_S, LEAST_TREND_S, SAMPLE_S = 120.0, 20.0, 1.0  # of stations, for planning a move
GROWING_MPS = 0.1  # slower than this, no time is told at which the queue passes a sign


@dataclass(frozen=True, slots=True)
class Answers:
    """The newest answers and the road they refer to; `answer_s` is when they were true."""

    states: Sequence[QueueState]
    approaches: Sequence[Approach]
    origin: Origin | None
    answer_s: float


@dataclass(slots=True)
class _Known:
    """The last answer that was one, for one approach, and the averaged growth."""

    state: QueueState
    answer_s: float
    growth_mps: float = 0.0
    past: tuple[tuple[float, float], ...] = ()  # (time, station) of the end, one a second

    def grown_m(self, after_s: float) -> float:
        """How far upstream the queue may have come after so long; young trends go less far."""
        if not self.past:
            return 0.0
        watched_s = self.past[-1][0] - self.past[0][0]
        return max(self.trend_mps, 0.0) * min(after_s, TREND_REACH * watched_s)

    @property
    def trend_mps(self) -> float:
        """How fast the queue has grown over the last minutes; 0 until that is known."""
        if not self.past or self.past[-1][0] - self.past[0][0] < LEAST_TREND_S:
            return 0.0
        times, stations = np.array(self.past).T
        centred = times - times.mean()
        return float(-(centred @ stations) / (centred @ centred))


@dataclass(slots=True)
class _SignMemory:
    machine: SignMachine
    hold: DistanceHold
    phases: Phases | None = None
    station_m: float | None = None


@dataclass(frozen=True, slots=True)
class _View:
    """What one sign's situation is now."""

    event: SignEvent
    reasons: tuple[str, ...]
    distance_m: float | None = None  # conservative
    end_m: float | None = None  # station, conservative
    known: _Known | None = None
    approach: Approach | None = None


@dataclass(slots=True)
class Adviser:
    """Decides for every sign of a site; it keeps each sign's state, and reads no clock."""

    settings: SignsSettings
    signs: tuple[SignSite, ...]
    posted_mph: float | None = None
    _known: dict[str, _Known] = field(default_factory=dict)
    _memories: dict[str, _SignMemory] = field(default_factory=dict)
    _why_unknown: dict[str, tuple[str, ...]] = field(default_factory=dict)
    _road: tuple[Sequence[Approach], Origin | None] = ((), None)

    @property
    def required_m(self) -> float:
        """The warning distance that is asked for, in metres."""
        return warning_distance_m(self.posted_mph, self.settings.warning_distance_m)

    def advise(self, answers: Answers | None, now_s: float) -> tuple[Decision, ...]:
        """Take the newest answers, if there are any since the last call, and decide."""
        if answers is not None:
            self._learn(answers)
        return tuple(self._decide(sign, now_s) for sign in self.signs)

    @property
    def knows(self) -> bool:
        """Whether some sign is told from an answer that is known and fresh."""
        lost = (SignState.DEFAULT, SignState.CAUTION)
        return any(m.machine.state not in lost for m in self._memories.values())

    def _learn(self, answers: Answers) -> None:
        if answers.approaches:
            self._road = answers.approaches, answers.origin
        for state in answers.states:
            if state.status is QueueStatus.UNKNOWN:
                self._why_unknown[state.approach] = state.reasons
                continue
            self._why_unknown.pop(state.approach, None)
            before = self._known.get(state.approach)
            known = _Known(state, answers.answer_s)
            growth = state.eoq.growth_mps if state.eoq is not None else None
            if before is not None and state.eoq is not None:
                dt_s = max(answers.answer_s - before.answer_s, 0.0)
                rate = growth if growth is not None else before.growth_mps
                known.growth_mps = _averaged(before.growth_mps, rate, dt_s / SMOOTH_S)
            if state.eoq is not None:
                past = before.past if before is not None else ()
                known.past = _remembered(past, answers.answer_s, state.eoq.station_m)
            self._known[state.approach] = known

    def _decide(self, sign: SignSite, now_s: float) -> Decision:
        memory = self._memory(sign)
        view = self._view(sign, memory, now_s)
        state = memory.machine.step(view.event, now_s)
        shown = None
        if state is not SignState.WARNING:
            memory.hold.forget()
        elif view.distance_m is not None:
            shown = memory.hold.step(view.distance_m, now_s)
        else:
            shown = memory.hold.shown  # no queue any more, which has to last before it is believed
        if state is SignState.WARNING and shown is None:
            phases = self._text(sign, self.settings.ahead)
        elif shown is not None:
            phases = self._text(sign, with_distance(self.settings.warning, shown.text))
        else:
            phases = self._phases(sign, state)
        changed = phases != memory.phases
        memory.phases = phases
        return Decision(
            sign=sign.name,
            state=state,
            phases=() if sign.kind is SignKind.BEACON else phases,
            beacon=sign.kind is SignKind.BEACON and bool(phases),
            changed=changed,
            distance_m=view.distance_m,
            shown_m=shown.metres if shown else None,
            required_m=self.required_m,
            passes_in_s=self._passes_in_s(view, memory),
            placement=self._placement(sign, view, memory),
            reasons=(*view.reasons, *_waiting(state, view.event)),
        )

    def _memory(self, sign: SignSite) -> _SignMemory:
        if sign.name not in self._memories:
            release_s = self.settings.release_s
            self._memories[sign.name] = _SignMemory(
                SignMachine(release_s), DistanceHold(release_s, self.settings.units)
            )
        return self._memories[sign.name]

    def _view(self, sign: SignSite, memory: _SignMemory, now_s: float) -> _View:
        """Return what the newest answer means for the sign."""
        approaches, origin = self._road
        approach = _approach_of(sign, approaches)
        name = approach.name if approach is not None else sign.approach or ""
        known = self._known.get(name)
        if known is None:
            why = self._why_unknown.get(name, ("there is no answer yet",))
            return _View(SignEvent.EXPIRED, why)
        age_s = max(now_s - known.answer_s, 0.0)
        if age_s > self.settings.max_age_s:
            held = age_s <= self.settings.max_age_s + self.settings.hold_s
            why = self._why_unknown.get(name, ("no answer comes any more",))
            since = f"the last known answer is {age_s:.0f} s old"
            return _View(SignEvent.UNKNOWN if held else SignEvent.EXPIRED, (since, *why))
        if approach is not None:
            memory.station_m = _station_m(sign, approach, origin)
        if memory.station_m is None:
            why = ("the place of the sign on the road is unknown: the answers have no coordinates",)
            return _View(SignEvent.UNKNOWN, why)
        return self._seen(known, memory.station_m, approach, age_s)

    def _seen(
        self, known: _Known, station_m: float, approach: Approach | None, age_s: float
    ) -> _View:
        """Return what a known and fresh answer means for a sign at a station."""
        eoq = known.state.eoq
        if eoq is None:
            return _View(SignEvent.CLEAR, ("the road is clear",), known=known, approach=approach)
        growth = max(known.growth_mps, 0.0)
        end_m = eoq.station_m - self.settings.sigma_factor * eoq.sigma_m - growth * age_s
        gap_m = end_m - station_m
        beyond = known.state.status is QueueStatus.BEYOND_VIEW
        reasons = [_told(eoq, station_m, beyond)]
        if gap_m <= 0:
            reasons.append("the queue reaches the sign, or has passed it")
            return _View(SignEvent.PASSED, tuple(reasons), gap_m, end_m, known, approach)
        speed_mps = (self.posted_mph or UNPOSTED_MPH) * MPS_PER_MPH
        met_m = gap_m * speed_mps / (speed_mps + growth)
        if beyond:
            reasons.append("the queue goes on upstream of the picture: its distance is not known")
            return _View(SignEvent.AHEAD, tuple(reasons), met_m, end_m, known, approach)
        if met_m > max(self.settings.reach_m, self.required_m):
            reasons.append(f"farther than reach_m, {self.settings.reach_m:.0f} m")
            return _View(SignEvent.CLEAR, tuple(reasons), met_m, end_m, known, approach)
        near = met_m < STEPS[self.settings.units][0][0]
        if near:
            reasons.append("nearer than a distance that drivers can read")
        event = SignEvent.AHEAD if near else SignEvent.DISTANCE
        return _View(event, tuple(reasons), met_m, end_m, known, approach)

    def _phases(self, sign: SignSite, state: SignState) -> Phases:
        if sign.kind is SignKind.BEACON:
            off = state in (SignState.CLEAR, SignState.DEFAULT)
            return () if off else self.settings.ahead
        if state is SignState.DEFAULT:
            return sign.default
        if state is SignState.CLEAR:
            return sign.clear
        caution = state is SignState.CAUTION
        return self._text(sign, self.settings.caution if caution else self.settings.ahead)

    def _text(self, sign: SignSite, text: Phases) -> Phases:
        if sign.kind is SignKind.BEACON:
            return self.settings.ahead  # its own fixed words; that they are lit is what counts
        return fit(text, sign.lines, sign.characters, sign.phases)

    def _passes_in_s(self, view: _View, memory: _SignMemory) -> float | None:
        if view.known is None or view.known.state.eoq is None or memory.station_m is None:
            return None
        gap_m = view.known.state.eoq.station_m - memory.station_m
        growth = view.known.growth_mps
        return gap_m / growth if gap_m > 0 and growth > GROWING_MPS else None

    def _placement(self, sign: SignSite, view: _View, memory: _SignMemory) -> Placement | None:
        """Return whether a portable sign stands well, and where to move it where not."""
        unmoved = sign.kind is not SignKind.PORTABLE or memory.station_m is None
        if unmoved or view.end_m is None or view.known is None or memory.station_m is None:
            return None
        gap_m = view.end_m - memory.station_m
        if self.required_m <= gap_m <= TOO_FAR * self.required_m:
            return Placement(Fit.OK)
        goal_m = view.end_m - MOVE_ROOM * self.required_m - view.known.grown_m(MOVE_S)
        goal_m = math.floor(goal_m / MOVE_STEP_M) * MOVE_STEP_M
        too_close = gap_m < self.required_m
        if not too_close and view.known.state.status is QueueStatus.BEYOND_VIEW:
            return None  # the queue may reach much farther upstream than its bound
        if not too_close and goal_m <= memory.station_m:
            return Placement(Fit.OK)  # a growing queue comes to meet it
        lat, lon = _lat_lon(view.approach, goal_m, self._road[1])
        return Placement(
            fit=Fit.TOO_CLOSE if too_close else Fit.TOO_FAR,
            move_to_station_m=goal_m,
            move_m=memory.station_m - goal_m,
            move_to_lat_deg=lat,
            move_to_lon_deg=lon,
        )


def _averaged(before: float, now: float, share: float) -> float:
    return before + (now - before) * (1 - math.exp(-share))


def _remembered(
    past: tuple[tuple[float, float], ...], now_s: float, station_m: float
) -> tuple[tuple[float, float], ...]:
    """Return the past with what is seen now, if it is time for another sample."""
    if past and now_s - past[-1][0] < SAMPLE_S:
        return past
    return (*(p for p in past if now_s - p[0] <= TREND_S), (now_s, station_m))


def _approach_of(sign: SignSite, approaches: Sequence[Approach]) -> Approach | None:
    if sign.approach is None:
        return approaches[0] if len(approaches) == 1 else None
    return next((a for a in approaches if a.name == sign.approach), None)


def _station_m(sign: SignSite, approach: Approach, origin: Origin | None) -> float | None:
    """Return the sign's station; a place needs an origin to be put on the road."""
    if sign.station_m is not None:
        return sign.station_m
    if sign.at is None or origin is None:
        return None
    enu = enu_from_geodetic(np.array([sign.at[0]]), np.array([sign.at[1]]), origin)
    return float(locate(approach, enu)[0][0])


def _lat_lon(
    approach: Approach | None, station_m: float, origin: Origin | None
) -> tuple[float | None, float | None]:
    """Return where a portable sign at a station stands: beside the right lane."""
    if approach is None or origin is None:
        return None, None
    offset_m = -(approach.lanes * approach.lane_width_m + BESIDE_M)
    enu = place(approach, np.array([station_m]), np.array([offset_m]))
    lat, lon = geodetic_from_enu(enu, origin)
    return float(lat[0]), float(lon[0])


def _told(eoq: EndOfQueue, station_m: float, beyond: bool) -> str:
    """Say where the queue's end is, seen from the sign."""
    end = "at or upstream of" if beyond else "at"
    return (
        f"the queue ends {end} station {eoq.station_m:.0f} ± {eoq.sigma_m:.1f} m, "
        f"{eoq.station_m - station_m:.0f} m from the sign"
    )


def _waiting(state: SignState, event: SignEvent) -> tuple[str, ...]:
    """Say that a sign goes on as it is until the event has lasted."""
    goal, _ = TRANSITIONS[state, event]
    return () if goal is state else (f"waiting until {event.value} has lasted",)
