"""Counts and times of a live run, gathered from all its threads, as one record of health."""

from __future__ import annotations

import shutil
from collections import deque
from pathlib import Path
from threading import Lock
from time import monotonic

import numpy as np
import psutil  # type: ignore[import-untyped]

from queuetail.live.feed import TelemetryFeed
from queuetail.live.records import Health, OutletHealth, OutletState
from queuetail.video.stream import StreamStatus

LATENCIES = 1000  # about a minute of answers
RATE_S = 5.0
SURVEY_S = 1.0  # how often memory, disk and percentiles are measured
LOW_DISK_MB = 500.0
BYTES_PER_MB = 1e6


class Meter:
    """Takes what happens and gives :class:`Health`; safe from any thread."""

    def __init__(self, feed: TelemetryFeed, folder: Path | None = None) -> None:
        """`folder` is the one whose disk must not fill up."""
        self._feed = feed
        self._folder = folder if folder is not None else Path.cwd()
        self._process = psutil.Process()
        self._lock = Lock()
        self._latencies_ms: deque[float] = deque(maxlen=LATENCIES)
        self._answered_s: deque[float] = deque()
        self._processed = 0
        self._registration: float | None = None
        self._faults: dict[str, str] = {}
        self._surveyed_s = -SURVEY_S
        self._survey: tuple[float | None, ...] = (None, None, None, None)

    def answered(self, arrived_s: float, registration: float) -> None:
        """Note an answer to a picture that arrived at `arrived_s`."""
        now_s = monotonic()
        with self._lock:
            self._processed += 1
            self._latencies_ms.append(1000 * (now_s - arrived_s))
            self._answered_s.append(now_s)
            while self._answered_s[0] < now_s - RATE_S:
                self._answered_s.popleft()
            self._registration = registration

    def fault(self, what: str, sentence: str = "") -> None:
        """Keep a warning under the name `what`; none takes it away."""
        with self._lock:
            self._faults.pop(what, None)
            if sentence:
                self._faults[what] = sentence

    @property
    def processed(self) -> int:
        """How many pictures were answered."""
        with self._lock:
            return self._processed

    def health(
        self, stream: StreamStatus, overwritten: int, outlets: tuple[OutletHealth, ...]
    ) -> Health:
        """Return how the run is now."""
        now_s = monotonic()
        newest = stream.newest
        ages = self._feed.ages_s(now_s)
        rates = self._feed.rates_hz(now_s)
        warnings = [*self._feed.warnings(), *stream_warnings(stream)]
        warnings += [
            f"{o.name}: {o.last_error or 'nothing is delivered'}"
            for o in outlets
            if o.state in (OutletState.RETRYING, OutletState.FAILED)
        ]
        with self._lock:
            memory_mb, disk_mb, p50_ms, p99_ms = self._surveyed(now_s)
            span_s = min(RATE_S, now_s - self._answered_s[0]) if self._answered_s else 0.0
            if disk_mb is not None and disk_mb < LOW_DISK_MB:
                warnings.append(f"only {disk_mb:.0f} MB are free on the disk")
            return Health(
                frame_age_s=None if newest is None else now_s - newest.captured_s,
                telemetry_age_s=ages,
                telemetry_rate_hz=rates,
                registration=self._registration,
                frames_captured=stream.shown + stream.skipped,
                frames_processed=self._processed,
                frames_dropped=overwritten + stream.skipped,
                reconnects=max(stream.sessions - 1, 0),
                frame_rate_hz=len(self._answered_s) / span_s if span_s > 1 else None,
                latency_p50_ms=p50_ms,
                latency_p99_ms=p99_ms,
                memory_mb=memory_mb,
                disk_free_mb=disk_mb,
                outlets=outlets,
                warnings=(*self._faults.values(), *warnings),
            )

    def _surveyed(self, now_s: float) -> tuple[float | None, ...]:
        """Return memory, disk and percentiles, measured once a second at most."""
        if now_s - self._surveyed_s >= SURVEY_S:
            self._surveyed_s = now_s
            p50_ms = p99_ms = None
            if self._latencies_ms:
                p50_ms, p99_ms = np.percentile(self._latencies_ms, [50, 99]).tolist()
            try:
                disk_mb = shutil.disk_usage(self._folder).free / BYTES_PER_MB
            except OSError:
                disk_mb = None
            memory_mb = self._process.memory_info().rss / BYTES_PER_MB
            self._survey = memory_mb, disk_mb, p50_ms, p99_ms
        return self._survey


def stream_warnings(stream: StreamStatus) -> list[str]:
    """Say what is wrong with the pictures."""
    found = [stream.reason] if stream.reason else []
    if stream.damaged:
        found.append(f"{stream.damaged} pictures came damaged and were left out")
    return found
