"""Time in a live stream: the pictures' own times, laid on the clock by which they arrive.

Between two pictures their own times (PTS) count, so that jitter of the network never becomes an
error of speed.  Where a picture was taken on the arrival clock is told by the packets that came
with the least delay of late: a minimum filter, as NTP uses for its samples (RFC 5905, 10).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

WINDOW_S = 30.0  # in which the least delay counts: 50 ppm of drift are 1.5 ms meanwhile
BUCKET_S = 1.0
BEHIND_S = 0.3  # later than the quickest packets by this: we lag, unless we wait for data
FAR_BEHIND_S = 1.0
SHIFTED_AFTER_S = 0.5  # of packets that stay as late: the source's clock stood still meanwhile
CATCHING_UP = 0.9  # of the lateness at first; less says that the network is catching up
BACK_S, LEAP_S = 0.5, 5.0  # beyond these the source's clock jumped


@dataclass(frozen=True, slots=True)
class Stamp:
    """When a picture was taken: seconds after the run's first, and on the arrival clock."""

    t_s: float
    captured_s: float


class StreamClock:
    """The time of one run's pictures, over all its connections."""

    def __init__(self) -> None:
        self._least: deque[tuple[float, float]] = deque()  # (bucket's start, least arrival − PTS)
        self._base_s: float | None = None  # t_s − PTS of this connection
        self._last: tuple[float, float] | None = None  # t_s and captured_s of the last picture
        self._packet: tuple[float, float] | None = None  # (DTS, arrival) of the last packet
        self._late: tuple[float, float] | None = None  # since when, and how late then
        self._shifted_s = 0.0  # that the source's clock is taken to have stood still
        self._shifted_delay_s = 0.0  # arrival − PTS with which that is so
        self._is_shift_wrong = False  # packets came earlier since
        self._returned_s = 0.0  # of it, taken back since the last picture
        self._starved_s = -math.inf  # when we last waited for data
        self.lateness_s = 0.0  # of the last packet, against the quickest of late

    def begin(self) -> None:
        """Start a connection, which has a clock of its own."""
        self._least.clear()
        self._base_s, self._packet, self._late = None, None, None
        self._shifted_s = self._returned_s = 0.0
        self.lateness_s = 0.0

    def packet(self, dts_s: float, pts_s: float, arrived_s: float, waited: bool) -> None:
        """Note a packet; `waited` says that it was not there yet when we asked for it."""
        if self._packet is not None:
            step_s, gap_s = dts_s - self._packet[0], arrived_s - self._packet[1]
            if step_s < -BACK_S or step_s > gap_s + LEAP_S:
                self.begin()
        self._packet = dts_s, arrived_s
        if waited:
            self._starved_s = arrived_s
        delay_s = arrived_s - pts_s
        self._take_shift_back(delay_s)
        if self._least and arrived_s - self._least[-1][0] < BUCKET_S:
            start_s, least_s = self._least[-1]
            self._least[-1] = start_s, min(least_s, delay_s)
        else:
            self._least.append((arrived_s, delay_s))
        while self._least[0][0] < arrived_s - WINDOW_S:
            self._least.popleft()
        self.lateness_s = delay_s - self._offset_s()
        self._notice_shift(delay_s, arrived_s, waited)

    def lag_s(self, now_s: float) -> float:
        """Return how far we are behind what lies ready; 0 when we had to wait for data of late."""
        is_starved = now_s - self._starved_s < BEHIND_S
        return 0.0 if is_starved or self.lateness_s < BEHIND_S else self.lateness_s

    def picture(self, pts_s: float, arrived_s: float) -> Stamp | None:
        """Return a picture's time; ``None`` where it is not after the last one's."""
        if self._last is None:
            self._base_s, t_s = -pts_s, 0.0
        else:
            last_s, gap_s = self._last[0], max(arrived_s - self._last[1], 0.0)
            if self._base_s is None:
                self._base_s = last_s + max(gap_s, 0.001) - pts_s
            t_s = self._base_s + pts_s
            if t_s < last_s - BACK_S - self._returned_s or t_s > last_s + gap_s + LEAP_S:
                self._base_s = last_s + max(gap_s, 0.001) - pts_s
                t_s = self._base_s + pts_s
            if t_s <= last_s:
                return None
            self._returned_s = 0.0
        captured_s = self.captured_s(pts_s, arrived_s)
        self._last = t_s, captured_s
        return Stamp(t_s, captured_s)

    def captured_s(self, pts_s: float | None, arrived_s: float) -> float:
        """Return when what carries this PTS was taken, on the arrival clock."""
        if pts_s is None or not self._least:
            return arrived_s
        return min(pts_s + self._offset_s(), arrived_s)

    def _offset_s(self) -> float:
        return min(least_s for _, least_s in self._least)

    def _notice_shift(self, delay_s: float, arrived_s: float, waited: bool) -> None:
        """Go on in real time when late packets keep coming although nothing lay ready.

        The source's clock stood still then, as it does when a sender pauses.
        """
        late_s = self.lateness_s
        if late_s < BEHIND_S:
            self._late = None
        elif waited and (self._late is None or late_s < CATCHING_UP * self._late[1]):
            self._late = arrived_s, late_s
        elif waited and self._late is not None and arrived_s - self._late[0] > SHIFTED_AFTER_S:
            if self._base_s is not None and self._last is not None:
                self._base_s += late_s
                self._last = self._last[0] + late_s, self._last[1]
                self._shifted_s += late_s
                self._shifted_delay_s = delay_s
                self._is_shift_wrong = False
            self._least.clear()
            self._least.append((arrived_s, delay_s))
            self._late, self.lateness_s = None, 0.0

    def _take_shift_back(self, delay_s: float) -> None:
        """Undo a shift as far as packets catch up: then it was the network that was late.

        Else every hiccup would move the run's time ahead of real time for good.
        """
        if self._base_s is None or not self._shifted_s:
            return
        back_s = min(self._shifted_delay_s - delay_s, self._shifted_s)
        if back_s > (0.0 if self._is_shift_wrong else BEHIND_S):
            self._is_shift_wrong = True
            self._base_s -= back_s
            self._shifted_s -= back_s
            self._shifted_delay_s -= back_s
            self._returned_s += back_s
