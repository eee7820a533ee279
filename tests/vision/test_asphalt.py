"""The learnt road: what stops stays foreign, what leaves melts, and light is no vehicle."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rasters import asphalt, band, car_box, no_protection, raster, seen, with_car

from queuetail.types import MAYBE, MOVED, Band, Bools, Floats, Image, Masks, RoadRaster
from queuetail.vision.asphalt import RoadBackground
from queuetail.vision.lanes import LaneDetector

OF = band()
STEP_S = 1 / 10
BODY = 0.75  # of a car's box that must be foreign: glass may have the road's colour


class Film:
    """Drives a background with noisy pictures of a painted road."""

    def __init__(self, of: Band = OF, seed: int = 0) -> None:
        self.band, self.road = of, asphalt(of)
        self.background = RoadBackground()
        self.t_s = 0.0
        self._rng = np.random.default_rng(seed)

    def show(
        self,
        picture: Image | None = None,
        seconds: float = STEP_S,
        protect: Image | None = None,
        gain: float | Floats = 1.0,
        plan: int = 1,
    ) -> Masks:
        picture = self.road if picture is None else picture
        protect = no_protection(self.band) if protect is None else protect
        masks = None
        for _ in range(max(round(seconds / STEP_S), 1)):
            image = seen(picture, self._rng, gain)
            masks = self.background.apply(raster(image, self.band, plan), self.t_s, protect)
            self.t_s += STEP_S
        assert masks is not None
        return masks


def share(masks: Masks, box: tuple[slice, slice]) -> float:
    return float((masks.foreign[box] > 0).mean())


def around(of: Band, lane: int, rear: int) -> Image:
    mask = no_protection(of)
    mask[car_box(of, lane, rear - 3, 29)] = 255
    return mask


def bare(of: Band, *cars: tuple[int, int]) -> Bools:
    """Return which pixels are neither marking nor within a metre of a car."""
    free = np.ones((of.rows[1], of.columns), np.bool_)
    line = round((of.lane_rows[0] + of.lane_rows[1]) / 2)
    free[line - 2 : line + 2] = False
    for lane, rear in cars:
        free[car_box(of, lane, rear - 6, 35)] = False
    return free


def test_bare_road_is_not_foreign_and_its_markings_are_no_vehicles() -> None:
    film = Film()
    for seconds in (STEP_S, 3.0):
        masks = film.show(seconds=seconds)
        assert (masks.foreign[bare(OF)] > 0).mean() < 0.002
        assert len(LaneDetector().find(masks, raster(masks.foreign, OF))) == 0


@pytest.mark.parametrize("level", [50.0, 140.0])
def test_a_protected_car_that_stops_for_minutes_stays_foreign(level: float) -> None:
    film = Film()
    film.show(seconds=3.0)
    car = with_car(film.road, OF, 1, 300, level)
    box = car_box(OF, 1, 300)
    assert share(film.show(car), box) > BODY
    masks = film.show(car, seconds=120.0, protect=around(OF, 1, 300))
    assert share(masks, box) > BODY
    assert (masks.foreign[bare(OF, (1, 300))] > 0).mean() < 0.005


def queue() -> list[tuple[int, int, float]]:
    """Return lanes, rears and brightnesses of a dense standing queue."""
    rng = np.random.default_rng(5)
    levels = rng.choice([25.0, 45.0, 150.0, 185.0, 230.0], 24)
    return [(1 + n % 2, 150 + (n // 2) * 34, float(v)) for n, v in enumerate(levels)]


def test_a_queue_that_stands_in_the_first_picture_is_foreign_at_once() -> None:
    film = Film()
    cars = queue()
    picture = film.road
    for lane, rear, level in cars:
        picture = with_car(picture, OF, lane, rear, level)
    masks = film.show(picture)
    found = [share(masks, car_box(OF, lane, rear)) > 0.6 for lane, rear, _ in cars]
    assert np.mean(found) > 0.9
    protect = no_protection(OF)
    for lane, rear, _ in cars:
        protect |= around(OF, lane, rear)
    masks = film.show(picture, seconds=60.0, protect=protect)
    found = [share(masks, car_box(OF, lane, rear)) > 0.6 for lane, rear, _ in cars]
    assert np.mean(found) > 0.9
    assert (masks.foreign[:, :120] > 0).mean() < 0.01


def test_the_place_of_a_car_that_left_melts_within_two_seconds() -> None:
    """A car that was learnt as road, and then drives away."""
    film = Film()
    like_road = with_car(film.road, OF, 1, 300, 105.0)
    film.show(like_road, seconds=20.0)
    masks = film.show(seconds=2.0)
    assert share(masks, car_box(OF, 1, 300)) < 0.25


@pytest.mark.parametrize(("mark", "kept"), [(MOVED, True), (MAYBE, False)])
def test_only_who_has_moved_may_look_like_the_road(mark: int, kept: bool) -> None:
    """A van the colour of asphalt that stops, and a place that was taken for one."""
    film = Film()
    film.show(seconds=4.0)
    van = film.road.copy()
    box = car_box(OF, 1, 300, 30)
    van[box] = 100.0
    protect = np.where(around(OF, 1, 300) > 0, mark, 0).astype(np.uint8)
    before = share(film.show(van, protect=protect), box)
    for _ in range(80):
        masks = film.show(van, protect=protect)
    assert before > 0.3
    assert (share(masks, box) > 0.5 * before) is kept


def test_a_queue_of_the_first_picture_leaves_no_ghosts() -> None:
    film = Film()
    picture = film.road
    for lane, rear, level in queue():
        picture = with_car(picture, OF, lane, rear, level)
    film.show(picture, seconds=1.0)
    masks = film.show(seconds=2.0)
    left = [share(masks, car_box(OF, lane, rear)) > 0.3 for lane, rear, _ in queue()]
    assert np.mean(left) < 0.1


def cloud(at: float) -> Floats:
    """Return the light along the road under a cloud whose soft edge lies at a column."""
    columns = np.arange(OF.columns)
    return 1.0 - 0.4 / (1.0 + np.exp((columns - at) / 40.0))


LIGHTS: dict[str, Callable[[int], float | Floats]] = {
    "darker by a fifth at once": lambda step: 0.8,
    "brighter by a third at once": lambda step: 1.33,
    "a cloud's edge along the road": lambda step: cloud(10.0 * step),
    "day fades": lambda step: 1.0 - 0.008 * step,
}


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS.keys())
def test_changes_of_light_are_not_foreign_and_cars_in_them_are(
    light: Callable[[int], float | Floats],
) -> None:
    film = Film()
    film.show(seconds=3.0)
    car = with_car(film.road, OF, 2, 250, 200.0)
    for step in range(50):
        masks = film.show(car, gain=light(step), protect=around(OF, 2, 250))
        assert share(masks, car_box(OF, 2, 250)) > 0.6
        assert (masks.foreign[bare(OF, (2, 250))] > 0).mean() < 0.03


def test_bright_tells_bodies_from_cast_shadows() -> None:
    film = Film()
    film.show(seconds=2.0)
    shadow = film.road.copy()
    box = car_box(OF, 1, 200, 40)
    shadow[box] *= 0.5
    picture = with_car(shadow, OF, 1, 215, 220.0)
    masks = film.show(picture)
    assert (masks.bright[car_box(OF, 1, 202, 12)] > 0).mean() < 0.05
    assert (masks.bright[car_box(OF, 1, 217, 10)] > 0).mean() > 0.9
    assert masks.contrast[car_box(OF, 1, 217, 10)].mean() > 0.8


@pytest.mark.parametrize("level", [40.0, 140.0, 190.0])
def test_a_bridge_of_the_first_picture_belongs_to_the_scene(level: float) -> None:
    film = Film()
    film.road[:, 280:330] = level
    masks = film.show(seconds=1.0)
    assert (masks.foreign[:, 285:325] > 0).mean() < 0.1


def test_a_truck_between_shadows_that_looked_like_a_bridge_leaves_no_ghost() -> None:
    """Not even if a vehicle that moved is taken to stand there."""
    film = Film()
    there = film.road.copy()
    there[:, 280:330] = 150.0
    film.show(there, seconds=0.2)
    protect = no_protection(OF)
    protect[:, 280:330] = MOVED
    masks = film.show(seconds=1.5, protect=protect)
    assert (masks.foreign[:, 285:325][bare(OF)[:, 285:325]] > 0).mean() < 0.2


def test_a_layout_that_was_looked_at_briefly_hands_nothing_on() -> None:
    """A car the colour of asphalt in its first picture would be road ever after."""
    film, shift, car = Film(), 100, car_box(OF, 1, 300)
    film.road[car] = 112.0
    film.show(seconds=1.0)
    film.background._bare[car] = 255
    film.band = band(first_column=shift)
    film.road = np.concatenate([film.road[:, shift:], asphalt(OF, seed=9)[:, :shift]], axis=1)
    moved = (car[0], slice(car[1].start - shift, car[1].stop - shift))
    assert share(film.show(plan=2), moved) > 0.6


def test_the_road_learnt_is_carried_over_to_a_new_layout() -> None:
    """A stain learnt in one layout is not foreign in the first picture of the next."""
    film = Film()
    stain = car_box(OF, 1, 300)
    film.road[stain] = 112.0
    film.show(seconds=12.0)
    assert share(film.show(), stain) < 0.2
    shift = 100
    film.band = band(first_column=shift)
    film.road = np.concatenate([film.road[:, shift:], asphalt(OF, seed=9)[:, :shift]], axis=1)
    moved = (stain[0], slice(stain[1].start - shift, stain[1].stop - shift))
    masks = film.show(plan=2)
    assert share(masks, moved) < 0.3
    assert share(film.show(plan=3), moved) < 0.3  # at once again, as while the camera turns
    fresh = RoadBackground().apply(
        raster(seen(film.road, np.random.default_rng(0)), film.band), 0.0, no_protection(OF)
    )
    assert share(fresh, moved) > 0.6


def test_rows_that_were_learnt_from_a_queue_are_learnt_anew_once_it_is_gone() -> None:
    """Two lanes and their shoulders full of light trucks: nothing tells them from the road."""
    film = Film()
    queue_of_trucks = film.road.copy()
    queue_of_trucks[8:54] = 170.0
    film.show(queue_of_trucks, seconds=3.0)
    assert (film.show().foreign[20:50] > 0).mean() > 0.9
    masks = film.show(seconds=6.0)
    assert (masks.foreign[20:50] > 0).mean() < 0.1


def test_rows_that_lay_long_in_the_shadows_of_a_queue_are_not_learnt_dark() -> None:
    film = Film()
    film.show(seconds=3.0)
    beside_a_queue = film.road.copy()
    for rear in range(0, OF.columns, 60):
        beside_a_queue[20:30, rear : rear + 50] *= 0.6
    film.show(beside_a_queue, seconds=12.0)
    assert (film.show().foreign[20:30] > 0).mean() < 0.1


def test_road_that_is_seen_bare_for_the_first_time_is_believed_at_once() -> None:
    """Coarse asphalt under a queue: its grain is no vehicle, before and after it is learnt."""
    film = Film()
    grain = np.random.default_rng(5).normal(0.0, 9.0, film.road.shape)
    film.road = (150.0 + grain).astype(np.float32)
    truck = film.road.copy()
    truck[car_box(OF, 1, 100, 300)] = 60.0
    film.show(truck, seconds=2.0)
    masks = film.show(seconds=1.0)
    assert share(masks, car_box(OF, 1, 100, 300)) < 0.05


def test_what_the_picture_does_not_show_is_not_foreign() -> None:
    film = Film()
    film.show(seconds=1.0)
    rng = np.random.default_rng(1)
    image = seen(film.road, rng)
    image[:, :100] = 0
    masks = film.background.apply(raster(image, OF), film.t_s, no_protection(OF))
    assert not masks.foreign[:, :100].any()


def test_no_road_gives_empty_masks() -> None:
    nothing = RoadRaster(np.zeros((0, 0), np.uint8), 1.0, (), 1)
    masks = RoadBackground().apply(nothing, 0.0, np.zeros((0, 0), np.uint8))
    assert masks.foreign.size == 0


def test_pictures_at_the_same_time_change_nothing() -> None:
    film = Film()
    film.show(seconds=2.0)
    image = seen(with_car(film.road, OF, 1, 300), np.random.default_rng(2))
    for _ in range(50):
        masks = film.background.apply(raster(image, OF), film.t_s, no_protection(OF))
    assert share(masks, car_box(OF, 1, 300)) > BODY
