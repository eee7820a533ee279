"""The road of a first picture: asphalt, even where it is full of vehicles."""

from __future__ import annotations

import numpy as np
import pytest
from rasters import PX_PER_M, asphalt, band, car_box, with_car

from queuetail.vision.first_road import first_road, road_profile, row_modes

OF = band()


def test_a_lane_full_of_trucks_of_one_colour_is_no_other_road() -> None:
    road = asphalt(OF)
    full = road.copy()
    middle = round(OF.lane_rows[1])
    full[middle - 7 : middle + 7, :] = 160.0
    assert row_modes(full)[middle] == pytest.approx(160, abs=1)
    assert road_profile(full, OF, PX_PER_M)[middle] == pytest.approx(90, abs=8)
    first = first_road(full, OF, PX_PER_M)
    assert not first.alike[middle - 6 : middle + 6].any()


def test_a_solid_line_is_part_of_the_road() -> None:
    road = asphalt(OF)
    road[12:14] = 200.0
    assert road_profile(road, OF, PX_PER_M)[12:14] == pytest.approx([200, 200], abs=1)


def test_a_line_that_a_row_shows_here_and_there_is_not_its_road() -> None:
    """Coarse asphalt has many levels and paint has one, which may be the most common of all."""
    rng = np.random.default_rng(0)
    road = 110.0 + rng.normal(0.0, 12.0, (OF.rows[1], OF.columns)).astype(np.float32)
    row = round(OF.lane_rows[0])
    road[row, ::4] = 200.0
    assert row_modes(road)[row] == pytest.approx(200, abs=1)
    assert road_profile(road, OF, PX_PER_M)[row] == pytest.approx(110, abs=8)


def test_cars_are_left_out_and_bare_road_is_believed() -> None:
    road = asphalt(OF)
    first = first_road(with_car(road, OF, 1, 300), OF, PX_PER_M)
    assert first.alike[car_box(OF, 1, 300)].mean() < 0.1
    assert first.alike[car_box(OF, 1, 400)].mean() > 0.95
    assert first.road[car_box(OF, 1, 300)].mean() == pytest.approx(90, abs=3)


@pytest.mark.parametrize("sigma", [2.0, 12.0])
def test_coarse_asphalt_is_known_by_its_grain(sigma: float) -> None:
    road = 150.0 + np.random.default_rng(0).normal(0.0, sigma, (OF.rows[1], OF.columns))
    first = first_road(road.astype(np.float32), OF, PX_PER_M)
    assert first.grain == pytest.approx(sigma, rel=0.5, abs=2.0)
    assert first.alike.mean() > 0.95


def test_a_tree_across_the_road_is_not_taken_for_light() -> None:
    road = asphalt(OF)
    road[:, 300:335] *= 0.6
    first = first_road(road, OF, PX_PER_M)
    assert first.alike[:, :290].mean() > 0.95
    assert first.alike[:, 345:].mean() > 0.95
    assert first.alike[:, 305:330].mean() < 0.05


def test_what_the_picture_does_not_show_says_nothing_of_the_light() -> None:
    road = asphalt(OF)
    road[:, :200] = 0.0
    first = first_road(road, OF, PX_PER_M)
    assert first.alike[:, 210:].mean() > 0.95
    assert first.road[:, 210:].mean() == pytest.approx(road[:, 210:].mean(), abs=2)


def test_what_covers_both_shoulders_may_be_a_bridge() -> None:
    road = asphalt(OF)
    road[:, 280:330] = 150.0
    first = first_road(road, OF, PX_PER_M)
    assert first.occluded[285:325].all()
    assert not first.occluded[:275].any()
    assert not first.occluded[335:].any()
    assert first.road[:, 285:325].mean() == pytest.approx(150.0, abs=3.0)
