"""Linear referencing: stations, offsets, lanes, and which approach a vehicle is on."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fleet import fleet
from hypothesis import given
from hypothesis import strategies as st

from queuetail.traffic.road import KnownRoad, assign, is_on, locate, place
from queuetail.types import Approach

NORTH = Approach("NB", np.array([[0.0, 0.0], [0.0, 100.0]]), 500.0, lanes=2, lane_width_m=3.5)


@st.composite
def polylines(draw: st.DrawFn) -> Approach:
    """Return roads of 1–6 legs of 40–200 m that turn by up to 20° at each bend."""
    course = draw(st.floats(0, 360))
    point = np.array([draw(st.floats(-500, 500)), draw(st.floats(-500, 500))])
    points = [point]
    for _ in range(draw(st.integers(1, 6))):
        length = draw(st.floats(40, 200))
        point = point + length * np.array(
            [math.sin(math.radians(course)), math.cos(math.radians(course))]
        )
        points.append(point)
        course += draw(st.floats(-20, 20))
    return Approach("A", np.array(points), draw(st.floats(-1000, 1000)), 2, 3.5)


@given(polylines(), st.floats(0, 1), st.floats(-15, 15), st.integers(0, 5))
def test_place_and_locate_are_inverse(
    road: Approach, share: float, offset_m: float, leg: int
) -> None:
    """Away from the bends, where the inside overlaps and the outside gapes (15 m × tan 10°)."""
    lengths = np.linalg.norm(np.diff(road.axis_enu, axis=0), axis=1)
    leg = min(leg, len(lengths) - 1)
    before = float(lengths[:leg].sum())
    station = road.start_station_m + before + 6 + share * (lengths[leg] - 12)
    point = place(road, np.array([station]), np.array([offset_m]))
    s, d, course = locate(road, point)
    assert s[0] == pytest.approx(station, abs=1e-6)
    assert d[0] == pytest.approx(offset_m, abs=1e-6)
    assert np.linalg.norm(course[0]) == pytest.approx(1.0)


@given(polylines(), st.floats(-400, 0), st.floats(0, 400), st.floats(-10, 10))
def test_beyond_its_ends_the_axis_goes_on_straight(
    road: Approach, before_m: float, after_m: float, offset_m: float
) -> None:
    total = float(np.linalg.norm(np.diff(road.axis_enu, axis=0), axis=1).sum())
    ends = [(before_m, 0, 1), (total + after_m, -2, -1)]
    for along, a, b in ends:
        point = place(road, np.array([road.start_station_m + along]), np.array([offset_m]))
        leg = road.axis_enu[b] - road.axis_enu[a]
        unit = leg / np.linalg.norm(leg)
        anchor, base = (road.axis_enu[0], 0.0) if a == 0 else (road.axis_enu[-1], total)
        left = np.array([-unit[1], unit[0]])
        expected = anchor + (along - base) * unit + offset_m * left
        np.testing.assert_allclose(point[0], expected, atol=1e-6)


def test_locate_extrapolates() -> None:
    s, d, course = locate(NORTH, np.array([[-2.0, -50.0], [3.0, 130.0]]))
    np.testing.assert_allclose(s, [450.0, 630.0])
    np.testing.assert_allclose(d, [2.0, -3.0])  # west of a road to the north is its left
    np.testing.assert_allclose(course, [[0, 1], [0, 1]])


@given(polylines(), st.floats(-800, 800), st.floats(-800, 800))
def test_no_point_is_nearer_to_the_axis_than_its_foot(road: Approach, x: float, y: float) -> None:
    s, _, _ = locate(road, np.array([[x, y]]))
    foot = place(road, s, np.zeros(1))[0]
    stations = road.start_station_m + np.linspace(-100, 1400, 300)
    others = place(road, stations, np.zeros(300))
    assert math.dist(foot, (x, y)) <= np.linalg.norm(others - [x, y], axis=1).min() + 1e-6


def test_points_without_a_place_and_no_points_at_all() -> None:
    s, d, _ = locate(NORTH, np.array([[np.nan, np.nan]]))
    assert np.isnan(s).all()
    assert np.isnan(d).all()
    assert locate(NORTH, np.empty((0, 2)))[0].shape == (0,)
    assert place(NORTH, np.empty(0), np.empty(0)).shape == (0, 2)


@pytest.mark.parametrize(
    ("offset_m", "lane", "on"),
    [
        (1.8, 0, False),
        (1.7, 1, True),  # half a lane over the left edge line
        (0.0, 1, True),
        (-1.75, 1, True),
        (-3.4, 1, True),
        (-3.6, 2, True),
        (-6.9, 2, True),
        (-8.7, 2, True),
        (-8.8, 0, False),
    ],
)
def test_lanes_count_from_the_left(offset_m: float, lane: int, on: bool) -> None:
    vehicles = assign(fleet([(-offset_m, 50.0)]), (NORTH,))
    assert vehicles.approach[0] == (0 if on else -1)
    assert vehicles.lane[0] == lane
    if on:
        assert vehicles.offset_m[0] == pytest.approx(offset_m)
        assert vehicles.rear_station_m[0] == pytest.approx(550 - 2.5)
    else:
        assert np.isnan(vehicles.station_m[0])


def test_speed_is_along_the_approach_and_negative_against_it() -> None:
    vehicles = assign(fleet([(1, 10), (1, 20), (1, 30)], [(0, 12), (3, -7), (5, 0)]), (NORTH,))
    np.testing.assert_allclose(vehicles.speed_mps, [12, -7, 0])


def test_opposite_carriageways_share_no_vehicles() -> None:
    """Two axes back to back: a vehicle near the median goes where it drives to."""
    south = Approach("SB", np.array([[-0.5, 100.0], [-0.5, 0.0]]), 0.0, 2, 3.5)
    tracks = fleet([(0.5, 50), (0.5, 50), (-1.0, 50), (-1.0, 50)], [(0, 9), (0, -9)] * 2)
    for roads in ((NORTH, south), (south, NORTH)):
        vehicles = KnownRoad(roads).locate(tracks)
        names = [roads[i].name for i in vehicles.approach]
        assert names == ["NB", "SB", "NB", "SB"]
        assert (vehicles.speed_mps > 0).all()


def test_a_wrong_way_vehicle_alone_stays_on_its_approach() -> None:
    vehicles = assign(fleet([(1.0, 50.0)], [(0.0, -20.0)]), (NORTH,))
    assert vehicles.approach[0] == 0
    assert vehicles.speed_mps[0] == -20.0


def test_what_is_far_beyond_the_ends_of_an_axis_is_not_on_it() -> None:
    """NORTH runs from 0 to 100 m; twenty metres more on both sides still count."""
    vehicles = assign(fleet([(1, y) for y in (-21, -19, 50, 119, 121)]), (NORTH,))
    assert vehicles.approach.tolist() == [-1, 0, 0, 0, -1]


def test_no_road_and_no_tracks() -> None:
    vehicles = assign(fleet([(0, 0)]), ())
    assert vehicles.approach.tolist() == [-1]
    assert not is_on(vehicles, 0).any()
    assert len(assign(fleet([]), (NORTH,))) == 0


def test_a_vehicle_without_a_place_is_on_no_approach() -> None:
    vehicles = assign(fleet([(math.nan, math.nan)]), (NORTH,))
    assert vehicles.approach.tolist() == [-1]
