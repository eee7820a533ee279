"""Which pictures are looked at, at every rate that videos come in."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.pace import Pace
from queuetail.presets import ROAD_LONGEST_S


@pytest.mark.parametrize(
    ("rate_hz", "every"),
    [
        *((2.0, 1), (5.0, 1), (10.0, 1), (12.0, 1), (15.0, 2), (20.0, 2), (24.0, 3), (25.0, 3)),
        *((30000 / 1001, 4), (30.0, 4), (50.0, 6), (60000 / 1001, 8), (60.0, 8)),
    ],
)
def test_slow_videos_are_seen_whole_and_fast_ones_in_part(rate_hz: float, every: int) -> None:
    pace = Pace(ROAD_LONGEST_S)
    # Containers round times to a millisecond.
    taken = [n for n in range(200) if pace.takes(round(n / rate_hz, 3))]
    assert taken == list(range(0, 200, every))


@given(st.lists(st.floats(0.001, 0.5), min_size=1, max_size=60))
def test_no_two_are_farther_apart_than_the_pictures_or_the_limit(steps: list[float]) -> None:
    pace = Pace(ROAD_LONGEST_S)
    times = [0.0, *itertools.accumulate(steps)]
    taken = [t for t in times if pace.takes(t)]
    assert taken[0] == 0.0
    longest = max(steps) + ROAD_LONGEST_S
    assert all(b - a <= longest for a, b in itertools.pairwise(taken))


def test_without_a_limit_all_are_taken() -> None:
    pace = Pace(0.0)
    assert all(pace.takes(n / 30) for n in range(100))
