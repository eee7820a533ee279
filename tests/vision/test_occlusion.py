"""What a tall vehicle hides of the lane behind it, and what still shows beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from rasters import PX_PER_M, band, car_box

from queuetail.types import Band, Image
from queuetail.vision.occlusion import lane_rows

LEAN = 0.5  # metres across the road per metre of height: a camera 27° from the nadir
LEFT = band(lean_px=(0.0, -LEAN * PX_PER_M))  # the camera stands to the right of the road
RIGHT = band(lean_px=(0.0, LEAN * PX_PER_M))


def body(of: Band, lane: int, rear: int, length: int, width_m: float, height_m: float) -> Image:
    """Return the silhouette of a box on a lane, smeared away from the camera by its height."""
    mask = np.zeros((of.rows[1], of.columns), np.uint8)
    half, lean = width_m / 2 * PX_PER_M, float(of.lean_px[0, 1]) * height_m
    middle = of.lane_rows[lane - 1]
    top, bottom = middle - half + min(lean, 0), middle + half + max(lean, 0)
    mask[max(round(top), 0) : round(bottom), rear : rear + length] = 255
    return mask


def truck(of: Band, lane: int) -> Image:
    return body(of, lane, 200, 80, 2.5, 4.0)


def test_from_above_nothing_is_hidden() -> None:
    flat = band()
    for rows in lane_rows(truck(flat, 2), flat, PX_PER_M):
        assert not rows.partly.any()


@pytest.mark.parametrize(("of", "near", "far"), [(LEFT, 2, 1), (RIGHT, 1, 2)])
def test_a_truck_hides_some_of_the_lane_behind_it_only(of: Band, near: int, far: int) -> None:
    rows = lane_rows(truck(of, near), of, PX_PER_M)
    assert rows[far - 1].partly[210:270].all()
    assert not rows[far - 1].partly[:190].any()
    assert not rows[far - 1].partly[290:].any()
    assert not rows[near - 1].partly.any()
    # Its own silhouette is no vehicle there.
    assert rows[far - 1].cover(truck(of, near))[210:270].max() < 0.2 * 255


@pytest.mark.parametrize(("of", "near", "far"), [(LEFT, 2, 1), (RIGHT, 1, 2)])
def test_a_car_behind_a_truck_shows_its_roof_beyond_it(of: Band, near: int, far: int) -> None:
    scene = truck(of, near) | body(of, far, 230, 23, 1.8, 1.4)
    rows = lane_rows(scene, of, PX_PER_M)[far - 1]
    cover = rows.cover(scene) / 255
    assert cover[234:249].min() > 0.6
    assert cover[205:225].max() < 0.3
    assert not rows.hidden[234:249].any()


def test_what_is_lower_still_is_hidden() -> None:
    low = band(lean_px=(0.0, -1.0 * PX_PER_M))  # 45°: a truck hides a car beside it altogether
    rows = lane_rows(truck(low, 2), low, PX_PER_M)[0]
    assert rows.hidden[210:270].all()
    assert rows.cover(truck(low, 2))[210:270].max() == 0


def test_what_is_known_to_be_a_car_hides_nothing() -> None:
    """Cars before a truck look like one tall thing; the tracker knows better."""
    scene = body(LEFT, 1, 200, 80, 2.5, 4.0)
    for rear in (205, 236, 267):
        scene |= body(LEFT, 2, rear, 27, 1.8, 1.5)
    scene[40:50, 205:294] = 255  # and their shadows join them
    low = np.zeros((2, LEFT.columns), np.bool_)
    low[1, 200:300] = True
    assert not lane_rows(scene, LEFT, PX_PER_M, low)[0].partly.any()


def test_a_row_of_cars_hides_nothing() -> None:
    scene = np.zeros((LEFT.rows[1], LEFT.columns), np.uint8)
    for rear in range(100, 400, 33):
        scene |= body(LEFT, 2, rear, 23, 1.8, 1.4)
        scene[car_box(LEFT, 1, rear + 3)] = 255
    assert not lane_rows(scene, LEFT, PX_PER_M)[0].partly.any()


def test_a_reach_to_the_end_of_the_raster_hides_the_lane_there() -> None:
    low = band(lean_px=(0.0, -2.0 * PX_PER_M))  # so low that the silhouette leaves the raster
    scene = body(low, 2, 200, 80, 2.5, 8.0)
    rows = lane_rows(scene, low, PX_PER_M)[0]
    assert rows.hidden[210:270].all()
    assert rows.cover(scene)[210:270].max() == 0
