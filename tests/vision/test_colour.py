"""Colours: what is as bright as the road is told by them, and tints, shadows and paint are not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rasters import asphalt, band, car_box, no_protection, raster, seen

from queuetail.types import Floats, Image
from queuetail.vision.asphalt import RoadBackground

OF = band()
STEP_S = 0.1
GREY, RED, FAINT_BLUE = (128.0, 128.0), (112.0, 176.0), (133.0, 126.0)
LEVEL = 90.0
CAR = car_box(OF, 2, 300)


def half(box: tuple[slice, slice]) -> tuple[slice, slice]:
    rows, columns = ((s.start // 2, (s.stop + 1) // 2) for s in box)
    return np.s_[rows[0] : rows[1], columns[0] : columns[1]]


def chroma(*painted: tuple[tuple[slice, slice], tuple[float, float]]) -> Floats:
    """Return the two colour planes of a grey road with boxes painted on it."""
    planes = np.full((2, (OF.rows[1] + 1) // 2, (OF.columns + 1) // 2), 128.0)
    for box, colour in painted:
        planes[(slice(None), *half(box))] = np.array(colour)[:, None, None]
    return planes


class Film:
    """Drives a background with noisy pictures whose brightness and colours are given."""

    def __init__(self) -> None:
        self.background, self.road = RoadBackground(), asphalt(OF, level=LEVEL)
        self.t_s, self._rng = 0.0, np.random.default_rng(1)

    def show(
        self,
        colours: Floats | None,
        luma: Image | None = None,
        seconds: float = STEP_S,
        protect: Image | None = None,
    ) -> Image:
        """Return what is foreign at the end."""
        protect = no_protection(OF) if protect is None else protect
        for _ in range(max(round(seconds / STEP_S), 1)):
            colour = None
            if colours is not None:
                noisy = np.rint(colours + self._rng.normal(0, 1.0, colours.shape))
                colour = np.clip(noisy, 1, 255).astype(np.uint8)
            picture = raster(seen(self.road if luma is None else luma, self._rng), OF)
            picture = dataclasses.replace(picture, colour=colour)
            masks = self.background.apply(picture, self.t_s, protect)
            self.t_s += STEP_S
        return masks.foreign


def share(mask: Image, box: tuple[slice, slice] = np.s_[:, :]) -> float:
    return float((mask[box] > 0).mean())


def test_a_red_car_as_bright_as_asphalt_is_seen() -> None:
    film = Film()
    assert share(film.show(chroma(), seconds=2.0)) < 0.01
    foreign = film.show(chroma((CAR, RED)))
    assert share(foreign, CAR) > 0.8
    beside = foreign.copy()
    beside[CAR[0].start - 2 : CAR[0].stop + 2, CAR[1].start - 2 : CAR[1].stop + 2] = 0
    assert share(beside) < 0.01


def test_it_is_seen_in_the_first_picture() -> None:
    assert share(Film().show(chroma((CAR, RED))), CAR) > 0.8


def test_a_video_without_colours_is_looked_at_by_brightness_alone() -> None:
    film = Film()
    film.show(None, seconds=1.0)
    bright = film.road.copy()
    bright[CAR] = 180.0
    assert share(film.show(None, bright), CAR) > 0.9


def test_light_that_tints_everything_is_no_vehicle() -> None:
    film = Film()
    for step in range(60):
        colours = chroma() + np.array([0.5, -0.4])[:, None, None] * step
        assert share(film.show(colours)) < 0.01
    assert share(film.show(colours, seconds=0.5)) < 0.01


def test_a_camera_that_changes_its_white_balance_at_once_shows_no_vehicles() -> None:
    film = Film()
    film.show(chroma(), seconds=2.0)
    for _ in range(20):
        assert share(film.show(chroma() + np.array([25.0, -18.0])[:, None, None])) < 0.01
    tinted = chroma((CAR, RED)) + np.array([25.0, -18.0])[:, None, None]
    assert share(film.show(tinted), CAR) > 0.8


def test_the_blue_of_the_sky_in_a_shadow_is_no_colour() -> None:
    film = Film()
    film.show(chroma(), seconds=2.0)
    assert share(film.show(chroma((CAR, FAINT_BLUE))), CAR) < 0.05


@pytest.mark.parametrize("level", [40.0, 150.0])
def test_colours_are_as_weak_as_the_light(level: float) -> None:
    """Under a cloud or at dusk a blue trailer differs from road by a few levels only."""
    film = Film()
    film.road = asphalt(OF, level=level)
    weak = (128.0 + 0.3 * level * 0.9, 128.0 - 0.25 * level * 0.9)
    film.show(chroma(), seconds=2.0)
    assert share(film.show(chroma((CAR, weak))), CAR) > 0.8


def test_paint_on_the_road_is_learnt_and_a_known_vehicle_is_not() -> None:
    film = Film()
    film.show(chroma(), seconds=2.0)
    assert share(film.show(chroma((CAR, RED)), seconds=8.0), CAR) < 0.1
    film = Film()
    film.show(chroma(), seconds=2.0)
    protect = no_protection(OF)
    protect[CAR] = 255
    assert share(film.show(chroma((CAR, RED)), seconds=30.0, protect=protect), CAR) > 0.8


def test_where_the_picture_shows_nothing_nothing_is_foreign() -> None:
    film = Film()
    film.road[:, :200] = 0.0
    colours = chroma()
    for _ in range(20):
        colours[:, :, :100] = 0.0
        image = film.show(colours)
        assert share(image[:, 210:]) < 0.01
