"""The clock offset of a live run, measured every quarter of a minute, in a thread of its own."""

from __future__ import annotations

import dataclasses
from collections import deque
from collections.abc import Callable
from datetime import datetime
from threading import Lock

from queuetail.config import Site
from queuetail.live.clock_offset import WINDOW_S, ClockOffset, OffsetEstimator, offset_note
from queuetail.live.feed import site_constants
from queuetail.live.outlet import Outlet, Policy
from queuetail.live.records import OutletHealth, Published
from queuetail.telemetry.flightlog import FlightLog
from queuetail.types import TelemetrySample

EVERY_S = 15.0

Warn = Callable[[str, str], None]


@dataclasses.dataclass(frozen=True, slots=True)
class _Case:
    """All that one estimate needs; `set_s` is the offset that the samples do not yet have."""

    estimator: OffsetEstimator
    samples: tuple[TelemetrySample, ...]
    set_s: float


class ClockWatch:
    """A :class:`LiveSink` that keeps the newest estimate, and warns where it is beyond doubt.

    Telemetry counts as it was heard, where it was: what a run uses of it is older than the
    picture while nothing newer has come, which would pass for an offset.
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self._warn: Warn = lambda name, sentence: None
        self._lock = Lock()
        self._estimator: OffsetEstimator | None = None
        self._size = (0, 0)
        self._asked_s = 0.0
        self._heard: deque[TelemetrySample] = deque()
        self._used: deque[TelemetrySample] = deque()
        self.newest = ClockOffset(None, reason="nothing was seen yet")
        self._outlet: Outlet[_Case] = Outlet("clock offset", self._estimate, policy=Policy.NEWEST)

    def warn_by(self, warn: Warn) -> None:
        """Tell warnings to `warn`: a name, and a sentence that is empty when all is well again."""
        self._warn = warn

    def hear(self, sample: TelemetrySample, utc: datetime, name: str) -> None:
        """Take a sample as it arrived, for a run's `telemetry_sinks`; returns at once."""
        with self._lock:
            _keep(self._heard, sample)

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        frame, told = published.frame, published.telemetry
        if frame is None or told is None:
            return
        with self._lock:
            if self._estimator is None or frame.size != self._size:
                self._size = frame.size
                self._estimator = OffsetEstimator(*frame.size, self._site.camera)
            captured_s = published.captured_s if self._heard else frame.t_s
            self._estimator.add(
                frame.t_s if captured_s is None else captured_s, published.observation.registration
            )
            _keep(self._used, told)
            if frame.t_s - self._asked_s < EVERY_S:
                return
            self._asked_s = frame.t_s
            self._outlet.offer(self._case(self._estimator))

    def health(self) -> OutletHealth:
        """Return how measuring goes."""
        return self._outlet.health()

    def close(self) -> None:
        """Stop measuring."""
        self._outlet.close()

    def _case(self, estimator: OffsetEstimator) -> _Case:
        set_s = self._site.telemetry.offset_s if self._heard else 0.0
        return _Case(estimator.copy(), tuple(self._heard or self._used), set_s)

    def _estimate(self, case: _Case) -> None:
        log = FlightLog(case.samples, "telemetry").filled(**site_constants(self._site))
        found = case.estimator.estimate(log.at)
        if found.offset_s is not None:
            found = dataclasses.replace(found, offset_s=found.offset_s - case.set_s)
        self.newest = found
        self._warn("clock", offset_note(found, self._site.telemetry.offset_s))


def _keep(samples: deque[TelemetrySample], sample: TelemetrySample) -> None:
    samples.append(sample)
    while samples[0].t_s < sample.t_s - WINDOW_S:
        samples.popleft()
