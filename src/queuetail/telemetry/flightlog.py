"""The flight as a function of time: samples in, an interpolated sample at any time out."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from queuetail.errors import InputError
from queuetail.telemetry.clean import FIELDS
from queuetail.types import TelemetrySample

MAX_GAP_S = 2.0 + 1e-6  # between neighbours of one field; the rest is for times in binary floats
MAX_HOLD_S = 1.0 + 1e-6  # beyond the ends of one field
WRAP_FROM = {"heading_deg": 0.0, "gimbal_roll_deg": -180.0, "lon_deg": -180.0}
EVENT_LIKE = {"hfov_deg"}  # a lens stays as it is until the log says otherwise


class _Series(NamedTuple):
    """One field over time, in plain lists: bisect on them is faster than on arrays."""

    times: list[float]
    values: list[float]
    wrap_from: float | None
    is_event: bool


@dataclass(frozen=True, slots=True)
class FlightLog:
    """A flight's telemetry, sorted, with repeated times merged (the last value given wins).

    ``notes`` are sentences for the user on what was dropped or guessed; ``constants`` are values
    that hold at all times, for fields that no sample has.  Raises InputError without samples.
    """

    samples: Sequence[TelemetrySample]
    source: str
    notes: tuple[str, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    _series: tuple[_Series | float | None, ...] = field(
        default=(), init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not self.samples:
            raise InputError(f"{self.source}: there is no telemetry in it")
        unknown = set(self.constants) - set(FIELDS)
        if unknown:
            raise ValueError(f"no telemetry field is called {', '.join(sorted(unknown))}")
        merged = _merge(self.samples)
        object.__setattr__(self, "samples", merged)
        object.__setattr__(self, "constants", dict(self.constants))
        series = tuple(_series_of(merged, name) or self.constants.get(name) for name in FIELDS)
        object.__setattr__(self, "_series", series)

    @property
    def span_s(self) -> tuple[float, float]:
        """The times of the first and the last sample."""
        return self.samples[0].t_s, self.samples[-1].t_s

    @property
    def fields(self) -> frozenset[str]:
        """The names of the fields that are known at least once."""
        return frozenset(
            name for name, series in zip(FIELDS, self._series, strict=True) if series is not None
        )

    def at(self, t_s: float) -> TelemetrySample:
        """Return the flight at `t_s`, each field interpolated between its own neighbours.

        Neighbours over 2 s apart give None between them; beyond a field's ends its nearest value
        holds for 1 s.  Angles and longitude turn the short way.  The field of view holds from its
        sample to the next, and before its first.
        """
        return TelemetrySample(t_s, *[_value_at(series, t_s) for series in self._series])

    def shifted(self, offset_s: float) -> FlightLog:
        """Return the log with `offset_s` added to all its times."""
        if not offset_s:
            return self
        moved = [replace(sample, t_s=sample.t_s + offset_s) for sample in self.samples]
        return replace(self, samples=moved)

    def filled(self, **constants: float | None) -> FlightLog:
        """Return the log with a constant for each named field that it never has; None adds nothing.

        Raises ValueError for a name that is no telemetry field.
        """
        given = {name: value for name, value in constants.items() if value is not None}
        unknown = set(given) - set(FIELDS)
        if unknown:
            raise ValueError(f"no telemetry field is called {', '.join(sorted(unknown))}")
        missing = {name: value for name, value in given.items() if name not in self.fields}
        return replace(self, constants={**self.constants, **missing}) if missing else self


def _merge(samples: Sequence[TelemetrySample]) -> tuple[TelemetrySample, ...]:
    merged: list[TelemetrySample] = []
    for sample in sorted(samples, key=lambda s: s.t_s):
        if merged and merged[-1].t_s == sample.t_s:
            new = {n: v for n in FIELDS if (v := getattr(sample, n)) is not None}
            merged[-1] = replace(merged[-1], **new)
        else:
            merged.append(sample)
    return tuple(merged)


def _series_of(samples: Sequence[TelemetrySample], name: str) -> _Series | None:
    pairs = [(s.t_s, v) for s in samples if (v := getattr(s, name)) is not None]
    if not pairs:
        return None
    wrap_from = WRAP_FROM.get(name)
    values = [v if wrap_from is None else _wrapped(v, wrap_from) for _, v in pairs]
    return _Series([t for t, _ in pairs], values, wrap_from, name in EVENT_LIKE)


def _value_at(series: _Series | float | None, t_s: float) -> float | None:
    if not isinstance(series, _Series):
        return series
    times, values, wrap_from, is_event = series
    after = bisect_right(times, t_s)
    before = max(after - 1, 0)
    t0, v0 = times[before], values[before]
    if is_event or t0 == t_s:
        return v0
    if after in (0, len(times)):
        return v0 if abs(t_s - t0) <= MAX_HOLD_S else None
    gap_s = times[after] - t0
    if gap_s > MAX_GAP_S:
        return None
    step = values[after] - v0
    share = (t_s - t0) / gap_s
    if wrap_from is None:
        return v0 + share * step
    return _wrapped(v0 + share * ((step + 180.0) % 360.0 - 180.0), wrap_from)


def _wrapped(value_deg: float, wrap_from: float) -> float:
    """Return the angle within one turn from `wrap_from`, untouched where it already is."""
    if wrap_from <= value_deg < wrap_from + 360.0:
        return value_deg
    turned = (value_deg - wrap_from) % 360.0 + wrap_from
    return wrap_from if turned >= wrap_from + 360.0 else turned
