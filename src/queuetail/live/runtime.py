"""A live run: capture, telemetry, processing and outlets apart, joined by single slots.

A watchdog says "unknown" about twice a second, with the reason, whenever no answer came for a
second: because no picture comes, or because processing hangs.
"""

from __future__ import annotations

import logging
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Lock, Thread
from time import monotonic

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.live.feed import Heard, TelemetryFeed
from queuetail.live.mailbox import Mailbox
from queuetail.live.meter import Meter
from queuetail.live.outlet import LiveSink, one_line
from queuetail.live.processing import Answer, Processor
from queuetail.live.records import Health, Published
from queuetail.presets import DEFAULT_PRESET, PRESETS, Build
from queuetail.types import Observation, TelemetrySample
from queuetail.video.stream import Link, LiveVideo, PacketTaker, StreamStatus
from queuetail.video.stream_session import Captured
from queuetail.video.stream_source import StreamSource

LOG = logging.getLogger(__name__)

STALL_S = 1.0  # without an answer until the state is called unknown
BLIND_EVERY_S = 0.5
WATCH_EVERY_S = 0.1
PATIENCE_S = 3.0  # of stop, until a step that hangs is left behind


class LiveRun:
    """One live run; ``start``, ``subscribe`` and ``stop`` may be called from any thread."""

    def __init__(
        self,
        source: StreamSource,
        feed: TelemetryFeed,
        site: Site | None = None,
        preset: str = DEFAULT_PRESET,
        *,
        packet_sinks: tuple[PacketTaker, ...] = (),
        telemetry_sinks: tuple[Heard, ...] = (),
        folder: Path | None = None,
        build: Build | None = None,
    ) -> None:
        """Prepare a run of `source`; nothing is opened before :meth:`start`.

        `packet_sinks` get the incoming packets as they are, `telemetry_sinks` the samples;
        `folder` is the one whose disk is watched; `build` replaces the preset.  Raises InputError
        where a program is missing.
        """
        self._telemetry_sinks = telemetry_sinks
        self._site = site or Site()
        self.source, self.feed, self.preset = source, feed, preset
        self._meter = Meter(feed, folder)
        self._frames: Mailbox[Captured] = Mailbox()
        self._video = LiveVideo(source, self._frames.put, feed.take, packet_sinks)
        self._processor = Processor(
            self._frames,
            feed,
            self._site,
            build or PRESETS[preset],
            self._answered,
            self._meter.fault,
        )
        self._lock = Lock()  # guards the sinks and the order of answers
        self._sinks: tuple[LiveSink, ...] = ()
        self._number = 0
        self._last_t_s = 0.0
        self._newest: Published | None = None
        self._started_s = monotonic()
        self._answered_s = monotonic()
        self._closing, self.ended = Event(), Event()
        self._watchdog = Thread(target=self._watch, name="watchdog", daemon=True)

    def subscribe(self, sink: LiveSink) -> None:
        """Give every answer from now on to `sink`, which is closed when the run stops."""
        with self._lock:
            self._sinks = (*self._sinks, sink)

    def start(self) -> None:
        """Begin; returns at once."""
        self._started_s = self._answered_s = monotonic()
        self.feed.start(self._heard)
        self._processor.start()
        self._video.start()
        self._watchdog.start()

    def stop(self) -> None:
        """End everything in order, within seconds; a second call does nothing."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._video.close()
        self._processor.close(PATIENCE_S)
        self.feed.close()
        if self._watchdog.ident is not None:
            self._watchdog.join(PATIENCE_S)
        for sink in self._sinks:
            try:
                sink.close()
            except Exception as error:  # the others are to be closed all the same
                LOG.warning("%s", one_line(error))
        self.ended.set()

    def adjust(self, site: Site) -> None:
        """Go on with other settings: the method begins anew at the next picture.

        Raises InputError, and changes nothing, where they do not fit the pictures.
        """
        self._processor.adjust(site)
        self.feed.adjust(site)
        self._site = site

    @property
    def refused(self) -> InputError | None:
        """What is wrong with the site file, where that shows only with the first picture."""
        return self._processor.refused

    def newest(self) -> Published | None:
        """Return the last answer."""
        with self._lock:
            return self._newest

    def health(self) -> Health:
        """Return how the run is now."""
        with self._lock:
            sinks = self._sinks
        return self._meter.health(
            self._video.status(), self._frames.dropped, tuple(s.health() for s in sinks)
        )

    def warn(self, name: str, sentence: str) -> None:
        """Keep a warning in the health under a name; an empty sentence takes it away."""
        self._meter.fault(name, sentence)

    def _heard(self, sample: TelemetrySample, utc: datetime, name: str) -> None:
        """Pass telemetry on to those who record it."""
        for take in self._telemetry_sinks:
            take(sample, utc, name)

    def _answered(self, answer: Answer) -> None:
        self._meter.answered(answer.captured.arrived_s, answer.observation.registration.quality)
        self._publish(answer.observation, answer.captured.utc, answer)

    def _publish(
        self,
        observation: Observation,
        utc: datetime,
        answer: Answer | None = None,
        session: int = 0,
    ) -> None:
        """Give an answer to all sinks, unless a later one was given meanwhile."""
        health = self.health()
        with self._lock:
            if answer is not None:
                if observation.t_s < self._last_t_s:
                    return  # the watchdog has spoken for a later picture
                self._answered_s = monotonic()
            self._last_t_s = max(observation.t_s, self._last_t_s)
            self._number += 1
            published = Published(
                number=self._number,
                utc=utc,
                frame=answer.captured.frame if answer else None,
                observation=observation,
                health=health,
                telemetry=answer.telemetry if answer else None,
                session=answer.captured.session if answer else session,
                pts_s=answer.captured.pts_s if answer else None,
                captured_s=answer.captured.captured_s if answer else None,
                doubts=answer.doubts if answer else (),
            )
            self._newest = published
            for sink in self._sinks:
                try:
                    sink.offer(published)
                except Exception as error:  # a sink's fault is its own
                    LOG.warning("%s", one_line(error))

    def _watch(self) -> None:
        said_s = 0.0
        while not self._closing.wait(WATCH_EVERY_S):
            status = self._video.status()
            now_s = monotonic()
            if self.refused is not None or status.link is Link.ENDED:
                self.ended.set()
                if status.link is Link.ENDED and self.refused is None:
                    continue
                return
            with self._lock:
                quiet_s = now_s - self._answered_s
            reason = self._why_quiet(status, now_s) if quiet_s > STALL_S else ""
            self._meter.fault("answers", reason)
            if reason and now_s - said_s >= BLIND_EVERY_S - WATCH_EVERY_S / 2:
                said_s = now_s
                t_s = self._blind_t_s(status, now_s)
                self._publish(
                    self._processor.blind(t_s, reason), datetime.now(UTC), session=status.sessions
                )

    def _why_quiet(self, status: StreamStatus, now_s: float) -> str:
        """Return why no answer comes."""
        newest = status.newest
        if newest is None:
            waited_s = now_s - self._started_s
            return f"no picture yet after {waited_s:.0f} s: {status.reason or 'none came'}"
        age_s = now_s - newest.captured_s
        if age_s > STALL_S:
            return f"no picture for {age_s:.1f} s: {status.reason or 'the stream stands still'}"
        busy_s = self._processor.busy_s()
        if busy_s > STALL_S:
            return f"processing has been stuck for {busy_s:.1f} s"
        return "answers come too late to be believed: processing is too slow"

    def _blind_t_s(self, status: StreamStatus, now_s: float) -> float:
        """Return the time of an answer without a picture: real time after the newest one's."""
        newest = status.newest
        if newest is None:
            return 0.0
        return newest.frame.t_s + max(now_s - newest.captured_s, 0.0)
