"""A live stream that is kept up: read in a thread of its own, opened again whenever it breaks."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from threading import Event, Lock, Thread
from time import monotonic

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.stream import Stream

from queuetail.errors import InputError
from queuetail.live.outlet import StreamInfo
from queuetail.video.stream_clock import StreamClock
from queuetail.video.stream_process import SrtProcess, find_ffmpeg
from queuetail.video.stream_session import Captured, Counts, Metadata, Session
from queuetail.video.stream_source import Kind, StreamSource

LOG = logging.getLogger(__name__)

# Growing pauses, but short ones: the picture must be back 2 s after the source is.
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 1.0
PATIENCE_S = 5.0  # of the one who closes, until the thread is left to itself
FELL_BEHIND_S = 1.0  # a paced file that is later than this goes on from here

PacketTaker = Callable[["Packet[Stream]", StreamInfo, datetime], None]


class Link(StrEnum):
    """How the connection stands."""

    CONNECTING = "connecting"
    OPEN = "open"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class StreamStatus:
    """How a stream stands, for health pages and for the reason of an unknown state."""

    link: Link
    reason: str  # one sentence on what is missing; empty while pictures come
    newest: Captured | None = None
    sessions: int = 0  # connections that gave pictures
    shown: int = 0
    skipped: int = 0
    damaged: int = 0
    out_of_order: int = 0
    lateness_s: float = 0.0


class LiveVideo:
    """Gives every picture of a live source to `deliver`, in a thread that never waits for others.

    `deliver`, `metadata` and the packet sinks are called in that thread and must return at once.
    """

    def __init__(
        self,
        source: StreamSource,
        deliver: Callable[[Captured], None],
        metadata: Callable[[Metadata], None] = lambda found: None,
        packet_sinks: tuple[PacketTaker, ...] = (),
    ) -> None:
        """Prepare; raises InputError where a program is missing."""
        if source.kind is Kind.SRT:
            find_ffmpeg()
        self._source, self._deliver, self._metadata = source, deliver, metadata
        self._packet_sinks = packet_sinks
        self._clock, self._counts = StreamClock(), Counts()
        self._closing = Event()
        self._lock = Lock()
        self._status = StreamStatus(Link.CONNECTING, f"connecting to {source.name}")
        self._process: SrtProcess | None = None
        self._sessions = 0
        self._thread = Thread(target=self._work, name="capture", daemon=True)

    def start(self) -> None:
        """Begin reading."""
        self._thread.start()

    def close(self) -> None:
        """Stop reading; returns after a few seconds at most."""
        self._closing.set()
        with self._lock:
            process = self._process
        if process is not None:
            process.stop()
        if self._thread.ident is not None:
            self._thread.join(PATIENCE_S)

    def status(self) -> StreamStatus:
        """Return how the stream stands; safe from any thread."""
        with self._lock:
            return self._status

    def _work(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._closing.is_set():
            before = self._sessions
            why, is_silent = self._connect()
            if self._source.kind is Kind.FILE and not self._source.is_looping:
                self._tell(Link.ENDED, why or f"{self._source.name} has ended")
                return
            if why:
                LOG.info("%s; trying again", why)
            self._tell(Link.CONNECTING, why or f"{self._source.name} stopped sending")
            if self._sessions > before:
                pause_s = FIRST_PAUSE_S
            if (is_silent and self._source.is_listening) or (self._source.is_looping and not why):
                continue
            self._closing.wait(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _connect(self) -> tuple[str, bool]:
        """Read until the connection ends; return why, and whether nothing came in time."""
        source = self._source
        try:
            with ExitStack() as closing:
                container = self._open(closing)
                self._clock.begin()
                self._read(container)
        except InputError as error:
            return str(error), False
        except (av.error.ExitError, TimeoutError):
            return f"{source.name} sends nothing", True
        except (FFmpegError, OSError) as error:
            return f"{source.name}: {_words(error)}", False
        except ValueError as error:
            return f"{source.name}: {error}", False
        return "", False

    def _open(self, closing: ExitStack) -> InputContainer:
        source = self._source
        address = source.address
        if source.kind is Kind.SRT:
            process = closing.enter_context(SrtProcess(address))
            with self._lock:
                self._process = process
            closing.callback(self._forget_process)
            address = process.url
        container = av.open(
            address,
            format=source.container_format,
            options=source.options,
            timeout=(source.open_s, source.read_s),
        )
        closing.callback(container.close)
        return container

    def _forget_process(self) -> None:
        with self._lock:
            self._process = None

    def _read(self, container: InputContainer) -> None:
        source = self._source
        is_paced = source.kind is Kind.FILE or (
            source.kind is Kind.HTTP and (container.duration or container.format.name == "hls")
        )
        session = Session(
            container,
            self._sessions + 1,
            self._clock,
            self._counts,
            self._packet_sinks,
            Pace(self._closing) if is_paced else None,
        )
        is_first = True
        for item in session.items():
            if self._closing.is_set():
                return
            if isinstance(item, Metadata):
                self._metadata(item)
                continue
            if is_first:
                self._sessions, is_first = self._sessions + 1, False
            self._note(item)
            self._deliver(item)

    def _note(self, newest: Captured) -> None:
        counts = self._counts
        with self._lock:
            self._status = StreamStatus(
                link=Link.OPEN,
                reason="",
                newest=newest,
                sessions=self._sessions,
                shown=counts.shown,
                skipped=counts.skipped,
                damaged=counts.damaged,
                out_of_order=counts.out_of_order,
                lateness_s=self._clock.lateness_s,
            )

    def _tell(self, link: Link, reason: str) -> None:
        with self._lock:
            self._status = replace(self._status, link=link, reason=reason)


class Pace:
    """Holds a file back to the speed at which it was taken."""

    def __init__(self, closing: Event) -> None:
        self._closing = closing
        self._start_s: float | None = None

    def __call__(self, media_s: float) -> None:
        """Wait until `media_s` seconds have passed since the first call with 0."""
        now_s = monotonic()
        if self._start_s is None or now_s - self._start_s - media_s > FELL_BEHIND_S:
            self._start_s = now_s - media_s
        self._closing.wait(max(self._start_s + media_s - now_s, 0.0))


def _words(error: Exception) -> str:
    """Return FFmpeg's own words for a fault, without the address, which may hold a password."""
    return str(getattr(error, "strerror", None) or type(error).__name__)
