"""Which pictures of a video are looked at."""

from __future__ import annotations

import math


class Pace:
    """Leaves pictures out while the next one comes soon enough; of a slow video it takes each."""

    def __init__(self, longest_s: float) -> None:
        """`longest_s` seconds may pass between two pictures that are looked at; 0 takes all."""
        self._longest_s = longest_s
        self._shown_s = self._taken_s = -math.inf

    def takes(self, t_s: float) -> bool:
        """Tell whether to look at a picture of this time, and count it if so.

        The next one is expected after as long as this one came after the last.
        """
        step_s, self._shown_s = t_s - self._shown_s, t_s
        if t_s + step_s - self._taken_s <= self._longest_s:
            return False
        self._taken_s = t_s
        return True
