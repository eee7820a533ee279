"""The companion computer's main loop: what the sensors say, onto the radio, as much as fits."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from queuetail.link.height import HeightFinder
from queuetail.link.messages import (
    ClockSource,
    ClockTime,
    Height,
    Lidar,
    Quantity,
    Rate,
    Sensors,
)
from queuetail.link.scheduler import RateScheduler
from queuetail.onboard.ports import SerialPort
from queuetail.onboard.source import FIRST_PAUSE_S, LONGEST_PAUSE_S, Source, Stamp

TICK_S = 0.005
STATUS_S = 1.0
GPS_TIME_S = 5.0  # after so long without the flight controller's UTC, our own clock is told
FULL_BYTES = 128  # of ours in the driver's queue: the radio does not keep up


@dataclass(frozen=True, slots=True)
class Sent:
    """What went over the radio."""

    frames: int
    sent_bytes: int
    rates: tuple[Rate, ...]  # of the last seconds
    refused: int
    radio_reconnects: int


class Sender:
    """Joins the sources to the radio; it survives the loss of each of them."""

    def __init__(
        self,
        sources: Sequence[Source],
        lidar: Source | None,
        open_radio: Callable[[], SerialPort],
        baud: int,
        tell: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self._sources = [*sources, *([lidar] if lidar is not None else [])]
        self._lidar = lidar
        self._open_radio = open_radio
        self._tell = tell
        self._scheduler = RateScheduler(baud)
        self._height = HeightFinder()
        self._lock = threading.Lock()
        self._gps_time_s = -GPS_TIME_S
        self._frames = self._bytes = 0
        self._opened = 0
        self._next_try_s = 0.0
        self._pause_s = FIRST_PAUSE_S
        self._heard: dict[str, bool] = {}
        self._missed: set[str] = set()  # names of sources said not to be there

    def run(self, stopping: threading.Event, duration_s: float | None = None) -> Sent:
        """Send until `stopping`, the duration's end, or the end of every source."""
        started_s = time.monotonic()
        for source in self._sources:
            is_second = self._lidar not in (None, source)
            source.start(self._deliver_flight if is_second else self._deliver)
        radio: SerialPort | None = None
        status_s = 0.0
        try:
            while not stopping.wait(TICK_S):
                now_s = time.monotonic()
                if duration_s is not None and now_s - started_s >= duration_s:
                    break
                if all(source.has_ended for source in self._sources):
                    break
                if now_s - status_s >= STATUS_S:
                    status_s = now_s
                    self._once_a_second(now_s)
                radio = self._try_radio(now_s) if radio is None else self._send(radio, now_s)
        finally:
            for source in self._sources:
                source.stop()
            if radio is not None:
                radio.close()
        return self.sent

    @property
    def sent(self) -> Sent:
        """What was sent so far."""
        with self._lock:
            status = self._scheduler.status(time.monotonic(), Sensors.NONE)
            refused = self._scheduler.refused
        reconnects = max(self._opened - 1, 0)
        return Sent(self._frames, self._bytes, status.rates, refused, reconnects)

    def _deliver(self, quantity: Quantity, stamp: Stamp) -> None:
        """Take a reading, from any source's thread."""
        with self._lock:
            if isinstance(quantity, ClockTime) and quantity.source is ClockSource.GPS:
                self._gps_time_s = stamp.arrived_s
            if not isinstance(quantity, Height):
                self._scheduler.offer(quantity, stamp.measured_s)
            height = self._height.add(quantity, stamp.measured_s)
            if height is not None:
                self._scheduler.offer(height, stamp.measured_s)

    def _deliver_flight(self, quantity: Quantity, stamp: Stamp) -> None:
        """Take a flight controller's reading where a lidar of our own replaces its rangefinder."""
        if not isinstance(quantity, Lidar):
            self._deliver(quantity, stamp)

    def _once_a_second(self, now_s: float) -> None:
        sensors = Sensors.NONE
        for source in self._sources:
            is_heard = source.state.is_heard
            if is_heard:
                is_lidar = source is self._lidar
                sensors |= Sensors.LIDAR if is_lidar else Sensors.FLIGHT_CONTROLLER
            if is_heard != self._heard.get(source.name, False):
                self._heard[source.name] = is_heard
                self._missed.add(source.name)
                why = source.state.error
                self._tell(
                    f"{source.name}: {'heard' if is_heard else 'lost'}{f' ({why})' if why else ''}"
                )
            elif source.state.error and source.name not in self._missed:
                self._missed.add(source.name)
                self._tell(f"{source.name}: not heard ({source.state.error}); trying again")
        with self._lock:
            if now_s - self._gps_time_s > GPS_TIME_S:
                own = ClockTime(time.time(), ClockSource.COMPANION)
                self._scheduler.offer(own, time.monotonic())
            self._scheduler.offer(self._scheduler.status(now_s, sensors), now_s)

    def _try_radio(self, now_s: float) -> SerialPort | None:
        if now_s < self._next_try_s:
            return None
        try:
            radio = self._open_radio()
        except OSError as error:
            if self._pause_s == FIRST_PAUSE_S:
                self._tell(f"the radio cannot be opened ({error}); trying again")
            self._next_try_s = now_s + self._pause_s
            self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
            return None
        self._opened += 1
        self._pause_s = FIRST_PAUSE_S
        self._tell("the radio is open")
        return radio

    def _send(self, radio: SerialPort, now_s: float) -> SerialPort | None:
        """Send what is due; return None when the radio is gone."""
        try:
            if radio.waiting_bytes > FULL_BYTES:
                with self._lock:
                    self._scheduler.line_blocked(now_s)
                return radio
            with self._lock:
                frame = self._scheduler.next_frame(now_s)
            if frame is not None:
                radio.write(frame)
                self._frames += 1
                self._bytes += len(frame)
        except OSError as error:
            self._tell(f"the radio is lost ({error}); trying again")
            radio.close()
            return None
        return radio


def header_rates(sent: Sent) -> str:
    """Return the rates in one line, for a user."""
    return ", ".join(f"{rate.header} {rate.sent_hz:.1f}/s" for rate in sent.rates)
