"""Cast shadow: which lanes it reaches, and where a vehicle ends without it."""

from __future__ import annotations

import numpy as np
import pytest

from queuetail.types import Floats
from queuetail.vision.cast_shadows import ShadowReach, dark_ends
from queuetail.vision.lane_interval import Interval

PX_PER_M, LANES = 5.0, 3


def thing(lane: int, rear_m: float, body: float, length_m: float = 4.6) -> Interval:
    rear, front = rear_m * PX_PER_M, (rear_m + length_m) * PX_PER_M
    return Interval(0, lane, rear, front, 20.0, (False, False), 0.4, body)


def marked(reach: ShadowReach, *seen: Interval) -> list[bool]:
    reach.mark(seen, LANES, PX_PER_M)
    return [interval.shadow for interval in seen]


def test_until_it_is_known_what_is_dark_beside_a_body_may_be_its_shadow() -> None:
    reach = ShadowReach()
    assert marked(reach, thing(1, 50, 1.0), thing(2, 51, 0.0)) == [False, True]
    assert marked(reach, thing(1, 50, 1.0), thing(2, 70, 0.0)) == [False, False]
    assert marked(reach, thing(1, 50, 1.0), thing(1, 55.5, 0.0)) == [False, False]


def test_where_no_shadows_fall_a_dark_thing_is_a_dark_car() -> None:
    reach = ShadowReach()
    for n in range(30):
        marked(reach, thing(1, 40 + n, 1.0))
    assert marked(reach, thing(1, 50, 1.0), thing(2, 51, 0.0)) == [False, False]
    # Trucks are taller: of their shadows nothing is known yet.
    assert marked(reach, thing(1, 50, 1.0, 15.0), thing(2, 51, 0.0)) == [False, True]


def test_where_they_fall_they_are_marked_on_their_side_only() -> None:
    reach = ShadowReach()
    for n in range(30):
        marked(reach, thing(2, 40 + n, 1.0), thing(3, 41 + n, 0.0))
    assert marked(reach, thing(2, 50, 1.0), thing(3, 51, 0.0)) == [False, True]
    assert marked(reach, thing(2, 50, 1.0), thing(1, 51, 0.0)) == [False, False]


def test_dark_cars_of_a_queue_beside_one_another_do_not_tell_of_shadows() -> None:
    reach = ShadowReach()
    queue = [thing(1, 20 + 7 * n, 1.0) for n in range(4)] + [
        thing(2, 21 + 7 * n, 0.0) for n in range(4)
    ]
    for n in range(60):
        marked(reach, *queue, *([thing(1, 80 + 2 * n, 1.0)] if n < 30 else []))
    assert marked(reach, thing(1, 50, 1.0), thing(2, 51, 0.0)) == [False, False]


def test_a_body_beside_a_body_says_nothing() -> None:
    reach = ShadowReach()
    for n in range(60):
        marked(reach, thing(1, 40 + n, 1.0), thing(2, 41 + n, 1.0), thing(3, 41 + n, 1.0))
    assert marked(reach, thing(1, 50, 1.0), thing(2, 51, 0.0)) == [False, True]


@pytest.mark.parametrize(
    ("shine", "expected"),
    [
        ([1.0] * 20, (0.0, 0.0)),
        ([0.0] * 5 + [1.0] * 15, (5.0, 0.0)),
        ([1.0] * 15 + [0.0] * 5, (0.0, 5.0)),
        ([0.0] * 20, None),
        ([0.0] * 18 + [1.0] * 2, None),  # a lamp does not make a bright vehicle
    ],
)
def test_dark_ends(shine: list[float], expected: tuple[float, float] | None) -> None:
    array: Floats = np.array(shine)
    assert dark_ends(array, 0.3, 0.3) == expected
