"""The ground's end of the telemetry link: frames from a serial radio."""

from __future__ import annotations

import time
from dataclasses import asdict

from queuetail.link.frames import Counts, Decoder, Message
from queuetail.link.messages import ClockSource, ClockTime
from queuetail.link.scheduler import BITS_PER_BYTE
from queuetail.onboard.ports import SerialPort, split_device
from queuetail.onboard.source import Source

BAUD = 9600
FAR_FROM_NOW_S = 3_600.0  # a companion's own clock that is further off was never set
READ_S = 0.02  # short, so that a frame's arrival is known to a few of its bytes


class RadioSource(Source):
    """Hears the link's frames on DEVICE[:BAUD]."""

    def __init__(self, spec: str) -> None:
        self._device, self._baud = split_device(spec, BAUD)
        super().__init__(f"radio {self._device}")
        self._decoder = Decoder()

    @property
    def losses(self) -> dict[str, int]:
        """What the decoder counted so far, by name."""
        return asdict(self.counts)

    @property
    def counts(self) -> Counts:
        """What the decoder counted so far."""
        return self._decoder.counts

    def _session(self) -> bool:
        port = SerialPort(self._device, self._baud, READ_S)
        try:
            while not self._stopping.is_set():
                data = port.read()
                arrived_s = time.monotonic()
                for message in self._decoder.feed(data) if data else ():
                    self._take(message, arrived_s)
        finally:
            port.close()
        return True

    def _take(self, message: Message, arrived_s: float) -> None:
        quantity = message.quantity
        transit_s = message.size * BITS_PER_BYTE / self._baud
        if isinstance(quantity, ClockTime) and not _is_believable(quantity):
            return
        self._tick(message.sent_s, arrived_s, None, transit_s)
        self._hear(quantity, arrived_s, message.sent_s)


def _is_believable(told: ClockTime) -> bool:
    is_near = abs(told.utc_s - time.time()) <= FAR_FROM_NOW_S
    return told.source is ClockSource.GPS or is_near
