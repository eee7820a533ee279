"""The road view: places go through it and back, and its pixels stay on their place."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from rasters import STRAIGHT, arc, camera, frame, painted

from queuetail.geo.ground import apply_homography, enu_to_px, px_to_enu
from queuetail.traffic.road import locate, place
from queuetail.types import MAYBE, MOVED, Approach, Floats, Image, LaneDetections, RoadRaster
from queuetail.vision.road_view import RoadView
from queuetail.vision.strip import SAGITTA_M, StripBand, plan_strip

SIZE, SMALL = (1280, 720), (640, 360)
APPROACHES = {"straight": STRAIGHT, "bend": arc(), "tight bend": arc(100.0, 120.0)}


def planned(approach: Approach, **view: float) -> StripBand:
    plan = plan_strip([approach], camera(**view), SIZE)
    assert plan is not None
    return plan.bands[0]


def detections(columns: Floats, row: float) -> LaneDetections:
    n = len(columns)
    cut = np.zeros(n, np.bool_)
    band = np.zeros(n, np.int64)
    return LaneDetections(
        band, band + 1, columns, columns + 30.0, np.full(n, row), cut, cut,
        np.full(n, 0.5), np.ones(n), cut, cut, cut,
    )  # fmt: skip


@pytest.mark.parametrize("approach", APPROACHES.values(), ids=APPROACHES.keys())
def test_raster_pixels_lie_where_their_station_and_offset_say(approach: Approach) -> None:
    """Raster → ENU by the tiles, then ENU → station and offset by the road.

    A perspective tile on a bend is exact at its corners only: a fifth of a lane off between them.
    """
    band = planned(approach)
    off_m = 0.05 if approach is STRAIGHT else approach.lane_width_m / 5
    for tile in band.tiles:
        columns = np.linspace(tile.first_column, tile.first_column + tile.columns, 9)
        for row in (0.0, band.rows / 2, float(band.rows)):
            at = np.column_stack([columns, np.full(9, band.first_row + row)])
            station, offset, _ = locate(approach, apply_homography(tile.H_enu_raster, at))
            assert station == pytest.approx(band.station_m(columns), abs=off_m)
            expected = band.left_offset_m - row * band.metres_per_px
            assert offset == pytest.approx(np.full(9, expected), abs=off_m)


@pytest.mark.parametrize("approach", APPROACHES.values(), ids=APPROACHES.keys())
def test_tiles_cover_the_band_once_and_leave_the_axis_by_less_than_the_sagitta(
    approach: Approach,
) -> None:
    band = planned(approach)
    ends = [(t.first_column, t.first_column + t.columns) for t in band.tiles]
    assert ends[0][0] == 0
    assert ends[-1][1] == band.columns
    assert all(a[1] == b[0] for a, b in pairwise(ends))
    for first, last in ends:
        points = place(approach, band.station_m(np.linspace(first, last, 33)), np.zeros(33))
        chord = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        aside = points - points[0]
        assert np.abs(chord[0] * aside[:, 1] - chord[1] * aside[:, 0]).max() < 1.3 * SAGITTA_M
    assert len(ends) == 1 or approach is not STRAIGHT


@given(
    height_m=st.floats(40, 200),
    pitch_deg=st.floats(-90, -40),
    yaw_deg=st.floats(-180, 180),
    aim=st.tuples(st.floats(0.15, 0.85), st.floats(0.2, 0.85)),
)
@settings(max_examples=20)
def test_what_is_drawn_at_a_place_is_found_at_that_place(
    height_m: float, pitch_deg: float, yaw_deg: float, aim: tuple[float, float]
) -> None:
    """A white patch on a road, seen from anywhere, comes back at its station and offset."""
    mapping = camera(height_m, pitch_deg, yaw_deg, SMALL)
    patch = px_to_enu(mapping, np.array([aim]) * SMALL)
    road = Approach("R", patch + np.array([[-150.0, 3.6], [150.0, 3.6]]), 50.0, 2, 3.6)

    def brightness(enu: Floats) -> Floats:
        station, offset, _ = locate(road, enu)
        on = (np.abs(station - 200.0) < 3.0) & (np.abs(offset + 3.6) < 1.5)
        return np.where(on, 230.0, 60.0)

    view = RoadView()
    raster = view.render(frame(painted(mapping, SMALL, brightness)), mapping, (road,))
    assume(raster.bands and raster.spans[0][0] < 195 and raster.spans[0][1] > 205)
    rows, columns = np.nonzero(raster.image > 145)
    ends = np.array([columns.min(), columns.max() + 1.0])
    points = view.locate(detections(ends, rows.mean() + 0.5), raster, mapping)
    px = enu_to_px(mapping, patch + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    pixel_m = float(1.0 / np.linalg.norm(px[1:] - px[0], axis=1).min())
    assert points.rear_m == pytest.approx([197.0, 203.0], abs=1.0 * pixel_m + 0.1)
    assert points.offset_m[0] == pytest.approx(-3.6, abs=0.7 * pixel_m + 0.1)


@pytest.mark.parametrize(("road", "station_m"), [(STRAIGHT, 400.0), (arc(), 122.0)])
def test_colours_lie_where_brightness_does(road: Approach, station_m: float) -> None:
    """One patch, in luma and in chroma planes of half the size, on straight and bent roads."""

    def patch(enu: Floats) -> Floats:
        station, offset, _ = locate(road, enu)
        on = (np.abs(station - station_m) < 5.0) & (np.abs(offset + 3.6) < 1.5)
        return np.where(on, 200.0, 128.0)

    mapping = camera(70.0)
    luma = painted(mapping, (1280, 720), patch)
    chroma = painted(camera(70.0, size=(640, 360)), (640, 360), patch)
    seen = dataclasses.replace(frame(luma), chroma=(chroma, chroma))
    raster = RoadView().render(seen, mapping, (road,))
    assert raster.colour is not None
    assert raster.colour.shape == (2, *((n + 1) // 2 for n in raster.image.shape))
    bright = np.argwhere(raster.image > 164)
    for coloured in (np.argwhere(plane > 164) for plane in raster.colour):
        assert 2 * coloured.mean(axis=0) + 0.5 == pytest.approx(bright.mean(axis=0), abs=0.6)
        assert 4 * len(coloured) == pytest.approx(len(bright), rel=0.1)


def test_a_video_without_colours_gives_a_raster_without() -> None:
    mapping = camera(60.0)
    raster = RoadView().render(frame(np.full((720, 1280), 90, np.uint8)), mapping, (STRAIGHT,))
    assert raster.colour is None


def test_visible_columns_are_those_whose_lanes_are_in_the_picture() -> None:
    mapping = camera(60.0)
    view = RoadView()
    raster = view.render(frame(np.full((720, 1280), 90, np.uint8)), mapping, (STRAIGHT,))
    first_m, last_m = raster.spans[0]
    half_m = 60.0 * np.tan(np.radians(42.0))
    assert first_m == pytest.approx(400.0 - half_m, abs=5.0)
    assert last_m == pytest.approx(400.0 + half_m, abs=5.0)
    begin, end = raster.bands[0].visible_columns
    assert (raster.image[:, begin + 1 : end - 1] > 0).all()


def textured(enu: Floats) -> Floats:
    waves = np.sin(enu[:, 0] * 0.9) + np.sin(enu[:, 0] * 0.23 + enu[:, 1] * 0.4)
    return 110.0 + 30.0 * waves


def test_a_new_layout_keeps_its_columns_on_the_same_places_of_the_road() -> None:
    """A camera that moves along the road lays it out anew on one grid."""
    view, rasters = RoadView(), []
    for t_s, shift_deg in ((0.0, 0.0), (1.0, 0.00045)):
        mapping = camera(at=(36.11, -97.057 + shift_deg))
        luma = painted(mapping, SIZE, textured)
        found = view.render(frame(luma, t_s), mapping, ROADS)
        rasters.append((found.image.astype(float), found))
    (before, old), (after, new) = rasters
    assert new.plan == old.plan + 1
    assert new.px_per_m == old.px_per_m
    shift = new.bands[0].first_column - old.bands[0].first_column
    assert shift * 1.0 / new.px_per_m == pytest.approx(40.5, abs=3.0)
    width = min(before.shape[1] - shift, after.shape[1])
    common = np.s_[:, 40 : width - 40]
    difference = before[:, shift:][common] - after[common]
    assert np.median(np.abs(difference)) < 1.5


ROADS = (STRAIGHT,)


def test_a_small_drift_does_not_lay_out_anew() -> None:
    view = RoadView()
    plans = set()
    for step in range(4):
        mapping = camera(at=(36.11, -97.057 + step * 1e-5))
        luma = np.full((720, 1280), 90, np.uint8)
        plans.add(view.render(frame(luma, step * 0.5), mapping, ROADS).plan)
    assert len(plans) == 1


def rendered(size: tuple[int, int]) -> tuple[Image, RoadRaster]:
    mapping = camera(size=size)
    rng = np.random.default_rng(1)
    luma = painted(mapping, size, textured).astype(float) + rng.normal(0, 4, size[::-1])
    found = RoadView().render(frame(np.clip(luma, 1, 255).astype(np.uint8)), mapping, ROADS)
    return found.image, found


def test_a_4k_picture_gives_the_raster_of_a_1080p_one_with_no_more_noise() -> None:
    small, a = rendered((1920, 1080))
    large, b = rendered((3840, 2160))
    assert a.spans[0] == pytest.approx(b.spans[0], abs=3.0)
    small_m = cv2.resize(small, large.shape[::-1]).astype(float)
    inner = np.s_[:, 60:-60]
    assert np.median(np.abs(small_m[inner] - large.astype(float)[inner])) < 4.0
    scale = b.px_per_m / a.px_per_m
    assert 0.9 < scale < 2.2


def test_a_road_that_is_not_in_the_picture_gives_no_bands() -> None:
    far = Approach("far", np.array([[5000.0, 5000.0], [5600.0, 5000.0]]))
    view = RoadView()
    mapping = camera()
    found = view.render(frame(np.full((720, 1280), 90, np.uint8)), mapping, (far,))
    assert found.bands == ()
    assert found.spans == {}
    nothing = detections(np.empty(0), 0.0)
    assert len(view.locate(nothing, found, mapping)) == 0
    assert view.cover([(0, 1, 10.0, 20.0, True, True)]).size == 0


def test_a_cover_lies_over_its_vehicle_and_leans_away_from_the_camera() -> None:
    mapping = camera(80.0, -45.0)
    north = (Approach("N", np.array([[-300.0, 70.0], [300.0, 70.0]]), 100.0, 2, 3.6),)
    view = RoadView()
    found = view.render(frame(np.full((720, 1280), 90, np.uint8)), mapping, north)
    middle_m = sum(found.spans[0]) / 2
    cover = view.cover([(0, 2, middle_m, middle_m + 4.6, True, True)])
    rows, columns = np.nonzero(cover)
    band = found.bands[0]
    first = (middle_m - found.spans[0][0]) * found.px_per_m + band.visible_columns[0]
    assert columns.min() <= first + 1
    assert columns.max() + 1 >= first + 4.6 * found.px_per_m - 1
    assert rows.min() <= band.lane_rows[1] <= rows.max()
    assert rows.min() < band.lane_rows[1] - 0.5 * band.lane_width_px  # away is to the left
    elsewhere = [(0, 3, middle_m, middle_m + 4.6, True, True), (1, 1, 0.0, 9.0, True, True)]
    assert not view.cover(elsewhere).any()
    assert cover.max() == MOVED
    never_moved = (0, 2, middle_m, middle_m + 4.6, True, False)
    assert np.unique(view.cover([never_moved])).tolist() == [0, MAYBE]


def test_where_cars_are_is_said_lane_by_lane() -> None:
    view = RoadView()
    found = view.render(frame(np.full((720, 1280), 90, np.uint8)), camera(), (STRAIGHT,))
    middle_m = sum(found.spans[0]) / 2
    car = (0, 2, middle_m, middle_m + 4.6, True, True)
    truck = (0, 1, middle_m, middle_m + 16.0, False, True)
    (low,) = view.low([car, truck, (0, 3, middle_m, middle_m + 4.6, True, True)])
    assert not low[0].any()
    assert low[1].sum() == pytest.approx(4.6 * found.px_per_m, abs=2)
