"""Where the time goes: the share of each stage, always measured."""

from __future__ import annotations

from collections import defaultdict
from time import perf_counter


class Stopwatch:
    """Adds up the time between laps under the name of the stage that ends there."""

    def __init__(self) -> None:
        self._since = perf_counter()
        self._total_s: defaultdict[str, float] = defaultdict(float)

    def lap(self, stage: str) -> None:
        """Book the time since the last lap under `stage`."""
        now = perf_counter()
        self._total_s[stage] += now - self._since
        self._since = now

    def mean_ms(self, frames: int) -> dict[str, float]:
        """Return milliseconds per frame for each stage, in the order of their first lap."""
        return {k: round(1000 * v / max(frames, 1), 4) for k, v in self._total_s.items()}
