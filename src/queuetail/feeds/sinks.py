"""The live sinks that all feeds are made of: each with its own outlet, none ever waited for."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from time import monotonic
from typing import Any, Generic, Protocol, TypeVar

from queuetail.feeds.answers import Answer, Reader
from queuetail.feeds.episodes import Notice, Report, Step
from queuetail.live.outlet import DRAIN_S, Outlet, Policy, Undeliverable
from queuetail.live.records import OutletHealth, OutletState, Published

LONGEST_PAUSE_S = 10.0  # between tries: drivers do not wait half a minute for a broker
REBUILT_S = 0.2  # a document without a newer answer may be older than it says by so much
CAPACITY = 1000  # changes that a receiver may be away for
T = TypeVar("T", Report, Notice)
T_co = TypeVar("T_co", Report, Notice, covariant=True)


class Book(Protocol[T_co]):
    """What decides when a feed speaks: a Reporter or a NoticeBook."""

    def take(self, answers: Sequence[Answer], now_s: float) -> tuple[T_co, ...]:
        """Return what the newest answers ask for."""

    def end(self, now_s: float, utc: datetime) -> tuple[T_co, ...]:
        """Return the last words."""


class PushSink(Generic[T]):
    """A live sink that delivers reports or notices in order; it ends with its book's last words."""

    def __init__(
        self,
        name: str,
        reader: Reader,
        book: Book[T],
        deliver: Callable[[T], None],
        finish: Callable[[], None] | None = None,
        capacity: int = CAPACITY,
    ) -> None:
        """Start; `deliver` and `finish` are called from the outlet's thread only."""
        self._reader = reader
        self._book: Book[T] = book
        self._lock = Lock()
        self._utc: datetime | None = None
        self._is_closed = False
        self._outlet: Outlet[T] = Outlet(
            name, deliver, capacity, longest_pause_s=LONGEST_PAUSE_S, finish=finish
        )

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        with self._lock:
            if self._is_closed:
                return
            answers = self._reader.read(published)
            if answers:
                self._utc = answers[0].utc
            items = self._book.take(answers, monotonic())
        for item in items:
            self._outlet.offer(item)

    def health(self) -> OutletHealth:
        """Return how delivery stands."""
        return self._outlet.health()

    def close(self) -> None:
        """Say that nothing is known from now on, within a few seconds, and stop."""
        with self._lock:
            last = () if self._is_closed else self._book.end(monotonic(), self._utc or _now())
            self._is_closed = True
        for item in last:
            self._outlet.offer(item)
        close_outlet(self._outlet)


def close_outlet(outlet: Outlet[Any]) -> None:
    """Close an outlet; one whose receiver is away anyway gets no time for last words."""
    well = outlet.health().state is OutletState.OK
    outlet.close(DRAIN_S if well else DRAIN_S / 10)


def notice_delivery(send: Callable[[Notice], None]) -> Callable[[Notice], None]:
    """Return a delivery of notices that lets go of what is no longer true, and of what it cancels.

    A receiver that was away is not told of a queue that nobody has seen for long.
    """
    told: set[str] = set()

    def deliver(notice: Notice) -> None:
        if notice.step is Step.CANCEL:
            if notice.id in told:
                send(notice)
                told.discard(notice.id)
            return
        if monotonic() >= notice.expires_s:
            raise Undeliverable("a message expired before it could be delivered")
        told.add(notice.id)  # whether it came through is not known when sending fails
        send(notice)

    return deliver


@dataclass(frozen=True, slots=True)
class Document:
    """What is served at one path."""

    content_type: str
    body: bytes


class Pages(Protocol):
    """What makes a document of the newest answers."""

    content_type: str

    def take(self, answers: Sequence[Answer], now_s: float) -> bool:
        """Take the newest answers; true when a file of the document should be written now."""

    def build(self, now_s: float, utc: datetime) -> bytes:
        """Return the document as it is true now."""

    def end(self, now_s: float, utc: datetime) -> None:
        """Know nothing from now on."""


class PageSink:
    """A live sink that keeps a document current: served when asked for, and perhaps in a file."""

    def __init__(self, name: str, reader: Reader, pages: Pages, file: Path | None = None) -> None:
        """Start with a document that knows nothing."""
        self._name, self._reader, self._pages = name, reader, pages
        self._lock = Lock()
        self._utc: datetime | None = None
        self._served = 0
        self._built: tuple[float, Document] | None = None
        self._is_closed = False
        self._outlet: Outlet[Path] | None = None
        self._file = file
        if file is not None:
            self._outlet = Outlet(
                name, self._write, policy=Policy.NEWEST, longest_pause_s=LONGEST_PAUSE_S
            )

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        with self._lock:
            if self._is_closed:
                return
            now_s = monotonic()
            answers = self._reader.read(published)
            if answers:
                self._utc = answers[0].utc
            is_due = self._pages.take(answers, now_s)
            self._built = None
        if is_due and self._outlet is not None and self._file is not None:
            self._outlet.offer(self._file)

    def document(self) -> Document:
        """Return the document as it is true now; safe from any thread.

        However often it is asked for, it is built a few times for each answer at most.
        """
        with self._lock:
            now_s = monotonic()
            self._served += 1
            if self._built is None or now_s - self._built[0] > REBUILT_S:
                body = self._pages.build(now_s, self._utc or _now())
                self._built = now_s, Document(self._pages.content_type, body)
            return self._built[1]

    def health(self) -> OutletHealth:
        """Return how the file stands, or how often the document was asked for."""
        if self._outlet is not None:
            return self._outlet.health()
        return OutletHealth(self._name, OutletState.OK, delivered=self._served)

    def close(self) -> None:
        """Know nothing from now on, and write that down."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            self._pages.end(monotonic(), self._utc or _now())
            self._built = None
        if self._outlet is not None and self._file is not None:
            self._outlet.offer(self._file)
            close_outlet(self._outlet)

    def _write(self, file: Path) -> None:
        """Replace the file as a whole, so that no reader sees half of one."""
        with self._lock:
            body = self._pages.build(monotonic(), self._utc or _now())
        part = file.with_name(f".{file.name}.part")
        part.write_bytes(body)
        os.replace(part, file)


def _now() -> datetime:
    return datetime.now(UTC)
