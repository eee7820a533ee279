"""Vehicles that share an interval: bodies in it tell where each stands, and how many they are."""

from __future__ import annotations

import pytest

from queuetail.tracking.lane_vehicle import Interval, LaneVehicle
from queuetail.tracking.merged import correct_merged, paired

Body = tuple[float, float]


def vehicle(track_id: int, rear_m: float, length_m: float = 4.6) -> LaneVehicle:
    made = LaneVehicle(track_id, 0, 1, rear_m, 0.0, length_m, -1.8, 0.0)
    made.length_known = made.confirmed = True
    return made


def interval(*bodies: Body) -> Interval:
    rear_m, front_m = bodies[0][0] - 2.0, bodies[-1][1] + 0.5
    return Interval(0, 1, rear_m, front_m, -1.8, False, False, bodies=bodies)


def row(*rears_m: float, length_m: float = 4.6) -> list[Body]:
    return [(r, r + length_m) for r in rears_m]


def test_every_vehicle_is_moved_to_its_own_body() -> None:
    queue = [vehicle(n, 10 + 7.0 * n + error) for n, error in enumerate((0.3, -1.5, 1.2))]
    seen = interval(*row(10, 17, 24))
    for _ in range(40):
        assert correct_merged(queue, seen, 0.1) == []
    assert [v.rear_m for v in queue] == pytest.approx([10, 17, 24], abs=0.3)


def test_who_is_one_too_many_in_the_row_is_let_go_after_a_while() -> None:
    queue = [vehicle(0, 10), vehicle(1, 14), vehicle(2, 17), vehicle(3, 24)]
    seen = interval(*row(10, 17, 24))
    gone: list[LaneVehicle] = []
    for _ in range(18):
        gone += correct_merged([v for v in queue if v not in gone], seen, 0.1)
    assert gone == []
    for _ in range(10):
        gone += correct_merged([v for v in queue if v not in gone], seen, 0.1)
    assert [v.track_id for v in gone] == [1]


def test_a_dark_car_between_bodies_stays() -> None:
    """It shows no body of its own, and stands where no other's is."""
    queue = [vehicle(0, 10), vehicle(1, 17), vehicle(2, 24)]
    for _ in range(60):
        assert correct_merged(queue, interval(*row(10, 24)), 0.1) == []


def test_a_part_of_a_truck_is_not_the_truck() -> None:
    truck, car = vehicle(0, 10, 16.0), vehicle(1, 28)
    parts = [(15.0, 21.0), (28.0, 32.6)]
    assert paired([truck, car], parts) == [(car, parts[1])]


def test_a_vehicle_grows_to_its_body() -> None:
    truck, car = vehicle(0, 10, 13.0), vehicle(1, 30)
    for _ in range(60):
        correct_merged([truck, car], interval((10.0, 26.0), (30.0, 34.6)), 0.1)
    assert truck.length_m == pytest.approx(16, abs=0.3)


def test_without_bodies_nothing_is_told() -> None:
    assert paired([vehicle(0, 10)], ()) == []
