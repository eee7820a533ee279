"""The paper preset's vision: view, background models, blobs."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_control_points, mapping_from_pose, px_to_enu
from queuetail.types import CameraPose, Detections, Frame, GroundMapping, Image, Origin, Raster
from queuetail.vision.background import MODELS, PaperBackground
from queuetail.vision.blobs import SimpleBlobs
from queuetail.vision.view import WholeFrame, boxes_to_px

ORIGIN = Origin(36.11, -97.057)


NOTHING = np.empty((0, 0), np.uint8)


def whole(image: Image) -> Raster:
    """Return a picture as the raster of a whole frame."""
    return Raster(image, np.eye(3))


def nadir(width_px: int = 1280, height_px: int = 720, height_m: float = 100.0) -> GroundMapping:
    """Return a camera that looks straight down with north at the top, 90° wide."""
    lens = intrinsics_from_hfov(width_px, height_px, 90.0)
    pose = CameraPose(ORIGIN.lat_deg, ORIGIN.lon_deg, height_m, 0.0, -90.0, 0.0, lens)
    return mapping_from_pose(pose, ORIGIN)


def frame_of(width: int, height: int) -> Frame:
    luma = np.zeros((height, width), np.uint8)
    return Frame(0, 0.0, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))


@pytest.mark.parametrize(
    ("size", "asked", "expected"),
    [
        ((1280, 720), 720, (720, 405)),
        ((3840, 2160), 720, (720, 405)),
        ((640, 480), 720, (640, 480)),  # never enlarged
        ((721, 3), 720, (720, 3)),
        ((4000, 1), 200, (200, 1)),
        ((720, 1280), 720, (720, 1280)),
    ],
)
def test_the_whole_frame_is_scaled_once(
    size: tuple[int, int], asked: int, expected: tuple[int, int]
) -> None:
    raster = WholeFrame(asked).render(frame_of(*size), nadir(), ())
    assert raster.image.shape == (expected[1], expected[0], 3)
    corner = raster.H_px_raster @ [*expected, 1.0]
    np.testing.assert_allclose(corner, [*size, 1.0])
    box = boxes_to_px(np.array([[0.0, 0.0, *expected]]), raster)
    np.testing.assert_allclose(box, [[0, 0, *size]])


def test_a_blob_is_placed_with_its_size() -> None:
    """At 100 m and 90° a pixel of 1280 is 0.15625 m; the raster has half of them."""
    view = WholeFrame(640)
    raster = view.render(frame_of(1280, 720), nadir(), ())
    found = Detections(np.array([[330.0, 170.0, 20.0, 10.0]]), np.array([200.0]))
    points = view.locate(found, raster, nadir())
    np.testing.assert_allclose(points.px, [[680.0, 350.0]])
    np.testing.assert_allclose(points.boxes_px, [[660.0, 340.0, 40.0, 20.0]])
    np.testing.assert_allclose(points.enu, [[40 * 0.15625, 10 * 0.15625]], atol=1e-9)
    assert points.length_m[0] == pytest.approx(40 * 0.15625)
    assert points.width_m[0] == pytest.approx(20 * 0.15625)
    assert points.sigma_m[0] > 0


def test_no_blobs_give_no_points() -> None:
    view = WholeFrame(640)
    raster = view.render(frame_of(1280, 720), nadir(), ())
    points = view.locate(Detections(np.empty((0, 4)), np.empty(0)), raster, nadir())
    assert len(points) == 0
    assert points.enu.shape == (0, 2)


def test_control_points_place_blobs_too() -> None:
    px = np.array([[0.0, 0.0], [1280.0, 0.0], [1280.0, 720.0], [0.0, 720.0]])
    mapping = mapping_from_control_points(px, px_to_enu(nadir(), px), None)
    view = WholeFrame(640)
    raster = view.render(frame_of(1280, 720), mapping, ())
    found = Detections(np.array([[330.0, 170.0, 20.0, 10.0]]), np.array([200.0]))
    by_points = view.locate(found, raster, mapping)
    by_pose = view.locate(found, raster, nadir())
    np.testing.assert_allclose(by_points.enu, by_pose.enu, atol=1e-6)
    np.testing.assert_allclose(by_points.length_m, by_pose.length_m, rtol=1e-6)


def road_scene(index: int, car_x: float | None) -> Image:
    """Return noisy asphalt with a bright car of 16×10 at `car_x`, 20 px below the top."""
    generator = np.random.default_rng(index)
    image = np.full((60, 160, 3), 90, np.uint8)
    if car_x is not None:
        image[20:30, round(car_x) : round(car_x) + 16] = (200, 190, 180)
    noise = generator.normal(0, 2, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_every_model_finds_what_moves_and_nothing_else(name: str) -> None:
    background = PaperBackground(MODELS[name](), blur_px=3, dilate_px=3)
    for index in range(30):
        mask = background.apply(whole(road_scene(index, None)), 0.0, NOTHING)
    assert not mask.any()
    for index in range(20):
        x = 10 + 5 * index
        mask = background.apply(whole(road_scene(100 + index, x)), 0.0, NOTHING)
        assert mask.dtype == np.uint8
        assert set(np.unique(mask)) == {0, 255}
        truth = np.zeros(mask.shape, bool)
        truth[20:30, x : x + 16] = True
        assert mask[truth].mean() > 0.9 * 255
        near = np.zeros(mask.shape, bool)
        near[15:35, max(x - 5, 0) : x + 21] = True
        assert (mask[~near] > 0).mean() < 0.01


def test_mog2_leaves_shadows_out() -> None:
    background = PaperBackground(MODELS["mog2"](), blur_px=3, dilate_px=3)
    for index in range(60):
        background.apply(whole(road_scene(index, None)), 0.0, NOTHING)
    shaded = road_scene(99, None)
    shaded[20:30, 40:60] = (shaded[20:30, 40:60] * 0.6).astype(np.uint8)
    mask = background.apply(whole(shaded), 0.0, NOTHING)
    assert (mask[21:29, 42:58] == 0).all()


def test_the_running_average_forgets_what_stays_and_the_first_frame_does_not() -> None:
    """Why stopped cars are lost by a running average: they are learnt as road."""
    average, first = (PaperBackground(MODELS[n](), 3, 3) for n in ("average", "first"))
    for model in (average, first):
        model.apply(whole(road_scene(0, None)), 0.0, NOTHING)
    masks = [
        [m.apply(whole(road_scene(k, 50)), k / 25, NOTHING) for m in (average, first)]
        for k in range(1, 400)
    ]
    assert masks[0][0][25, 58] == masks[0][1][25, 58] == 255
    assert masks[-1][0][25, 58] == 0
    assert masks[-1][1][25, 58] == 255


def test_an_even_blur_gets_the_next_odd_kernel() -> None:
    background = PaperBackground(MODELS["first"](), blur_px=30, dilate_px=9)
    background.apply(whole(road_scene(0, None)), 0.0, NOTHING)


rectangles = st.tuples(
    st.integers(0, 150), st.integers(0, 90), st.integers(6, 40), st.integers(6, 30)
)


@settings(max_examples=60)
@given(rectangles)
def test_a_rectangle_is_found_where_it_is(rectangle: tuple[int, int, int, int]) -> None:
    """Exactly, also where it is cut by the picture's edge."""
    x, y, width, height = rectangle
    mask = np.zeros((100, 160), np.uint8)
    mask[y : y + height, x : x + width] = 255
    width, height = min(width, 160 - x), min(height, 100 - y)
    found = SimpleBlobs(10.0).find(mask, whole(mask))
    if (width - 1) * (height - 1) < 10:
        return
    np.testing.assert_allclose(found.boxes, [[x, y, width, height]])
    assert found.areas[0] == pytest.approx((width - 1) * (height - 1))


def test_blobs_by_area() -> None:
    mask = np.zeros((100, 160), np.uint8)
    mask[10:14, 10:14] = 255  # 9 px² between its contour's points
    mask[40:50, 40:60] = 255
    mask[40:50, 100:130] = 255
    found = SimpleBlobs(40.0).find(mask, whole(mask))
    assert sorted(found.boxes[:, 0]) == [40, 100]
    assert len(found) == 2


def test_a_change_of_light_is_no_vehicle_and_an_empty_mask_has_none() -> None:
    blobs = SimpleBlobs(40.0)
    assert (
        len(
            blobs.find(
                np.full((100, 160), 255, np.uint8), whole(np.full((100, 160), 255, np.uint8))
            )
        )
        == 0
    )
    empty = blobs.find(np.zeros((100, 160), np.uint8), whole(np.zeros((100, 160), np.uint8)))
    assert empty.boxes.shape == (0, 4)
    assert len(empty) == 0


def test_the_detector_follows_a_change_of_size() -> None:
    blobs = SimpleBlobs(20.0)
    for shape in ((50, 50), (400, 400)):
        mask = np.zeros(shape, np.uint8)
        mask[5:20, 5:20] = 255
        assert len(blobs.find(mask, whole(mask))) == 1
