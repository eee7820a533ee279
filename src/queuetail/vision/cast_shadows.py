"""Cast shadow beside and before the vehicles that throw it.

The sun is the same for all: how far shadow lengthens bright vehicles, and which lanes beside them
it reaches, is so for dark ones too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from statistics import median

import numpy as np

from queuetail.types import Floats
from queuetail.vision.lane_interval import MIN_LENGTH_M, Interval

TALL_LENGTH_M = 6.5  # longer vehicles throw longer shadows
MEMORY = 40  # vehicles over which the cast shadow's length is taken
MAX_SHADOW_M = 6.0
UNEVEN_M = 2.5  # of dark end beyond the usual: another vehicle's shadow reaches it
SHADOW_REACH_M, SHADOW_LANES = 4.0, 2  # along and across the road, from a body to its shadow
ONLY_SHADE = 0.15  # of the columns: with less, all may be shadow
BODY_SHARE = 0.25  # of a vehicle's columns, for it to show where its cast shadow ends
REACH_MEMORY, REACH_KNOWN = 400, 20  # casters, one for each picture that shows it
ALONE_M = 12.0  # to the next in its lane, for what lies beside a caster to tell of shadows
THROWN = 0.5  # share of them beside which shade lies: fewer just drive beside dark cars


class CastShadows:
    """How far cast shadow lengthens vehicles at either end, learnt from bright vehicles.

    The sun is the same for all: where a bright body begins well after its dark silhouette, the
    difference is shadow, and dark vehicles, which hide it, have as much.
    """

    def __init__(self) -> None:
        # Metres behind and ahead, of the last bright vehicles, for low and for tall ones.
        self._ends_m: dict[bool, deque[tuple[float, float]]] = {
            False: deque(maxlen=MEMORY),
            True: deque(maxlen=MEMORY),
        }
        self._typical = {False: (0.0, 0.0), True: (0.0, 0.0)}

    def without(
        self,
        ends: tuple[float, float],
        dark: tuple[float, float] | None,
        most: tuple[float, float] | None,
        cut: tuple[bool, bool],
        px_per_m: float,
    ) -> tuple[float, float]:
        """Return rear and front columns without shadow; `dark` is the dark length at each end.

        `most` is how much of it no known car stands in.
        """
        rear, front = ends
        tall = front - rear >= TALL_LENGTH_M * px_per_m
        known = self._ends_m[tall]
        if dark is not None and max(dark) < MAX_SHADOW_M * px_per_m and not any(cut):
            known.append((dark[0] / px_per_m, dark[1] / px_per_m))
            self._typical[tall] = _median_ends(known)
        if len(known) < 3:
            return ends
        behind, ahead = (length_m * px_per_m for length_m in self._typical[tall])
        if most is not None:
            uneven = UNEVEN_M * px_per_m
            behind = most[0] if most[0] > behind + uneven else behind
            ahead = most[1] if most[1] > ahead + uneven else ahead
        if front - rear - behind - ahead < MIN_LENGTH_M * px_per_m:
            return ends
        return rear + (0.0 if cut[0] else behind), front - (0.0 if cut[1] else ahead)


def _median_ends(ends_m: Iterable[tuple[float, float]]) -> tuple[float, float]:
    behind, ahead = zip(*ends_m, strict=True)
    return median(behind), median(ahead)


def dark_ends(shown: Floats, cover: float, share: float) -> tuple[float, float] | None:
    """Return how many columns at each end of a vehicle show no body; None where too few do.

    `shown` is each column's cover by what is surely no shadow.
    """
    body = np.flatnonzero(shown >= cover)
    if len(body) < share * len(shown):
        return None
    return float(body[0]), float(len(shown) - 1 - body[-1])


class ShadowReach:
    """Marks shadows beside their casters, in the lanes that the scene's shadows reach.

    With the sun low and aside nearly all vehicles throw theirs into the next lane, and with any
    other sun none does: a dark thing beside a vehicle is then a dark car.
    """

    def __init__(self) -> None:
        # By band, whether the caster is tall, and lanes to the right: the share, of how many.
        self._thrown: dict[tuple[int, bool, int], tuple[float, int]] = {}

    def mark(self, intervals: Sequence[Interval], lanes: int, px_per_m: float) -> None:
        """Mark the intervals of one band that show only shade, near a body that may cast it."""
        bodies = [i for i in intervals if i.body >= BODY_SHARE and not i.roof]
        by_lane: dict[int, list[Interval]] = {}
        for interval in intervals:
            by_lane.setdefault(interval.lane, []).append(interval)
        for caster in bodies:
            if not any(caster.cut) and _is_alone(caster, by_lane[caster.lane], px_per_m):
                self._learn(caster, intervals, lanes, px_per_m)
        for interval in intervals:
            interval.shadow = interval.body < ONLY_SHADE and any(
                _is_near(interval, caster, px_per_m)
                and self._reaches(caster, interval.lane - caster.lane, px_per_m)
                for caster in bodies
            )

    def _learn(
        self, caster: Interval, intervals: Sequence[Interval], lanes: int, px_per_m: float
    ) -> None:
        """Note in which lanes beside a caster there is shade, where no other body hides it."""
        for apart in range(-SHADOW_LANES, SHADOW_LANES + 1):
            lane = caster.lane + apart
            if apart == 0 or not 1 <= lane <= lanes:
                continue
            near = [i for i in intervals if i.lane == lane and _is_near(i, caster, px_per_m)]
            if any(i.body >= ONLY_SHADE for i in near):
                continue
            key = (caster.band, _is_tall(caster, px_per_m), apart)
            share, count = self._thrown.get(key, (0.0, 0))
            count = min(count + 1, REACH_MEMORY)
            self._thrown[key] = share + (bool(near) - share) / count, count

    def _reaches(self, caster: Interval, apart: int, px_per_m: float) -> bool:
        if not 0 < abs(apart) <= SHADOW_LANES:
            return False
        key = (caster.band, _is_tall(caster, px_per_m), apart)
        share, count = self._thrown.get(key, (0.0, 0))
        return count < REACH_KNOWN or share > THROWN


def _is_near(shade: Interval, caster: Interval, px_per_m: float) -> bool:
    """Tell whether shade lies so near a caster, along the road, that it may be thrown by it."""
    reach = SHADOW_REACH_M * px_per_m
    return caster.rear < shade.front + reach and caster.front > shade.rear - reach


def _is_alone(caster: Interval, lane: Sequence[Interval], px_per_m: float) -> bool:
    """Tell whether a caster is in no queue in its lane: beside one anything may stand."""
    first, last = caster.rear - ALONE_M * px_per_m, caster.front + ALONE_M * px_per_m
    return not any(i is not caster and i.rear < last and i.front > first for i in lane)


def _is_tall(caster: Interval, px_per_m: float) -> bool:
    return caster.front - caster.rear >= TALL_LENGTH_M * px_per_m
