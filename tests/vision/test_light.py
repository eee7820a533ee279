"""The light on the road: clouds count, trees and vehicles do not."""

from __future__ import annotations

import numpy as np
import pytest
from rasters import PX_PER_M

from queuetail.types import Image
from queuetail.vision.light import light_along, without_trees

ROWS, COLUMNS = 60, 1000  # of 0.2 m
ROAD = np.full((ROWS, COLUMNS), 100.0, np.float32)
ALL: Image = np.full((ROWS, COLUMNS), 255, np.uint8)


def picture(light: float, first: int, last: int) -> Image:
    """Return the road in full light, and in another from one column to another."""
    image = np.full((ROWS, COLUMNS), 100.0)
    image[:, first:last] *= light
    return image.astype(np.uint8)


def test_even_light_is_measured() -> None:
    light = light_along(picture(0.8, 0, COLUMNS), ALL, ROAD, PX_PER_M)
    assert light == pytest.approx(np.full(COLUMNS, 0.8), abs=0.01)


@pytest.mark.parametrize(("first", "last"), [(0, 25), (480, 530), (975, 1000)])
def test_a_tree_is_too_short_for_a_cloud(first: int, last: int) -> None:
    """Shade across the whole road, and at either end of what is seen of it."""
    light = light_along(picture(0.6, first, last), ALL, ROAD, PX_PER_M)
    assert light == pytest.approx(np.ones(COLUMNS), abs=0.03)


def test_a_clouds_shadow_keeps_its_depth_and_its_edge() -> None:
    light = light_along(picture(0.6, 500, COLUMNS), ALL, ROAD, PX_PER_M)
    assert light[:450] == pytest.approx(np.ones(450), abs=0.02)
    assert light[550:] == pytest.approx(np.full(450, 0.6), abs=0.02)


def test_where_no_bare_road_is_seen_the_light_is_that_beside_it() -> None:
    free = ALL.copy()
    free[:, 300:600] = 0
    light = light_along(picture(2.0, 300, 600), free, ROAD, PX_PER_M)
    assert light == pytest.approx(np.ones(COLUMNS), abs=0.02)


def test_without_any_bare_road_light_is_as_it_was() -> None:
    light = light_along(picture(0.5, 0, COLUMNS), np.zeros_like(ALL), ROAD, PX_PER_M)
    assert light == pytest.approx(np.ones(COLUMNS))


def test_a_short_road_has_one_light() -> None:
    short = np.linspace(0.9, 1.1, 40, dtype=np.float32)
    assert np.ptp(without_trees(short, PX_PER_M)) < 0.1
