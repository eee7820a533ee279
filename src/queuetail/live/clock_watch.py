"""The clock offset of a live run, measured every quarter of a minute, in a thread of its own."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock

from queuetail.config import Site
from queuetail.live.clock_offset import ClockOffset, OffsetEstimator, offset_note
from queuetail.live.outlet import Outlet, Policy
from queuetail.live.records import OutletHealth, Published

EVERY_S = 15.0


class ClockWatch:
    """A :class:`LiveSink` that keeps the newest estimate, and warns where it is beyond doubt."""

    def __init__(self, site: Site, warn: Callable[[str, str], None]) -> None:
        """`warn` takes a warning's name and its sentence; an empty one ends it."""
        self._site, self._warn = site, warn
        self._lock = Lock()
        self._estimator: OffsetEstimator | None = None
        self._size = (0, 0)
        self._asked_s = 0.0
        self.newest = ClockOffset(None, reason="nothing was seen yet")
        self._outlet: Outlet[OffsetEstimator] = Outlet(
            "clock offset", self._estimate, policy=Policy.NEWEST
        )

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        frame, told = published.frame, published.telemetry
        if frame is None or told is None:
            return
        with self._lock:
            if self._estimator is None or frame.size != self._size:
                self._size = frame.size
                self._estimator = OffsetEstimator(*frame.size, self._site.camera)
            self._estimator.add(frame.t_s, published.observation.registration, told)
            if frame.t_s - self._asked_s < EVERY_S:
                return
            self._asked_s = frame.t_s
            self._outlet.offer(self._estimator.copy())

    def health(self) -> OutletHealth:
        """Return how measuring goes."""
        return self._outlet.health()

    def close(self) -> None:
        """Stop measuring."""
        self._outlet.close()

    def _estimate(self, estimator: OffsetEstimator) -> None:
        self.newest = estimator.estimate()
        self._warn("clock", offset_note(self.newest, self._site.telemetry.offset_s))
