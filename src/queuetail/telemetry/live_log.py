"""The last seconds of a flight while it goes on: readings in, an interpolated sample out."""

from __future__ import annotations

import math
import threading
from bisect import bisect_right
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from queuetail.telemetry.clean import LIMITS, NO_FIX_DEG, PITCH_TOLERANCE_DEG
from queuetail.telemetry.flightlog import MAX_GAP_S, WRAP_FROM
from queuetail.types import TelemetrySample

WINDOW_S = 30.0
MAX_AGE_S = 1.5  # of the newest value; older ones say nothing of now
FUTURE_S = 0.5  # a reading cannot be measured after it arrived; clocks are only estimated
BACKWARDS_TO_BELIEVE = 5  # readings in order, all before the newest: their clock was set back
RATE_S = 5.0  # over which rates are counted
METRES_PER_DEGREE = 111_320.0
QUANTITIES: Mapping[str, tuple[str, ...]] = {
    "position": ("lat_deg", "lon_deg"),
    "height": ("height_agl_m",),
    "heading": ("heading_deg",),
    "gimbal_pitch": ("gimbal_pitch_deg",),
    "gimbal_roll": ("gimbal_roll_deg",),
    "hfov": ("hfov_deg",),
}
# How far a value may leap at once, and how fast it may go on: a leap beyond is held back until the
# next reading confirms it.  Drones fly at up to 30 m/s, gimbals turn at up to 180°/s.
LEAPS: Mapping[str, tuple[float, float]] = {
    "position": (10.0, 40.0),  # m, m/s
    "height": (10.0, 20.0),
    "heading": (20.0, 360.0),
    "gimbal_pitch": (15.0, 360.0),
    "gimbal_roll": (15.0, 360.0),
}
HELD_FOR_EVER = {"hfov"}  # a lens stays as it is until it is said otherwise

Values = tuple[float, ...]


@dataclass(slots=True)
class _Series:
    """One quantity's readings in order of time; `legs` count the confirmed leaps."""

    times: list[float] = field(default_factory=list)
    values: list[Values] = field(default_factory=list)
    legs: list[int] = field(default_factory=list)
    held: tuple[float, Values] | None = None
    backwards: list[float] = field(default_factory=list)

    @property
    def newest_s(self) -> float:
        """The time of the newest reading, held back or not."""
        return self.held[0] if self.held is not None else self.times[-1]

    def append(self, t_s: float, values: Values, leg: int) -> None:
        self.times.append(t_s)
        self.values.append(values)
        self.legs.append(leg)

    def forget_before(self, t_s: float) -> None:
        """Drop what is older, but for the newest."""
        count = min(bisect_right(self.times, t_s), max(len(self.times) - 1, 0))
        if count:
            del self.times[:count], self.values[:count], self.legs[:count]

    def clear(self) -> None:
        self.times.clear()
        self.values.clear()
        self.legs.clear()
        self.held = None
        self.backwards.clear()


class LiveLog:
    """Thread-safe; all times are seconds of one clock of the caller's choice.

    Every quantity keeps its own readings.  Refused: what is no number or impossible, leaps that no
    second reading confirms, and times that run backwards (until five in a row do).
    """

    def __init__(
        self,
        window_s: float = WINDOW_S,
        max_age_s: Mapping[str, float] | None = None,
        max_gap_s: float = MAX_GAP_S,
        constants: Mapping[str, float] | None = None,
    ) -> None:
        """`max_age_s` replaces 1.5 s for the quantities it names; `constants` fill what is never
        said, by field name."""
        unknown = set(max_age_s or {}) - set(QUANTITIES)
        if unknown:
            raise ValueError(f"no quantity is called {', '.join(sorted(unknown))}")
        self._window_s = window_s
        self._max_age_s = {**dict.fromkeys(QUANTITIES, MAX_AGE_S), **(max_age_s or {})}
        self._max_gap_s = max_gap_s
        self._constants = dict(constants or {})
        self._series = {name: _Series() for name in QUANTITIES}
        self._refused: Counter[str] = Counter()
        self._lock = threading.Lock()

    def add(self, sample: TelemetrySample, arrived_s: float | None = None) -> None:
        """Take a partial sample; `arrived_s`, on the same clock, catches times in the future."""
        with self._lock:
            if not math.isfinite(sample.t_s):
                self._refused["time is not a number"] += 1
                return
            if arrived_s is not None and sample.t_s > arrived_s + FUTURE_S:
                self._refused["time is in the future"] += 1
                return
            for name, fields in QUANTITIES.items():
                given = [getattr(sample, field_name) for field_name in fields]
                if all(value is not None for value in given):
                    self._add(name, sample.t_s, tuple(given))

    def at(self, t_s: float) -> TelemetrySample:
        """Return the flight at `t_s`, each quantity between its own neighbours.

        After a quantity's newest reading its value holds for its greatest age, as before its first;
        a lens holds for ever.  Neighbours too far apart, or on both sides of a confirmed leap, are
        not joined: the nearer one holds for the greatest age.
        """
        found: dict[str, float | None] = dict(self._constants)
        with self._lock:
            for name, fields in QUANTITIES.items():
                series = self._series[name]
                if series.times:
                    values = self._value_at(name, series, t_s)
                    found.update(zip(fields, values or (None,) * len(fields), strict=True))
        return TelemetrySample(t_s, **found)

    def ages(self, now_s: float) -> dict[str, float]:
        """Return how old the newest reading of each quantity is; unheard ones are left out."""
        with self._lock:
            return {n: now_s - s.times[-1] for n, s in self._series.items() if s.times}

    def rates(self, now_s: float) -> dict[str, float]:
        """Return how many readings per second each quantity had lately; unheard ones left out."""
        with self._lock:
            return {
                name: _rate_hz(series.times, now_s)
                for name, series in self._series.items()
                if series.times
            }

    @property
    def refused(self) -> dict[str, int]:
        """How many readings were refused, by reason."""
        with self._lock:
            return dict(self._refused)

    def _add(self, name: str, t_s: float, values: Values) -> None:
        tidy = _tidy(name, values)
        if tidy is None:
            self._refused[f"{name} is impossible"] += 1
            return
        series = self._series[name]
        if series.times and t_s <= series.newest_s and not self._clock_was_set(name, t_s):
            return
        series.backwards.clear()
        if not series.times or _is_near(name, series.times[-1], series.values[-1], t_s, tidy):
            if series.held is not None:
                self._refused[f"{name} leapt and came back"] += 1
                series.held = None
            series.append(t_s, tidy, series.legs[-1] if series.legs else 0)
        elif series.held is not None and _is_near(name, *series.held, t_s, tidy):
            leg = series.legs[-1] + 1
            series.append(*series.held, leg)
            series.append(t_s, tidy, leg)
            series.held = None
        else:
            if series.held is not None:
                self._refused[f"{name} leapt and came back"] += 1
            series.held = t_s, tidy
        series.forget_before(series.times[-1] - self._window_s)

    def _clock_was_set(self, name: str, t_s: float) -> bool:
        """Tell whether a time before the newest is one of several in order: then start anew."""
        series = self._series[name]
        if t_s == series.newest_s:
            self._refused[f"{name} repeats its time"] += 1
            return False
        if series.backwards and t_s <= series.backwards[-1]:
            series.backwards.clear()
        series.backwards.append(t_s)
        if len(series.backwards) < BACKWARDS_TO_BELIEVE:
            self._refused[f"{name} runs backwards"] += 1
            return False
        series.clear()
        return True

    def _value_at(self, name: str, series: _Series, t_s: float) -> Values | None:
        after = bisect_right(series.times, t_s)
        before = max(after - 1, 0)
        max_age_s = self._max_age_s[name]
        if name in HELD_FOR_EVER or series.times[before] == t_s:
            return series.values[before]
        if after in (0, len(series.times)):
            is_fresh = abs(t_s - series.times[before]) <= max_age_s
            return series.values[before] if is_fresh else None
        gap_s = series.times[after] - series.times[before]
        if gap_s > self._max_gap_s or series.legs[before] != series.legs[after]:
            near = before if t_s - series.times[before] <= gap_s / 2 else after
            is_fresh = abs(t_s - series.times[near]) <= max_age_s
            return series.values[near] if is_fresh else None
        share = (t_s - series.times[before]) / gap_s
        return tuple(
            _between(field_name, a, b, share)
            for field_name, a, b in zip(
                QUANTITIES[name], series.values[before], series.values[after], strict=True
            )
        )


def _rate_hz(times: list[float], now_s: float) -> float:
    span_s = min(RATE_S, max(now_s - times[0], 1.0))
    return sum(now_s - span_s < t_s <= now_s for t_s in times) / span_s


def _tidy(name: str, values: Values) -> Values | None:
    """Return the values within one turn; None where they are impossible."""
    fields = QUANTITIES[name]
    for field_name, value in zip(fields, values, strict=True):
        is_possible, _ = LIMITS[field_name]
        if not math.isfinite(value) or not is_possible(value):
            return None
    if name == "position" and all(abs(value) < NO_FIX_DEG for value in values):
        return None
    if name == "gimbal_pitch" and 90 < abs(values[0]) <= 90 + PITCH_TOLERANCE_DEG:
        return (math.copysign(90.0, values[0]),)
    return tuple(_wrapped(f, v) for f, v in zip(fields, values, strict=True))


def _is_near(name: str, t0: float, old: Values, t1: float, new: Values) -> bool:
    """Tell whether a drone can have gone from one value to the other in that time."""
    if name not in LEAPS:
        return True
    at_once, per_second = LEAPS[name]
    return _distance(name, old, new) <= at_once + per_second * abs(t1 - t0)


def _distance(name: str, old: Values, new: Values) -> float:
    """Return metres for positions and heights, degrees the short way round for angles."""
    if name == "position":
        north = new[0] - old[0]
        east = _short_way(new[1] - old[1]) * math.cos(math.radians(old[0]))
        return METRES_PER_DEGREE * math.hypot(north, east)
    step = new[0] - old[0]
    return abs(step if name == "height" else _short_way(step))


def _between(field_name: str, a: float, b: float, share: float) -> float:
    if field_name not in WRAP_FROM:
        return a + share * (b - a)
    return _wrapped(field_name, a + share * _short_way(b - a))


def _short_way(step_deg: float) -> float:
    return (step_deg + 180.0) % 360.0 - 180.0


def _wrapped(field_name: str, value: float) -> float:
    if field_name not in WRAP_FROM:
        return value
    low = WRAP_FROM[field_name]
    if low <= value < low + 360.0:
        return value
    turned = (value - low) % 360.0 + low
    return low if turned >= low + 360.0 else turned  # rounding of tiny negative angles
