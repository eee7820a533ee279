"""From what a live run publishes to what feeds may tell: one answer for each approach, on the map.

The posted end of the queue is conservative: `sigma_factor` standard deviations upstream of where it
was measured.  An answer that lacks what its status promises is told as `unknown`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from time import monotonic

import numpy as np

from queuetail.geo.earth import geodetic_from_enu
from queuetail.live.records import Published
from queuetail.sinks.words import known_states
from queuetail.traffic.road import length_m, locate, place
from queuetail.types import (
    Approach,
    EndOfQueue,
    GroundMapping,
    Origin,
    QueueState,
    QueueStatus,
    RoadVehicles,
)

LatLon = tuple[float, float]
HAS_QUEUE = (QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)
NO_LONGER_WATCHED = "this approach is no longer watched"
PATH_STEP_M = 50.0  # a curve of a motorway leaves its chord by less than half a metre


@dataclass(frozen=True, slots=True)
class Road:
    """Where one approach lies on the earth."""

    approach: Approach
    origin: Origin

    def point(self, station_m: float) -> LatLon:
        """Return the place at a station, in the middle of the carriageway."""
        return self.path(station_m, station_m)[0]

    def path(self, first_m: float, last_m: float) -> tuple[LatLon, ...]:
        """Return places from one station to another, which may lie upstream of it."""
        steps = max(math.ceil(abs(last_m - first_m) / PATH_STEP_M), 1)
        stations = np.linspace(first_m, last_m, steps + 1)
        offset_m = -self.approach.lanes * self.approach.lane_width_m / 2
        enu = place(self.approach, stations, np.full(len(stations), offset_m))
        lat_deg, lon_deg = geodetic_from_enu(enu, self.origin)
        return tuple(
            (round(lat, 7), round(lon, 7))
            for lat, lon in zip(lat_deg.tolist(), lon_deg.tolist(), strict=True)
        )

    def course_deg(self, station_m: float) -> float:
        """Return the direction of travel at a station, clockwise from north."""
        enu = place(self.approach, np.array([station_m]), np.array([0.0]))
        east, north = locate(self.approach, enu)[2][0]
        return math.degrees(math.atan2(east, north)) % 360

    @property
    def middle_m(self) -> float:
        """The station in the middle of the axis."""
        return self.approach.start_station_m + length_m(self.approach) / 2


@dataclass(frozen=True, slots=True)
class End:
    """The end of the queue as it is posted: conservative."""

    station_m: float
    measured_m: float  # the station where it was measured
    sigma_m: float
    length_m: float
    vehicles: int
    growth_mps: float | None
    is_bound: bool  # the queue goes on upstream of the picture
    at: LatLon | None  # None without coordinates


@dataclass(frozen=True, slots=True)
class Answer:
    """What is known of one approach; `made_s` is when it came, on the monotonic clock."""

    approach: str
    status: QueueStatus
    utc: datetime
    made_s: float
    end: End | None = None
    reasons: tuple[str, ...] = ()
    road: Road | None = None
    speed_mps: float | None = None  # mean of the vehicles seen
    vehicles_seen: int = 0

    @property
    def has_queue(self) -> bool:
        """Whether there is a queue, and its end or a bound of it is known."""
        return self.status in HAS_QUEUE and self.end is not None

    @property
    def is_placed(self) -> bool:
        """Whether it can be put on a map."""
        return self.road is not None and self.end is not None and self.end.at is not None

    def unknown(self, *reasons: str) -> Answer:
        """Return the same approach with nothing known."""
        return replace(
            self,
            status=QueueStatus.UNKNOWN,
            end=None,
            reasons=reasons,
            speed_mps=None,
            vehicles_seen=0,
        )

    def at_age(self, now_s: float, max_age_s: float) -> Answer:
        """Return the answer as it may be told now: `unknown` when it is too old."""
        age_s = now_s - self.made_s
        if age_s <= max_age_s:
            return self
        return self.unknown(f"no answer for {age_s:.0f} s", *self.reasons)


class Reader:
    """Reads answers from what is published; it remembers where the roads are."""

    def __init__(self, sigma_factor: float) -> None:
        self._sigma_factor = sigma_factor
        self._roads: dict[str, Road] = {}
        self._newest: tuple[Published | None, tuple[Answer, ...]] = (None, ())

    def read(self, published: Published) -> tuple[Answer, ...]:
        """Return the answer for each approach; the same again for what was read last."""
        last, answers = self._newest
        if published is last:
            return answers
        observation = published.observation
        self._learn(observation.approaches, observation.mapping)
        names = {a.name: i for i, a in enumerate(observation.approaches)}
        now_s = monotonic()
        utc = published.utc.astimezone(UTC)
        answers = tuple(
            self._answer(state, utc, now_s, observation.vehicles, names.get(state.approach))
            for state in known_states(observation)
        )
        self._newest = published, answers
        return answers

    def _learn(self, approaches: Sequence[Approach], mapping: object) -> None:
        if isinstance(mapping, GroundMapping) and mapping.origin is not None:
            origin = mapping.origin
            self._roads = {a.name: Road(a, origin) for a in approaches} or self._roads

    def _answer(
        self,
        state: QueueState,
        utc: datetime,
        now_s: float,
        vehicles: RoadVehicles,
        index: int | None,
    ) -> Answer:
        road = self._roads.get(state.approach)
        answer = Answer(state.approach, state.status, utc, now_s, None, _clean(state.reasons), road)
        if state.status is QueueStatus.UNKNOWN:
            return answer
        if state.status in HAS_QUEUE:
            if state.eoq is None or not math.isfinite(state.eoq.station_m + state.eoq.sigma_m):
                return answer.unknown("the end of the queue has no place", *answer.reasons)
            end = self._end(state.eoq, state.status is QueueStatus.BEYOND_VIEW, road)
            answer = replace(answer, end=end)
        if index is None:
            return answer
        speeds = vehicles.speed_mps[vehicles.approach == index]
        speeds = speeds[np.isfinite(speeds)]
        mean_mps = max(float(speeds.mean()), 0.0) if len(speeds) else None
        return replace(answer, speed_mps=mean_mps, vehicles_seen=len(speeds))

    def _end(self, eoq: EndOfQueue, is_bound: bool, road: Road | None) -> End:
        station_m = eoq.station_m - self._sigma_factor * max(eoq.sigma_m, 0.0)
        return End(
            station_m=station_m,
            measured_m=eoq.station_m,
            sigma_m=eoq.sigma_m,
            length_m=_finite(eoq.length_m) or 0.0,
            vehicles=int(eoq.vehicles),
            growth_mps=_finite(eoq.growth_mps),
            is_bound=is_bound,
            at=road.point(station_m) if road is not None else None,
        )


def iso(utc: datetime) -> str:
    """Return a time as RFC 3339 in UTC, to the millisecond."""
    return utc.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def headline(answer: Answer) -> str:
    """Return one sentence for people; what is not known is called unknown."""
    where = f"{answer.approach}: " if answer.approach else ""
    if answer.status is QueueStatus.CLEAR:
        return f"{where}no queue"
    end = answer.end
    if not answer.has_queue or end is None:
        return f"{where}end of queue unknown: {'; '.join(answer.reasons) or 'no reason given'}"
    lengths = f"{end.length_m:.0f} m ({end.length_m / 0.3048:.0f} ft)"
    if end.is_bound:
        return f"{where}stopped traffic, queue of at least {lengths}, its end beyond view upstream"
    return f"{where}stopped traffic, queue of {lengths}, {end.vehicles} vehicles"


def _clean(reasons: Sequence[str]) -> tuple[str, ...]:
    """Return reasons without what XML and terminals cannot hold."""
    return tuple("".join(c if c.isprintable() else " " for c in reason) for reason in reasons)


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else float(value)
