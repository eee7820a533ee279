"""What every source of telemetry is: a thread that reads, reconnects, and stamps what it hears."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from queuetail.link.clock import ClockEstimate, UtcEstimate
from queuetail.link.messages import ClockTime, Quantity

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 5.0
POLL_S = 0.2  # the longest that a read may block, so that stopping is quick
SILENT_S = 3.0  # a source that says nothing for longer counts as lost


@dataclass(frozen=True, slots=True)
class Stamp:
    """When a quantity was measured and when it came, on this machine's monotonic clock."""

    measured_s: float
    arrived_s: float
    utc_s: float | None = None  # of the measurement, in seconds since 1970, where the sender knows


Deliver = Callable[[Quantity, Stamp], None]


@dataclass(frozen=True, slots=True)
class SourceState:
    """How a source stands: heard lately or not, how often it came back, and what went wrong."""

    name: str
    is_heard: bool
    quantities: int
    reconnects: int
    error: str


class Source(ABC):
    """One source of telemetry in its own thread; it never gives up by itself."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._deliver: Deliver = lambda quantity, stamp: None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._clocks: dict[Hashable, ClockEstimate] = {}
        self._utc = UtcEstimate()
        self._utc_clock: ClockEstimate | None = None  # that UTC was told for
        self._heard_s: float | None = None
        self._quantities = 0
        self._sessions = 0
        self._error = ""

    def start(self, deliver: Deliver) -> None:
        """Start reading; `deliver` is called from the source's own thread."""
        self._deliver = deliver
        self._thread = threading.Thread(target=self._run, name=f"source {self.name}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Stop reading and wait for the thread to end."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(timeout=10 * POLL_S)

    @property
    def state(self) -> SourceState:
        """How the source stands now."""
        heard_s = self._heard_s
        is_heard = heard_s is not None and time.monotonic() - heard_s <= SILENT_S
        return SourceState(
            self.name, is_heard, self._quantities, max(self._sessions - 1, 0), self._error
        )

    @property
    def has_ended(self) -> bool:
        """Whether there is nothing more to come, as at the end of a simulated flight."""
        return self._thread is not None and not self._thread.is_alive()

    @abstractmethod
    def _session(self) -> bool:
        """Open and read until `_stopping` or an error; return False where all was read."""

    def _run(self) -> None:
        pause_s = FIRST_PAUSE_S
        while not self._stopping.is_set():
            before = self._quantities
            self._sessions += 1
            try:
                if not self._session():
                    return
                self._error = ""
            except Exception as error:  # one sensor's fault must not end the others' telemetry
                self._error = str(error) or type(error).__name__
            if self._quantities > before:
                pause_s = FIRST_PAUSE_S
            self._stopping.wait(pause_s)
            pause_s = min(2 * pause_s, LONGEST_PAUSE_S)

    def _hear(
        self,
        quantity: Quantity,
        arrived_s: float,
        sent_s: float | None = None,
        clock: Hashable = None,
    ) -> None:
        """Stamp a quantity and pass it on; `sent_s` is a time of the sender's clock `clock`."""
        measured_s = arrived_s
        if sent_s is not None:
            measured_s = min(self._clocks[clock].received_s(sent_s) or arrived_s, arrived_s)
            if isinstance(quantity, ClockTime):
                self._utc.add(sent_s, quantity.utc_s)
                self._utc_clock = self._clocks[clock]
        utc_s = None
        if self._utc_clock is not None:  # a gimbal's own clock may differ from the one with UTC
            utc_s = self._utc.utc_s(measured_s - (self._utc_clock.offset_s or 0.0))
        self._heard_s = arrived_s
        self._quantities += 1
        self._error = ""
        self._deliver(quantity, Stamp(measured_s, arrived_s, utc_s))

    def _tick(
        self, sent_s: float, arrived_s: float, clock: Hashable = None, transit_s: float = 0.0
    ) -> None:
        """Take a message's time stamp for the estimate of the sender's clock."""
        self._clocks.setdefault(clock, ClockEstimate()).add(sent_s, arrived_s, transit_s)
