"""The asphalt's ends are among the steps beside the lanes; what only some rows show is none."""

from __future__ import annotations

import numpy as np
import pytest
from rasters import STRAIGHT, camera

from queuetail.traffic.road import locate
from queuetail.traffic.verges import LEFT, RIGHT
from queuetail.types import Floats
from queuetail.vision.lane_lines import MIN_PICTURES, STEP_S, LaneLines
from queuetail.vision.road_edges import MOST, steps

STATION_M, OFFSET_M = np.arange(0.0, 96.0, 0.75), np.arange(-15.2, 8.01, 0.1)
LEFT_M, RIGHT_M = 1.1, -9.8


def grid(land: float, blotches: float = 3.0) -> Floats:
    """Brightness on stations and offsets: asphalt of two lanes and shoulders, and land."""
    rng = np.random.default_rng(1)
    level = rng.normal(100.0, blotches, (len(STATION_M), len(OFFSET_M)))
    level[:, (OFFSET_M > LEFT_M) | (OFFSET_M < RIGHT_M)] += land - 100.0
    return level


def nearest_m(level: Floats) -> tuple[Floats, Floats]:
    """How far from the true ends the nearest place of every stretch is, left and right."""
    seen = steps(STRAIGHT, 0, STATION_M, OFFSET_M, level)
    offset = locate(STRAIGHT, seen.seen.enu)[1]
    away = np.abs(offset - np.where(seen.side == LEFT, LEFT_M, RIGHT_M))
    both = []
    for side in (LEFT, RIGHT):
        stretches = seen.stretch[seen.side == side]
        own = away[seen.side == side]
        both.append(np.array([own[stretches == s].min() for s in np.unique(stretches)]))
    return both[0], both[1]


@pytest.mark.parametrize("land", [60.0, 90.0, 140.0], ids=["dark", "alike", "bright"])
def test_the_ends_of_the_asphalt_are_found(land: float) -> None:
    for away in nearest_m(grid(land)):
        assert len(away) == 8
        assert np.median(away) < 0.1
        assert away.max() < 0.5


def test_a_queue_is_no_end_of_the_asphalt() -> None:
    level = grid(60.0)
    for lane_m in (-1.8, -5.4):
        for rear_m in range(3, 96, 8):
            car = (rear_m < STATION_M) & (rear_m + 4.5 > STATION_M)
            level[np.ix_(car, np.abs(OFFSET_M - lane_m) < 0.9)] = 210.0
    seen = steps(STRAIGHT, 0, STATION_M, OFFSET_M, level)
    offset = locate(STRAIGHT, seen.seen.enu)[1]
    in_lanes = (offset < -0.5) & (offset > -6.7)
    assert in_lanes.mean() < 0.1
    assert all(len(away) == 8 and away.max() < 0.2 for away in nearest_m(level))


def test_no_more_than_a_few_of_each_stretch() -> None:
    level = grid(60.0)
    level += 40.0 * (np.floor(OFFSET_M / 1.5) % 2)
    seen = steps(STRAIGHT, 3, STATION_M, OFFSET_M, level)
    assert set(seen.side.tolist()) == {6, 7}
    pairs = np.stack([seen.side, seen.stretch])
    assert np.unique(pairs, axis=1, return_counts=True)[1].max() <= MOST
    assert (np.diff(seen.side * 100 + seen.stretch) >= 0).all()


def test_what_is_not_seen_shows_nothing() -> None:
    level = grid(60.0)
    level[:, OFFSET_M > 0.8] = np.nan
    seen = steps(STRAIGHT, 0, STATION_M, OFFSET_M, level)
    assert (seen.side == RIGHT).sum() >= 8
    assert not (seen.side == LEFT).any()
    assert len(steps(STRAIGHT, 0, STATION_M, OFFSET_M, np.full_like(level, np.nan))) == 0


def test_pictures_show_them_once_there_are_enough() -> None:
    size = (800, 450)
    mapping = camera(60.0, size=size)
    lines = LaneLines((STRAIGHT,))
    luma = np.full(size[::-1], 90, np.uint8)
    for n in range(MIN_PICTURES):
        assert len(lines.verges) == 0
        lines.update(luma, mapping, n * STEP_S)
    assert len(lines.verges) == 0  # nothing but asphalt
