"""Where a live run's answers go: each outlet has its own thread, so that none can hold up another.

An outlet that cannot deliver (a full disk, a broker that is away) tries again with growing pauses
and says so in its health; detection never waits for it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from enum import StrEnum
from fractions import Fraction
from threading import Event, Lock, Thread
from time import monotonic
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from queuetail.live.mailbox import Bounded
from queuetail.live.records import OutletHealth, OutletState, Published

if TYPE_CHECKING:
    from av.packet import Packet
    from av.stream import Stream

T = TypeVar("T")
LOG = logging.getLogger(__name__)

DRAIN_S = 2.0  # how long a closing outlet may take to deliver what waits
FAILED_AFTER_S = 30.0  # of failing without a break until "retrying" is called "failed"


class LiveSink(Protocol):
    """One consumer of a live run's answers; all its methods may be called from any thread."""

    def offer(self, published: Published) -> None:
        """Take one answer; must return at once (use an :class:`Outlet` for anything slow)."""

    def health(self) -> OutletHealth:
        """Return how delivery stands."""

    def close(self) -> None:
        """Deliver what waits, within a few seconds, and release everything."""


@dataclass(frozen=True, slots=True)
class StreamInfo:
    """One elementary stream of the incoming video, as a recorder needs it to write it again."""

    session: int  # as in Published: each connection has its own clock, perhaps its own codec
    index: int  # of the stream within the session
    kind: str  # "video" or "data" (KLV)
    codec: str  # "h264", "klv", …; empty where it is not known
    time_base: Fraction
    template: Stream  # for OutputContainer.add_stream_from_template; stays valid


class PacketSink(Protocol):
    """One consumer of the incoming packets as they are; a recorder remuxes them."""

    def packet(self, packet: Packet[Stream], stream: StreamInfo, utc: datetime) -> None:
        """Take a packet that arrived at `utc`; must return at once, in the capture's thread.

        The packet belongs to the sink from then on.
        """


class Policy(StrEnum):
    """What an outlet does when it is slower than what it is offered, or fails."""

    IN_ORDER = "in_order"  # deliver all, one after the other; the oldest are dropped when full
    NEWEST = "newest"  # only the newest matters: older ones are dropped, also those that failed


class Undeliverable(Exception):  # noqa: N818 - it says what is wrong with the item
    """Raised by a deliver function for an item that no further try would deliver."""


class Outlet(Generic[T]):
    """Delivers items in a thread of its own, with retries; ``offer`` never waits."""

    def __init__(
        self,
        name: str,
        deliver: Callable[[T], None],
        capacity: int = 256,
        *,
        policy: Policy = Policy.IN_ORDER,
        first_pause_s: float = 0.5,
        longest_pause_s: float = 30.0,
        failed_after_s: float = FAILED_AFTER_S,
        finish: Callable[[], None] | None = None,
    ) -> None:
        """Start delivering.

        `deliver` is only ever called from the outlet's own thread; any exception that it raises
        means another try after a pause, which doubles from `first_pause_s` to `longest_pause_s`.
        `finish` is called once, in the same thread, after the last delivery.
        """
        self.name = name
        self._deliver, self._finish = deliver, finish
        self._policy = policy
        self._queue: Bounded[T] = Bounded(capacity if policy is Policy.IN_ORDER else 1)
        self._pauses_s = first_pause_s, longest_pause_s
        self._failed_after_s = failed_after_s
        self._lock = Lock()
        self._delivered, self._undeliverable, self._in_hand = 0, 0, 0
        self._last_error = ""
        self._last_delivery_s: float | None = None
        self._failing_since_s: float | None = None
        self._closing = Event()
        self._abandoned = Event()
        self._thread = Thread(target=self._work, name=f"outlet {name}", daemon=True)
        self._thread.start()

    def offer(self, item: T) -> None:
        """Take an item and return at once; the oldest waiting one is dropped when full."""
        self._queue.put(item)

    def health(self) -> OutletHealth:
        """Return how delivery stands; safe from any thread."""
        with self._lock:
            now_s = monotonic()
            state = OutletState.OK
            if self._failing_since_s is not None:
                is_long = now_s - self._failing_since_s >= self._failed_after_s
                state = OutletState.FAILED if is_long else OutletState.RETRYING
            last_s = self._last_delivery_s
            return OutletHealth(
                name=self.name,
                state=state,
                delivered=self._delivered,
                dropped=self._queue.dropped + self._undeliverable,
                waiting=len(self._queue) + self._in_hand,
                last_error=self._last_error,
                delivery_age_s=None if last_s is None else now_s - last_s,
            )

    def close(self, drain_s: float = DRAIN_S) -> None:
        """Deliver what waits, for `drain_s` at most, then finish; a second call does nothing."""
        self._closing.set()
        self._queue.close()
        self._thread.join(drain_s)
        if self._thread.is_alive():
            self._abandoned.set()
            self._thread.join(drain_s)
        if self._thread.is_alive():
            LOG.warning("%s did not finish in time and was left behind", self.name)

    def _work(self) -> None:
        while (item := self._queue.take()) is not None:
            with self._lock:
                self._in_hand = 1
            self._deliver_one(item)
            with self._lock:
                self._in_hand = 0
        if self._finish is not None:
            try:
                self._finish()
            except Exception as error:  # whatever a library raises must not pass for success
                self._failed(error)

    def _deliver_one(self, item: T) -> None:
        """Try until the item is delivered, or the policy or the end lets it go."""
        pause_s, longest_s = self._pauses_s
        while not self._abandoned.is_set():
            try:
                self._deliver(item)
            except Undeliverable as error:
                with self._lock:
                    self._undeliverable += 1
                    self._last_error = one_line(error)
                return
            except Exception as error:  # an outlet outlives every fault of what it delivers to
                self._failed(error)
            else:
                self._succeeded()
                return
            if self._closing.is_set() and self._policy is Policy.NEWEST:
                break
            waited_for = self._abandoned if self._closing.is_set() else self._closing
            waited_for.wait(pause_s)
            pause_s = min(2 * pause_s, longest_s)
            if self._policy is Policy.NEWEST and (newer := self._queue.take(0)) is not None:
                item = newer
                with self._lock:
                    self._undeliverable += 1
        with self._lock:
            self._undeliverable += 1

    def _failed(self, error: Exception) -> None:
        with self._lock:
            if self._failing_since_s is None:
                self._failing_since_s = monotonic()
                LOG.warning("%s: %s; trying again", self.name, one_line(error))
            self._last_error = one_line(error)

    def _succeeded(self) -> None:
        with self._lock:
            self._delivered += 1
            self._failing_since_s = None
            self._last_delivery_s = monotonic()


def one_line(error: BaseException) -> str:
    """Return an exception as one line for a status page: its text, else its kind."""
    text = " ".join(str(error).split())
    return text or type(error).__name__
