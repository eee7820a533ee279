"""Intervals along the lanes: their ends, what splits and joins them, and what is no vehicle."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rasters import PX_PER_M, band, car_box, masks_of, raster

from queuetail.types import Band, Image, LaneDetections, Masks
from queuetail.vision.lanes import (
    LEAN_HEIGHT_M,
    LaneDetector,
    body_runs,
    footprints,
)
from queuetail.vision.outlines import bridged, fill_outlines, silled

ROAD = band()


def empty(of: Band = ROAD) -> Image:
    return np.zeros((of.rows[1], of.columns), np.uint8)


def find(foreign: Image, of: Band = ROAD, bright: Image | None = None) -> LaneDetections:
    return LaneDetector().find(masks_of(foreign, bright), raster(foreign, of))


def drawn(rear_m: float, front_m: float, lane: int, supersampling: int = 16) -> Image:
    """Return the mask of a body whose ends lie anywhere between two columns.

    An end column belongs to it in as many rows as it covers of that column, as noise would have it.
    """
    mask = empty()
    middle = ROAD.lane_rows[lane - 1]
    top, bottom = round(middle - 4.5), round(middle + 4.5)
    columns = np.arange(ROAD.columns)
    cover = np.clip(np.minimum(columns + 1, front_m * PX_PER_M) - columns, 0, 1)
    cover -= np.clip(np.minimum(columns + 1, rear_m * PX_PER_M) - columns, 0, 1)
    rows = bottom - top
    for column in np.flatnonzero(cover > 0):
        mask[top : top + round(cover[column] * rows), column] = 255
    return mask


@given(rear_m=st.floats(20.0, 60.0), length_m=st.floats(3.5, 18.0), lane=st.integers(1, 2))
@settings(max_examples=60)
def test_ends_lie_where_the_body_ends_to_a_fraction_of_a_column(
    rear_m: float, length_m: float, lane: int
) -> None:
    found = find(drawn(rear_m, rear_m + length_m, lane))
    assert len(found) == 1
    assert found.lane[0] == lane
    assert found.rear_column[0] / PX_PER_M == pytest.approx(rear_m, abs=0.13)
    assert found.front_column[0] / PX_PER_M == pytest.approx(rear_m + length_m, abs=0.13)
    assert found.row[0] == pytest.approx(ROAD.lane_rows[lane - 1], abs=1.5)
    assert not found.cut_rear[0]
    assert not found.cut_front[0]


def test_a_gap_of_two_metres_splits_and_a_windscreen_does_not() -> None:
    mask = empty()
    mask[car_box(ROAD, 1, 100)] = 255
    mask[car_box(ROAD, 1, 100 + 23 + round(2.0 * PX_PER_M))] = 255
    mask[:, 115:118] = 0  # glass the colour of asphalt
    found = find(mask)
    assert found.rear_column.tolist() == pytest.approx([100, 133], abs=1)
    assert found.front_column.tolist() == pytest.approx([123, 156], abs=1)


def test_vehicles_side_by_side_are_two() -> None:
    mask = empty()
    for lane in (1, 2):
        mask[car_box(ROAD, lane, 200)] = 255
    found = find(mask)
    assert sorted(found.lane.tolist()) == [1, 2]


def astride_box(rear: int, length: int = 23, aside_m: float = 0.0) -> tuple[slice, slice]:
    """Return a car's rows and columns on the edge between lanes 1 and 2, or farther right."""
    middle = (ROAD.lane_rows[0] + ROAD.lane_rows[1]) / 2 + aside_m * PX_PER_M
    return np.s_[round(middle - 4.5) : round(middle + 4.5), rear : rear + length]


@pytest.mark.parametrize("aside_m", [-0.5, 0.0, 0.5])
def test_a_car_between_two_lanes_is_found_once(aside_m: float) -> None:
    mask = empty()
    mask[astride_box(200, aside_m=aside_m)] = 255
    mask[car_box(ROAD, 1, 300)] = 255
    found = find(mask)
    assert found.astride.tolist() == [False, True]
    assert found.lane.tolist() == [1, 1]
    assert found.rear_column[1] == pytest.approx(200, abs=1)
    assert found.front_column[1] == pytest.approx(223, abs=1)
    middle = (ROAD.lane_rows[0] + ROAD.lane_rows[1]) / 2
    assert found.row[1] == pytest.approx(middle + aside_m * PX_PER_M, abs=1)


def test_what_joins_two_cars_side_by_side_is_no_third() -> None:
    mask = empty()
    for lane in (1, 2):
        mask[car_box(ROAD, lane, 200)] = 255
    mask[astride_box(202, 18)] = 255
    assert not find(mask).astride.any()


def test_shade_between_two_lanes_is_no_vehicle() -> None:
    mask = empty()
    mask[astride_box(200)] = 255
    masks = masks_of(mask, None)
    masks.shade[:] = mask
    assert len(LaneDetector().find(masks, raster(mask, ROAD))) == 0


def test_what_the_picture_cuts_is_told_at_either_end() -> None:
    of = band(visible=(50, 550))
    mask = empty(of)
    for rear in (40, 300, 538):
        mask[car_box(of, 1, rear)] = 255
    found = find(mask, of)
    assert found.cut_rear.tolist() == [True, False, False]
    assert found.cut_front.tolist() == [False, False, True]
    assert found.rear_column[0] == pytest.approx(50, abs=1)
    assert found.front_column[2] == pytest.approx(550, abs=1)


def test_nothing_and_specks_are_no_vehicles() -> None:
    rng = np.random.default_rng(3)
    specks = np.where(rng.random(empty().shape) < 0.01, 255, 0).astype(np.uint8)
    assert len(find(empty())) == 0
    assert len(find(specks)) == 0


def test_an_outline_is_filled_and_the_road_between_two_vehicles_is_not() -> None:
    outline = empty()
    box = car_box(ROAD, 1, 200)
    outline[box] = 255
    inner = np.s_[box[0].start + 1 : box[0].stop - 1, box[1].start + 1 : box[1].stop - 1]
    outline[inner] = 0
    assert fill_outlines(outline, PX_PER_M)[0][box].all()
    two = empty()
    for rear in (100, 140):
        two[car_box(ROAD, 1, rear)] = 255
    assert not fill_outlines(two, PX_PER_M)[0][:, 126:138].any()


def smeared(solid: Image, lean: tuple[float, float], height_m: float) -> Image:
    """Return the silhouette of an upright body on a footprint: its copies up to its height."""
    out = solid.copy()
    for up_m in np.linspace(0, height_m, 40):
        M = np.array([[1, 0, lean[0] * up_m], [0, 1, lean[1] * up_m]], np.float64)
        moved = cv2.warpAffine(solid, M, solid.shape[::-1], flags=cv2.INTER_NEAREST)
        out = np.maximum(out, moved)
    return out


leans = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0))


@given(lean=leans, rear=st.integers(150, 400), length=st.integers(16, 80))
@settings(max_examples=60)
def test_a_footprint_is_what_is_left_of_its_leaning_silhouette(
    lean: tuple[float, float], rear: int, length: int
) -> None:
    """For bodies of bonnet height, whatever way and however far they lean."""
    solid = empty()
    box = car_box(ROAD, 1, rear, length)
    solid[box] = 255
    of = band(lean_px=lean)
    standing = footprints(smeared(solid, lean, LEAN_HEIGHT_M), of.lean_px)
    rows, columns = np.nonzero(standing)
    for found, drawn_from, drawn_to in (
        (columns, box[1].start, box[1].stop),
        (rows, box[0].start, box[0].stop),
    ):
        assert found.min() == pytest.approx(drawn_from, abs=1.5)
        assert found.max() + 1 == pytest.approx(drawn_to, abs=1.5)
    intervals = find(smeared(solid, lean, LEAN_HEIGHT_M), of)
    assert 1 in intervals.lane
    mine = int(np.argmax(intervals.lane == 1))
    assert intervals.rear_column[mine] == pytest.approx(rear, abs=2.0)


def test_what_leans_out_of_the_raster_keeps_its_footprint() -> None:
    lean = (0.0, -6.0)
    of = band(lean_px=lean)
    solid = empty(of)
    solid[1:6, 100:130] = 255
    assert footprints(smeared(solid, lean, 1.5), of.lean_px)[1:6, 100:130].all()


def shadowed(rear: int, bright: bool, shadow: int = 8) -> tuple[Image, Image]:
    """Return a car's silhouette with its cast shadow behind it, and its bright part."""
    foreign, shine = empty(), empty()
    foreign[car_box(ROAD, 1, rear - shadow, 23 + shadow)] = 255
    if bright:
        shine[car_box(ROAD, 1, rear)] = 255
    return foreign, shine


def test_a_cast_shadow_is_learnt_from_bright_vehicles_and_cut_from_dark_ones() -> None:
    detector = LaneDetector()

    def rear_of(bright: bool) -> float:
        foreign, shine = shadowed(200, bright)
        masks = masks_of(foreign, shine)
        return float(detector.find(masks, raster(foreign, ROAD)).rear_column[0])

    assert rear_of(False) == pytest.approx(192, abs=1)  # nothing is known of shadows yet
    for _ in range(5):
        rear_of(True)
    assert rear_of(True) == pytest.approx(200, abs=1.5)
    assert rear_of(False) == pytest.approx(200, abs=1.5)


def test_without_sun_nothing_is_cut() -> None:
    detector = LaneDetector()
    for _ in range(10):
        foreign, shine = shadowed(200, True, shadow=0)
        found = detector.find(masks_of(foreign, shine), raster(foreign, ROAD))
        assert found.rear_column[0] == pytest.approx(200, abs=1)


def test_cast_shade_on_the_next_lane_is_marked_and_shortens_nothing() -> None:
    """A low sun: the car's shadow covers the lane beside it, and some road behind the car."""
    foreign, shade = empty(), empty()
    for lane, rear, length in ((2, 185, 15), (1, 180, 35)):
        shade[car_box(ROAD, lane, rear, length)] = 255
    foreign[car_box(ROAD, 2, 200)] = 255
    foreign |= shade
    bright = cv2.subtract(foreign, shade)
    detector = LaneDetector()
    for _ in range(5):
        found = detector.find(masks_of(foreign, bright, shade), raster(foreign, ROAD))
    assert found.lane[found.shadow].tolist() == [1]
    assert found.body[found.shadow].tolist() == [0.0]
    assert found.rear_column[~found.shadow] == pytest.approx([200], abs=2)


def test_bodies_are_parted_where_only_shade_joins_them() -> None:
    """Two cars whose shadows fill the gap between them make one interval with two bodies."""
    foreign, shade = empty(), empty()
    cars = (200, 235)
    foreign[car_box(ROAD, 1, 190, 70)] = 255
    shade[car_box(ROAD, 1, 190, 70)] = 255
    for rear in cars:
        shade[car_box(ROAD, 1, rear)] = 0
    found = LaneDetector().find(masks_of(foreign, empty(), shade), raster(foreign, ROAD))
    (bodies,) = found.bodies
    assert bodies == pytest.approx(np.array([[200, 223], [235, 258]]), abs=1)


@pytest.mark.parametrize(
    ("gap_m", "runs"), [(0.4, [(20, 50)]), (1.6, [(20, 34), (42, 56)])], ids=["glass", "gap"]
)
def test_a_windscreen_parts_no_body(gap_m: float, runs: list[tuple[float, float]]) -> None:
    gap = round(5.0 * gap_m)
    body = np.zeros(60, np.bool_)
    body[:14] = body[14 + gap : 28 + gap] = True
    assert body_runs(body, 20, 5.0) == tuple(runs)


def test_what_is_too_short_is_no_body() -> None:
    body = np.zeros(60, np.bool_)
    body[10:15] = True
    assert body_runs(body, 0, 5.0) == ()


def test_a_lone_dark_thing_is_not_marked_as_a_shadow() -> None:
    foreign = empty()
    foreign[car_box(ROAD, 1, 200)] = 255
    found = LaneDetector().find(masks_of(foreign, empty(), foreign), raster(foreign, ROAD))
    assert found.shadow.tolist() == [False]
    assert found.body.tolist() == [0.0]


@pytest.mark.parametrize(
    ("gap", "line", "joined"), [(8, True, True), (8, False, False), (40, True, False)]
)
def test_a_dark_sill_joins_what_windows_and_bonnet_show(gap: int, line: bool, joined: bool) -> None:
    on = np.zeros(100, np.uint8)
    on[10:20] = on[20 + gap : 30 + gap] = 1
    under = np.full(100, line, np.bool_)
    assert bool(bridged(on, under, 15.0)[20 : 20 + gap].all()) is joined


def lorry(lean: tuple[float, float], height_m: float, beside: bool) -> tuple[Image, Band]:
    """Return a lorry in the lane nearer to the camera, with a car beside it or none."""
    of = band(lean_px=lean)
    solid = empty(of)
    solid[car_box(of, 2, 200, 70)] = 255
    mask = smeared(solid, lean, height_m)
    if beside:
        car = empty(of)
        car[car_box(of, 1, 330)] = 255
        mask = np.maximum(mask, smeared(car, lean, LEAN_HEIGHT_M))
    return mask, of


def test_the_side_of_a_tall_vehicle_is_no_vehicle_in_the_lane_behind() -> None:
    mask, of = lorry((0.0, -5.5), 4.0, beside=False)
    assert find(mask, of).lane.tolist() == [2]
    mask, of = lorry((0.0, -5.5), 4.0, beside=True)
    assert sorted(find(mask, of).lane.tolist()) == [1, 2]


def test_a_car_joined_to_the_side_of_a_tall_vehicle_is_kept() -> None:
    mask, of = lorry((0.0, -5.5), 4.0, beside=False)
    car = empty(of)
    car[car_box(of, 1, 165, 36)] = 255  # from behind the lorry up to where its side begins
    mask = np.maximum(mask, smeared(car, (0.0, -5.5), LEAN_HEIGHT_M))
    found = find(mask, of)
    assert sorted(found.lane.tolist()) == [1, 2]
    assert found.rear_column[found.lane == 1] == pytest.approx([165], abs=2)


def test_contrast_is_that_of_the_vehicle() -> None:
    mask = empty()
    mask[car_box(ROAD, 1, 100)] = 255
    share = np.where(mask > 0, 0.6, 0.0).astype(np.float32)
    masks = Masks(mask, mask, np.zeros_like(mask), share)
    found = LaneDetector().find(masks, raster(mask, ROAD))
    assert found.contrast[0] == pytest.approx(0.6, abs=0.08)


@pytest.mark.parametrize(
    ("sill", "becomes"),
    [
        ((20, 80), (20, 95)),  # from the rear of a trailer to its cab
        ((30, 40), (80, 95)),  # too short: something else
        ((20, 70), (80, 95)),  # ends before the cab
        ((0, 90), (0, 95)),
    ],
)
def test_a_sill_leads_from_a_truck_s_cab_to_its_rear(
    sill: tuple[int, int], becomes: tuple[int, int]
) -> None:
    on, line = np.zeros(200, np.uint8), np.zeros(200, np.bool_)
    on[80:95], line[sill[0] : sill[1]] = 1, True
    found = np.flatnonzero(silled(on, line, PX_PER_M))
    assert (found[0], found[-1] + 1) == becomes


def test_a_line_that_is_longer_than_a_truck_is_no_sill() -> None:
    on, line = np.zeros(300, np.uint8), np.zeros(300, np.bool_)
    on[180:200], line[50:180] = 1, True
    assert (silled(on, line, PX_PER_M) == on).all()


def test_a_dark_car_that_is_known_is_not_its_neighbours_shadow() -> None:
    foreign, shade = empty(), empty()
    foreign[car_box(ROAD, 1, 100)] = 255
    foreign[car_box(ROAD, 1, 123)] = 255  # joined to the first, and as dark as a shadow
    shade[car_box(ROAD, 1, 123)] = 255
    masks, seen_road = masks_of(foreign, empty(), shade), raster(foreign, ROAD)
    low = np.zeros((2, ROAD.columns), np.bool_)
    low[0, 123:146] = True
    alone = empty()
    alone[car_box(ROAD, 1, 200, 46)] = 255
    plain = masks_of(alone, empty(), np.where(shade > 0, 255, 0).astype(np.uint8))
    detector = LaneDetector()
    for _ in range(5):  # cars here throw no shadow along the road
        detector.find(plain, seen_road)
    assert detector.find(masks, seen_road).front_column.max() < 130
    assert detector.find(masks, seen_road, (low,)).front_column.max() > 143
