"""Motion along the lanes: speeds without tracks, and nothing where nothing tells."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasters import PX_PER_M, asphalt, band, raster, seen, with_car

from queuetail.types import Floats, Image, RoadRaster
from queuetail.vision.flow import FASTEST_MPS, LaneFlow

ROAD = band()


def at(image: Image, t_s: float, plan: int = 1) -> RoadRaster:
    return dataclasses.replace(raster(image, ROAD, plan), t_s=t_s)


def moving(
    lane: int, rear: int, columns: int, dt_s: float = 0.1, levels: tuple[float, float] = (170, 170)
) -> Floats:
    """Return the speeds of a car that moves by so many columns between two pictures."""
    flow, rng, road = LaneFlow(), np.random.default_rng(7), asphalt(ROAD)
    flow.measure(at(seen(with_car(road, ROAD, lane, rear, levels[0]), rng), 0.0))
    later = with_car(road, ROAD, lane, rear + columns, levels[1])
    return flow.measure(at(seen(later, rng), dt_s))[0]


@given(columns=st.integers(0, 19), dt_s=st.sampled_from([1 / 15, 0.1, 0.2]), lane=st.integers(1, 2))
@settings(max_examples=40)
def test_a_car_s_speed_is_seen_from_two_pictures(columns: int, dt_s: float, lane: int) -> None:
    speed = columns / PX_PER_M / dt_s
    if speed > FASTEST_MPS - 1:
        return
    there = moving(lane, 200, columns, dt_s)[lane - 1, 205 + columns : 218 + columns]
    assert np.isfinite(there).mean() > 0.7
    assert np.nanmedian(there) == pytest.approx(speed, abs=0.12 / PX_PER_M / dt_s)


def test_fractions_of_a_column_count() -> None:
    """A picture moved by half a column: the mean of two that are a column apart."""
    flow, road = LaneFlow(), asphalt(ROAD)
    first = with_car(road, ROAD, 1, 200).astype(float)
    second = with_car(road, ROAD, 1, 201).astype(float)
    flow.measure(at(first.astype(np.uint8), 0.0))
    speeds = flow.measure(at(((first + second) / 2).astype(np.uint8), 0.1))[0]
    assert np.nanmedian(speeds[0, 205:218]) == pytest.approx(0.5 / PX_PER_M / 0.1, rel=0.3)


def test_bare_road_tells_nothing() -> None:
    flow, rng, road = LaneFlow(), np.random.default_rng(1), asphalt(ROAD)
    flow.measure(at(seen(road, rng), 0.0))
    assert np.isnan(flow.measure(at(seen(road, rng), 0.1))[0]).mean() > 0.97


def test_what_appears_out_of_nothing_has_no_speed() -> None:
    flow, rng, road = LaneFlow(), np.random.default_rng(1), asphalt(ROAD)
    flow.measure(at(seen(road, rng), 0.0))
    speeds = flow.measure(at(seen(with_car(road, ROAD, 2, 300), rng), 0.1))[0]
    assert np.isnan(speeds[1, 305:318]).all()


@pytest.mark.parametrize(("t_s", "plan"), [(0.0, 1), (-1.0, 1), (3.0, 1), (0.1, 2)])
def test_only_pictures_of_one_layout_a_moment_apart_are_compared(t_s: float, plan: int) -> None:
    flow, road = LaneFlow(), asphalt(ROAD)
    picture = with_car(road, ROAD, 1, 200).astype(np.uint8)
    flow.measure(at(picture, 0.0))
    assert np.isnan(flow.measure(at(picture, t_s, plan))[0]).all()
