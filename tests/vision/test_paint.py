"""Paint on a road that was not seen bare yet: what is bright, thin, and beside nothing dark."""

from __future__ import annotations

import numpy as np
import pytest
from rasters import PX_PER_M, asphalt, band, no_protection, raster, with_car

from queuetail.types import MOVED, Image
from queuetail.vision.asphalt import RoadBackground
from queuetail.vision.lanes import LaneDetector
from queuetail.vision.paint import painted

OF = band()
PAINT = 220.0


def mask(*boxes: tuple[int, int, int, int]) -> Image:
    """Return (255) boxes of first and last rows and columns."""
    shown = no_protection(OF)
    for top, bottom, left, right in boxes:
        shown[top:bottom, left:right] = 255
    return shown


@pytest.mark.parametrize(
    ("bright", "dark", "is_paint"),
    [
        ((30, 31, 100, 115), None, True),  # a dash along the road
        ((14, 50, 100, 102), None, True),  # a stop line across it
        ((30, 31, 100, 115), (33, 37, 100, 115), False),  # the edge of a dark car
        ((30, 31, 100, 115), (33, 34, 100, 101), True),  # a speck beside it
        ((26, 36, 100, 122), None, False),  # a white car
    ],
    ids=["dash", "stop line", "dark car", "speck", "white car"],
)
def test_paint_is_thin_and_beside_nothing_dark(
    bright: tuple[int, int, int, int], dark: tuple[int, int, int, int] | None, is_paint: bool
) -> None:
    shown = mask(bright)
    found = painted(shown, mask(dark) if dark else mask(), PX_PER_M)
    assert (found > 0).sum() == ((shown > 0).sum() if is_paint else 0)


def with_arrows(road: Image, lane: int) -> Image:
    """Paint arrows of 5 m along a lane's middle, between dashes beside it."""
    painted_road, middle = road.astype(np.float32), round(OF.lane_rows[lane - 1])
    for column in range(60, 560, 100):
        painted_road[middle, column : column + 25] = PAINT
        painted_road[middle - 2 : middle + 3, column + 20 : column + 22] = PAINT
        for edge in (-9, 9):
            painted_road[middle + edge, column : column + 30] = PAINT
    return painted_road


def test_arrows_and_dashes_of_a_first_picture_are_no_vehicles_and_do_not_join_those() -> None:
    background, detector = RoadBackground(), LaneDetector()
    road = with_arrows(asphalt(OF), 1)
    seen = raster(with_car(road, OF, 1, 300, 40.0).astype(np.uint8), OF)
    masks = background.apply(seen, 0.0, no_protection(OF))
    found = detector.find(masks, seen)
    assert len(found) == 1
    assert found.rear_column[0] == pytest.approx(300, abs=3)
    assert found.front_column[0] == pytest.approx(323, abs=4)


def test_who_has_moved_is_never_taken_for_paint() -> None:
    """A vehicle that stops where the road was not seen bare yet may show a bright edge only."""
    road = asphalt(OF)
    line = np.s_[30:31, 200:222]
    shown = road.copy()
    shown[line] = PAINT
    seen = raster(shown.astype(np.uint8), OF)
    protect = no_protection(OF)
    protect[24:40, 195:227] = MOVED
    assert (RoadBackground().apply(seen, 0.0, no_protection(OF)).foreign[line] == 0).all()
    assert (RoadBackground().apply(seen, 0.0, protect).foreign[line] > 0).all()
