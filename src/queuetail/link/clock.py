"""Two clocks joined by messages: when, on the receiver's clock, something was measured.

A message is never early, so the smallest difference between arrival and time stamp is the best
estimate of the clocks' offset (the minimum filter of NTP, RFC 5905 section 10): queues on the way
delay messages, but do not shift the estimate.  What stays is the smallest delay itself.
"""

from __future__ import annotations

import statistics
from collections import deque

WINDOW_S = 30.0  # crystals drift apart by 50 millionths: 1.5 ms in this time
RESTART_S = 1.0  # a time stamp that goes back by more is a sender that started anew
MEDIAN_OF = 15


class ClockEstimate:
    """Maps a sender's time stamps to the receiver's clock."""

    def __init__(self, window_s: float = WINDOW_S) -> None:
        self._window_s = window_s
        self._delays: deque[tuple[float, float]] = deque()  # (arrived, delay), delays ascending
        self._recent: deque[float] = deque(maxlen=MEDIAN_OF)
        self._last_sent_s: float | None = None
        self.restarts = 0

    def add(self, sent_s: float, arrived_s: float, transit_s: float = 0.0) -> None:
        """Take a message: its time stamp, its arrival, and how long its bytes took at least."""
        if self._last_sent_s is not None and sent_s < self._last_sent_s - RESTART_S:
            self._delays.clear()
            self._recent.clear()
            self.restarts += 1
        self._last_sent_s = sent_s
        delay_s = arrived_s - transit_s - sent_s
        self._recent.append(delay_s)
        while self._delays and self._delays[-1][1] >= delay_s:
            self._delays.pop()
        self._delays.append((arrived_s, delay_s))
        while self._delays[0][0] < arrived_s - self._window_s:
            self._delays.popleft()

    @property
    def offset_s(self) -> float | None:
        """Receiver's clock less sender's, as far as the quickest message tells."""
        return self._delays[0][1] if self._delays else None

    @property
    def sigma_s(self) -> float | None:
        """By how much the usual message is later than the quickest; None before any."""
        if not self._delays:
            return None
        return max(statistics.median(self._recent) - self._delays[0][1], 0.0)

    def received_s(self, sent_s: float) -> float | None:
        """Return a sender's time on the receiver's clock; None before any message."""
        offset_s = self.offset_s
        return None if offset_s is None else sent_s + offset_s


class UtcEstimate:
    """Maps a sender's time stamps to UTC, from the messages that tell both."""

    def __init__(self) -> None:
        self._offsets: deque[float] = deque(maxlen=MEDIAN_OF)

    def add(self, sent_s: float, utc_s: float) -> None:
        """Take a pair; a step of more than a second (a clock that was set) starts anew."""
        offset_s = utc_s - sent_s
        if self._offsets and abs(offset_s - self._offsets[-1]) > RESTART_S:
            self._offsets.clear()
        self._offsets.append(offset_s)

    def utc_s(self, sent_s: float) -> float | None:
        """Return the UTC of a time stamp in seconds since 1970; None before any pair."""
        return sent_s + statistics.median(self._offsets) if self._offsets else None
