"""The LightWare LW20/C rangefinder on a serial line: polled, woken up, reopened when unplugged.

Source: LightWare's LW20 serial commands (115200 8N1, ASCII); its first command after power-up only
selects the serial interface and gets no answer.
"""

from __future__ import annotations

import re
import time

from queuetail.link.messages import Lidar
from queuetail.onboard.ports import SerialPort
from queuetail.onboard.source import Source

BAUD = 115_200
WAKE_UP = b"www\r\n"
PRODUCT = b"?P\r\n"
# The last return first: what hangs or drives between drone and ground answers earlier.
QUERIES = (b"?LDL,2\r\n", b"?LDF,0\r\n")
ANSWER = re.compile(rb"ld[fl],(\d+):\s*(-?\d+(?:\.\d+)?)", re.IGNORECASE)
PRODUCT_ANSWER = re.compile(rb"p:\s*([^\r\n]+)", re.IGNORECASE)
LOST_SIGNAL_M = (130.0, 160.0, 230.0, 250.0)  # what the models say instead of a range
PERIOD_S = 0.05
ANSWER_S = 0.5  # without an answer for so long the next query is tried, and the device woken
GIVE_UP_S = 3.0  # without an answer for so long the port is opened anew
LONGEST_LINE = 200


def range_of(answer: bytes) -> Lidar | None:
    """Return the range in an answer line, without one where the signal is lost; None if it is none.

    Shape of an answer: ``ldf,0:61.42`` in metres.
    """
    match = ANSWER.search(answer)
    if match is None:
        return None
    range_m = float(match[2])
    is_lost = range_m <= 0 or range_m >= LOST_SIGNAL_M[0]  # the LW20/C reaches 100 m
    return Lidar(None if is_lost else range_m)


class LidarSource(Source):
    """Polls an LW20/C twenty times a second."""

    def __init__(self, device: str, baud: int = BAUD) -> None:
        super().__init__(f"lidar {device}")
        self._device, self._baud = device, baud
        self.product = ""

    def _session(self) -> bool:
        port = SerialPort(self._device, self._baud, PERIOD_S)
        try:
            port.write(WAKE_UP)
            port.write(PRODUCT)
            self._poll(port)
        finally:
            port.close()
        return True

    def _poll(self, port: SerialPort) -> None:
        line = b""
        query = 0
        asked_s = -1.0
        answered_s = tried_s = time.monotonic()
        while not self._stopping.is_set():
            now_s = time.monotonic()
            if now_s - answered_s > GIVE_UP_S:
                raise TimeoutError("it does not answer; check its cable and that it is an LW20/C")
            if now_s - max(answered_s, tried_s) > ANSWER_S:
                query = (query + 1) % len(QUERIES)
                tried_s = now_s
                port.write(WAKE_UP)
            if now_s - asked_s >= PERIOD_S:
                port.write(QUERIES[query])
                asked_s = now_s
            *lines, line = (line + port.read()).split(b"\n")
            line = line[-LONGEST_LINE:]
            arrived_s = time.monotonic()
            for answer in lines:
                lidar = range_of(answer)
                if lidar is not None:
                    answered_s = arrived_s
                    self._hear(lidar, arrived_s)
                elif (product := PRODUCT_ANSWER.search(answer)) is not None:
                    self.product = product[1].decode("ascii", "replace").strip()
