"""The paper's end of queue, its growth, and the road found from the traffic, by table."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from fleet import fleet
from hypothesis import given
from hypothesis import strategies as st

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import enu_to_px, mapping_from_pose
from queuetail.traffic.discovery import StraightRoad, course_name
from queuetail.traffic.growth import Growth
from queuetail.traffic.last_slow_car import LastSlowCar
from queuetail.traffic.queue import end_of_queue, slow_vehicles
from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    CameraPose,
    Origin,
    QueueState,
    QueueStatus,
    Raster,
    RoadVehicles,
    Scene,
    TrackState,
)

ORIGIN = Origin(36.11, -97.057)
POSE = CameraPose(36.11, -97.057, 120.0, 0.0, -90.0, 0.0, intrinsics_from_hfov(1280, 720, 84.0))
MAPPING = mapping_from_pose(POSE, ORIGIN)
RASTER = Raster(np.zeros((4, 4, 3), np.uint8), np.eye(3))
NORTH = Approach("NB", np.array([[0.0, -100.0], [0.0, 100.0]]), 200.0, 2, 3.5)
SLOW_MPS = 11.0
Car = tuple[float, float]  # metres along the road from its middle, speed


def on_road(cars: list[Car], states: list[TrackState] | None = None) -> RoadVehicles:
    return assign(
        fleet([(1.75, y) for y, _ in cars], [(0.0, v) for _, v in cars], states=states), (NORTH,)
    )


def answer(cars: list[Car], states: list[TrackState] | None = None) -> QueueState:
    scene = Scene(0.0, RASTER, MAPPING)
    _, found = LastSlowCar(SLOW_MPS).update(on_road(cars, states), (NORTH,), scene)
    return found[0]


@pytest.mark.parametrize(
    ("cars", "station_m", "vehicles", "length_m"),
    [
        ([], None, 0, 0),
        ([(0, 25.0)], None, 0, 0),
        ([(0, 0.0)], 297.5, 1, 5.0),  # its centre is at 300 m, its rear half a car upstream
        ([(0, 10.9)], 297.5, 1, 5.0),
        ([(0, 11.0)], None, 0, 0),  # not below the queue speed
        ([(20, 0.0), (0, 1.0), (-30, 20.0)], 297.5, 2, 25.0),
        ([(-30, 2.0), (20, 0.0)], 267.5, 2, 55.0),
        ([(0, -0.9)], 297.5, 1, 5.0),  # the noise of a standing car
        ([(0, -5.0)], None, 0, 0),  # the other way
        ([(0, math.nan)], None, 0, 0),
        ([(-115, 0.0)], 182.5, 1, 5.0),  # a little beyond the axis' first point
    ],
)
def test_the_end_of_the_queue(
    cars: list[Car], station_m: float | None, vehicles: int, length_m: float
) -> None:
    state = answer(cars)
    assert state.approach == "NB"
    if station_m is None:
        assert state == QueueState("NB", QueueStatus.CLEAR)
        return
    assert state.status is QueueStatus.QUEUED
    assert state.eoq is not None
    assert state.eoq.station_m == pytest.approx(station_m)
    assert state.eoq.vehicles == vehicles
    assert state.eoq.length_m == pytest.approx(length_m)
    assert state.eoq.growth_mps is None


def test_tentative_objects_are_no_queue() -> None:
    assert answer([(0, 0.0)], [TrackState.TENTATIVE]).status is QueueStatus.CLEAR
    assert answer([(0, 0.0)], [TrackState.COASTING]).status is QueueStatus.QUEUED


def test_its_place_is_given_in_every_frame_of_reference() -> None:
    eoq = answer([(-40, 0.0), (0, 0.0)]).eoq
    assert eoq is not None
    np.testing.assert_allclose(eoq.enu, [1.75, -42.5], atol=1e-9)
    np.testing.assert_allclose(eoq.px, enu_to_px(MAPPING, np.array([eoq.enu]))[0])
    assert eoq.lat_deg is not None
    assert eoq.lon_deg is not None
    back = enu_from_geodetic(np.array(eoq.lat_deg), np.array(eoq.lon_deg), ORIGIN)
    np.testing.assert_allclose(back, eoq.enu, atol=1e-6)
    assert eoq.track_id == 1
    assert eoq.sigma_m == 0.7


def test_local_metres_have_no_latitude() -> None:
    local = dataclasses.replace(MAPPING, origin=None)
    vehicles = on_road([(0, 0.0)])
    eoq = end_of_queue(vehicles, slow_vehicles(vehicles, 0, SLOW_MPS), NORTH, local)
    assert eoq is not None
    assert eoq.lat_deg is eoq.lon_deg is None


def test_queued_vehicles_are_marked_and_approaches_kept_apart() -> None:
    south = Approach("SB", np.array([[-1.0, 100.0], [-1.0, -100.0]]), 0.0, 1, 3.5)
    tracks = fleet([(1.75, 0), (1.75, 30), (-3, 0)], [(0, 0), (0, 20), (0, -20)])
    vehicles, states = LastSlowCar(SLOW_MPS).update(
        assign(tracks, (NORTH, south)), (NORTH, south), Scene(0.0, RASTER, MAPPING)
    )
    assert vehicles.queued.tolist() == [True, False, False]
    assert [s.status for s in states] == [QueueStatus.QUEUED, QueueStatus.CLEAR]


@given(st.floats(-8, 8), st.floats(0, 1e6), st.floats(5, 30))
def test_growth_is_the_slope_of_the_end(growth: float, start_s: float, rate_hz: float) -> None:
    watch = Growth()
    known = [
        watch.update(start_s + k / rate_hz, 700.0 - growth * k / rate_hz)
        for k in range(round(8 * rate_hz))
    ]
    assert known[0] is None
    assert known[-1] == pytest.approx(growth, abs=1e-3)
    assert known[round(1.9 * rate_hz) - 1] is None


def test_growth_forgets_a_queue_that_dissolved() -> None:
    watch = Growth()
    for k in range(100):
        watch.update(k / 25, 100.0 + k)
    assert watch.update(4.04, None) is None
    assert watch.update(4.08, 500.0) is None


def test_growth_follows_a_change_within_its_window() -> None:
    watch = Growth()
    for k in range(200):
        watch.update(k / 25, 100.0)
    for k in range(200, 720):
        rate = watch.update(k / 25, 100.0 - (k - 200) / 25 * 3)
    assert rate == pytest.approx(3.0, abs=1e-6)


def test_growth_rides_over_the_sawtooth_of_arrivals() -> None:
    """A vehicle joins every 5 s, 20 m upstream, and creeps 10 m on until the next one comes."""
    watch = Growth()
    rates = [
        watch.update(k / 15, 900.0 - 20 * (k // 75) + 10 * (k % 75) / 75 + 10 * (k // 75))
        for k in range(900)
    ]
    assert all(1.0 < rate < 3.0 for rate in rates[300:] if rate is not None)


def test_last_slow_car_gives_growth_once_known() -> None:
    queue = LastSlowCar(SLOW_MPS)
    for k in range(150):
        scene = Scene(k / 25, RASTER, MAPPING)
        vehicles = on_road([(-k / 25, 0.0)])
        _, states = queue.update(vehicles, (NORTH,), scene)
    assert states[0].eoq is not None
    assert states[0].eoq.growth_mps == pytest.approx(1.0)


def drive_by(road: StraightRoad, course_deg: float, counts: tuple[int, int]) -> None:
    """Let vehicles pass both ways; those with the course keep 4 m to the right of the others."""
    unit = np.array([math.sin(math.radians(course_deg)), math.cos(math.radians(course_deg))])
    right = np.array([unit[1], -unit[0]])
    forwards, backwards = counts
    for k in range(40):
        at = 1.03 * k - 20  # a step that no number of steps makes the way which counts as moved
        places = [tuple((at - 15 * i) * unit + 4 * right) for i in range(forwards)]
        places += [tuple((15 * i - at) * unit) for i in range(backwards)]
        speeds = [tuple(15 * unit)] * forwards + [tuple(-15 * unit)] * backwards
        road.locate(fleet(places, speeds))


@pytest.mark.parametrize("course_deg", [0.0, 45.0, 100.0, 200.0, 359.0])
def test_both_directions_are_found_most_used_first(course_deg: float) -> None:
    road = StraightRoad()
    drive_by(road, course_deg, (3, 2))
    assert len(road.approaches) == 2
    for approach, way in zip(road.approaches, (0, 180), strict=True):
        gap = np.diff(approach.axis_enu, axis=0)[0]
        found = math.degrees(math.atan2(gap[0], gap[1]))
        assert (found - course_deg - way + 180) % 360 - 180 == pytest.approx(0, abs=1)
    unit = np.array([math.sin(math.radians(course_deg)), math.cos(math.radians(course_deg))])
    right = np.array([unit[1], -unit[0]])
    vehicles = road.locate(
        fleet([tuple(4 * right), (0.0, 0.0)], [tuple(9 * unit), tuple(-9 * unit)])
    )
    assert vehicles.approach.tolist() == [0, 1]
    assert (vehicles.speed_mps > 8).all()


def test_one_direction_can_be_asked_for() -> None:
    road = StraightRoad(course_deg=170.0)
    drive_by(road, 0.0, (3, 2))
    assert [a.name for a in road.approaches] == ["SB"]


def test_a_single_direction_gives_one_approach() -> None:
    road = StraightRoad()
    drive_by(road, 90.0, (4, 0))
    assert [a.name for a in road.approaches] == ["EB"]


def test_nothing_is_found_from_what_stands_sways_or_is_tentative() -> None:
    road = StraightRoad()
    for k in range(100):
        sway = math.sin(k)
        tracks = fleet(
            [(0, 0), (sway, 40), (k, 80), (k, 90), (k, 95)],
            states=[TrackState.CONFIRMED, TrackState.CONFIRMED, *[TrackState.TENTATIVE] * 3],
        )
        vehicles = road.locate(tracks)
    assert road.approaches == ()
    assert (vehicles.approach == -1).all()


@pytest.mark.parametrize(
    ("east", "north", "name"),
    [(0, 1, "NB"), (1, 1, "NEB"), (1, 0, "EB"), (0, -1, "SB"), (-1, 0, "WB"), (-1, 1, "NWB")],
)
def test_courses_are_named_by_the_compass(east: float, north: float, name: str) -> None:
    unit = np.array([east, north]) / math.hypot(east, north)
    assert course_name(unit) == name
