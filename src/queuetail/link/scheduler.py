"""What to send next on a slow line: every quantity at its own rate, less of it when it is full."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from queuetail.link.frames import OVERHEAD_BYTES, encode
from queuetail.link.messages import BY_HEADER, IDS, Quantity, Rate, Sensors, Status, header_of

BITS_PER_BYTE = 10  # 8N1: start, eight data bits, stop
FILL = 0.95  # of the line: a queue in front of the radio would only make readings older
WINDOW_S = 3.0  # over which rates are measured; a quantity silent for longer is gone
REPLAN_S = 0.5
EARLY = 0.3  # of a period: a sensor at just the wanted rate must not miss every other slot
BLOCKED, FREED = 0.8, 1.05  # how the assumed capacity follows a line that is slower than it says
LEAST_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Wish:
    """How often a quantity should be sent, and what it may fall to; 1 is given up last."""

    priority: int
    rate_hz: float
    floor_hz: float


# At 9600 baud all of them together take 92 % of the line.
WISHES: Mapping[str, Wish] = {
    "GMB": Wish(1, 10.0, 2.0),
    "POS": Wish(2, 10.0, 2.0),
    "HGT": Wish(3, 10.0, 1.5),  # so that one may be lost before it is 1.5 s old
    "TIM": Wish(4, 1.0, 0.2),
    "STA": Wish(5, 1.0, 0.2),
    "HDG": Wish(6, 5.0, 1.0),
    "FOV": Wish(7, 1.0, 0.2),
    "LDR": Wish(8, 5.0, 0.0),
    "ALT": Wish(9, 2.0, 0.0),
    "ATT": Wish(10, 2.0, 0.0),
}
MOST_STATUS_BYTES = 2 + 3 * len(IDS)


def frame_bytes(header: str) -> int:
    """Return the size of a quantity's frame (the largest, for STA)."""
    longest = MOST_STATUS_BYTES if header == "STA" else BY_HEADER[header].lengths[-1]
    return OVERHEAD_BYTES + longest


def fitted_rates(wanted_hz: Mapping[str, float], bytes_per_s: float) -> dict[str, float]:
    """Return the rates that fit the line.

    The least important quantity is halved until it reaches its floor, then the next one; where all
    are at their floors, the least important are left out.  What is left over goes to the important.
    """
    rates = dict(wanted_hz)
    by_rank = sorted(rates, key=lambda header: -WISHES[header].priority)

    def load() -> float:
        return sum(rate * frame_bytes(header) for header, rate in rates.items())

    for header in by_rank:
        floor_hz = min(WISHES[header].floor_hz, wanted_hz[header])
        while load() > bytes_per_s and rates[header] > floor_hz:
            halved = rates[header] / 2
            rates[header] = halved if halved > max(floor_hz, 0.1) else floor_hz
    for header in by_rank:
        if load() <= bytes_per_s:
            break
        rates[header] = 0.0
    for header in reversed(by_rank):  # what halving left over goes to the most important first
        spare = max(bytes_per_s - load(), 0.0)
        rates[header] = min(rates[header] + spare / frame_bytes(header), wanted_hz[header])
    return rates


class RateScheduler:
    """Holds the newest value of each quantity and says what to send next.

    Only what sensors really offer counts, so that a missing one leaves its share to the others.
    """

    def __init__(self, baud: int = 9600) -> None:
        self.capacity_bytes_per_s = baud / BITS_PER_BYTE
        self._nominal = self.capacity_bytes_per_s
        self._waiting: dict[str, tuple[Quantity, float]] = {}
        self._offered: dict[str, deque[float]] = {}
        self._sent: dict[str, deque[float]] = {}
        self._sizes: deque[tuple[float, int]] = deque()
        self._due: dict[str, float] = {}
        self._rates: dict[str, float] = {}
        self._replan_s = self._blocked_s = -math.inf
        self._start_s: float | None = None
        self._budget_s: float | None = None  # until when the line is taken
        self._number = 0
        self.refused = 0  # values that cannot be sent

    def offer(self, quantity: Quantity, measured_s: float) -> None:
        """Take a reading; it replaces an older one of its kind that was not sent yet."""
        header = header_of(quantity)
        if header not in self._offered:
            self._offered[header] = deque()
            self._replan_s = -math.inf
        self._offered[header].append(measured_s)
        self._waiting[header] = quantity, measured_s

    def next_frame(self, now_s: float) -> bytes | None:
        """Return the frame to send now; None while the line is taken or nothing is due."""
        if self._start_s is None:
            self._start_s = now_s
        if now_s >= self._replan_s:
            self._plan(now_s)
        if self._budget_s is not None and now_s < self._budget_s:
            return None
        while (header := self._most_due(now_s)) is not None:
            quantity, measured_s = self._waiting.pop(header)
            try:
                frame = encode(quantity, measured_s, self._number)
            except (ValueError, OverflowError):
                self.refused += 1
                continue
            self._book(header, len(frame), now_s)
            return frame
        return None

    def line_blocked(self, now_s: float) -> None:
        """Say that the port still holds what it was given: the line is slower than it says."""
        if now_s - self._blocked_s < REPLAN_S:
            return
        self._blocked_s = now_s
        least = LEAST_SHARE * self._nominal
        self.capacity_bytes_per_s = max(self.capacity_bytes_per_s * BLOCKED, least)
        self._replan_s = -math.inf

    def status(self, now_s: float, sensors: Sensors) -> Status:
        """Return the line's load and the rates of the last seconds, for the other end to know."""
        start_s = now_s if self._start_s is None else self._start_s
        span_s = max(min(now_s - start_s, WINDOW_S), 1.0)
        while self._sizes and self._sizes[0][0] < now_s - WINDOW_S:
            self._sizes.popleft()
        load = sum(size for _, size in self._sizes) / span_s / self._nominal
        rates = []
        for header in IDS:
            if header not in self._offered:
                continue
            sent = self._sent.setdefault(header, deque())
            _forget(sent, now_s)
            rates.append(Rate(header, self._wanted_hz(header, now_s), len(sent) / span_s))
        return Status(min(round(100 * load), 255), sensors, tuple(rates))

    def _wanted_hz(self, header: str, now_s: float) -> float:
        """Return the wish, or the sensor's own rate where that is lower."""
        offered = self._offered[header]
        _forget(offered, now_s)
        if not offered:
            return 0.0
        start_s = now_s if self._start_s is None else self._start_s
        if now_s - start_s < WINDOW_S:
            return WISHES[header].rate_hz
        return min(WISHES[header].rate_hz, (len(offered) + 1) / WINDOW_S)

    def _plan(self, now_s: float) -> None:
        self._replan_s = now_s + REPLAN_S
        if now_s - self._blocked_s > REPLAN_S:
            grown = self.capacity_bytes_per_s * FREED
            self.capacity_bytes_per_s = min(grown, self._nominal)
        wanted = {header: self._wanted_hz(header, now_s) for header in self._offered}
        present = {header: rate for header, rate in wanted.items() if rate > 0}
        self._rates = fitted_rates(present, FILL * self.capacity_bytes_per_s)

    def _most_due(self, now_s: float) -> str | None:
        """Return the quantity whose turn came first; the more important one when they are equal."""
        best, best_key = None, (math.inf, 0)
        for header in self._waiting:
            rate_hz = self._rates.get(header, 0.0)
            if rate_hz <= 0:
                continue
            due_s = self._due.get(header, -math.inf)
            key = due_s, WISHES[header].priority
            if due_s - EARLY / rate_hz <= now_s and key < best_key:
                best, best_key = header, key
        return best

    def _book(self, header: str, size: int, now_s: float) -> None:
        self._number += 1
        period_s = 1 / self._rates[header]
        due_s = self._due.get(header, -math.inf) + period_s
        self._due[header] = due_s if due_s > now_s - period_s else now_s + period_s
        taken_s = size / self.capacity_bytes_per_s
        free_s = now_s if self._budget_s is None else max(self._budget_s, now_s - taken_s)
        self._budget_s = free_s + taken_s
        self._sent.setdefault(header, deque()).append(now_s)
        self._sizes.append((now_s, size))


def _forget(times: deque[float], now_s: float) -> None:
    while times and times[0] < now_s - WINDOW_S:
        times.popleft()
