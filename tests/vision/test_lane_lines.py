"""Painted lines are found to a few centimetres; verges, seams of shade and vehicles are none."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from rasters import STRAIGHT, arc, camera, painted

from queuetail.traffic.alignment import Camera, align
from queuetail.traffic.lane_evidence import NO_MARKS, WINDOW_M, LineMarks, gather
from queuetail.traffic.road import locate
from queuetail.types import Approach, Floats, GroundMapping, Image
from queuetail.vision.foot import camera_above_ground
from queuetail.vision.lane_lines import MIN_PICTURES, STEP_S, LaneLines, _offsets

SIZE = (800, 450)
LINE_M = 0.15
ASPHALT, PAINT, GRASS, GRAVEL = 90.0, 150.0, 70.0, 130.0
COARSE = 22.0  # levels by which blotches of asphalt differ


def solid(offset_m: float) -> Callable[[Floats, Floats], Floats]:
    return lambda station, offset: PAINT * (np.abs(offset - offset_m) < LINE_M / 2)


def dashed(offset_m: float) -> Callable[[Floats, Floats], Floats]:
    return lambda station, offset: solid(offset_m)(station, offset) * (station % 12.0 < 3.0)


def strip(low_m: float, high_m: float, level: float) -> Callable[[Floats, Floats], Floats]:
    return lambda station, offset: level * ((offset > low_m) & (offset < high_m))


def picture(
    approach: Approach,
    mapping: GroundMapping,
    *things: Callable[[Floats, Floats], Floats],
    blotches: float = 4.0,
) -> Image:
    """The road with what is on it, blurred and with blotches as asphalt has, at twice the size."""
    rng = np.random.default_rng(8)
    coarse = rng.normal(0.0, blotches, (SIZE[1] // 4, SIZE[0] // 4)).astype(np.float32)
    stains = cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC)

    def brightness(enu: Floats) -> Floats:
        station, offset, _ = locate(approach, enu)
        levels = np.full(len(enu), ASPHALT)
        for thing in things:
            levels = np.maximum(levels, thing(station, offset))
        return levels

    # A line is thinner than a pixel: four places of each pixel are averaged.
    parts = []
    for u in (-0.25, 0.25):
        for v in (-0.25, 0.25):
            shift = np.array([[1.0, 0.0, -u], [0.0, 1.0, -v], [0.0, 0.0, 1.0]])
            moved = GroundMapping(
                shift @ mapping.H_enu_px, mapping.H_px_enu @ np.linalg.inv(shift), mapping.origin
            )
            parts.append(painted(moved, SIZE, brightness).astype(np.float64))
    return np.clip(np.mean(parts, axis=0) + stains, 1, 255).astype(np.uint8)


def watched(
    approaches: tuple[Approach, ...], mapping: GroundMapping, pictures: list[Image]
) -> LineMarks:
    lines = LaneLines(approaches)
    rng = np.random.default_rng(9)
    for n in range(MIN_PICTURES + 2):
        luma = pictures[n % len(pictures)] + rng.normal(0.0, 2.0, SIZE[::-1])
        lines.update(np.clip(luma, 0, 255).astype(np.uint8), mapping, n * STEP_S)
    return lines.marks


@pytest.mark.parametrize(
    ("approach", "pitch_deg"),
    [(STRAIGHT, -90.0), (STRAIGHT, -65.0), (arc(), -65.0)],
    ids=["below", "straight", "bend"],
)
def test_lines_are_found_where_they_are(approach: Approach, pitch_deg: float) -> None:
    mapping = camera(60.0, pitch_deg, yaw_deg=30.0, size=SIZE)
    luma = picture(approach, mapping, solid(0.0), dashed(-3.6), solid(-7.2))
    marks = watched((approach,), mapping, [luma])
    offset = locate(approach, marks.enu)[1]
    edge = np.round(offset / 3.6) * 3.6
    assert set(np.unique(edge)) >= {0.0, -7.2}
    assert np.abs(offset - edge).max() < 0.3
    assert np.median(np.abs(offset - edge)) < 0.06
    assert len(marks) > 10


def test_a_wrong_heading_sets_the_lines_askew() -> None:
    mapping, said = camera(60.0, size=SIZE), camera(60.0, yaw_deg=2.0, size=SIZE)
    luma = picture(STRAIGHT, mapping, solid(0.0), solid(-7.2))
    marks = watched((STRAIGHT,), said, [luma])
    # What lies at a place by the wrong mapping belongs where the true one says.
    station, offset, _ = locate(STRAIGHT, marks.enu)
    right = offset < -3.6
    for side in (right, ~right):
        slope, _ = np.polyfit(station[side], offset[side], 1)
        assert abs(slope) == pytest.approx(np.tan(np.radians(2.0)), rel=0.1)


@pytest.mark.parametrize(
    "things",
    [
        (),
        (strip(1.5, 9.0, GRAVEL), strip(-12.0, -9.0, GRAVEL)),  # shoulders: a step, no ridge
        (strip(1.5, 3.0, GRAVEL),),  # a verge, wider than paint
    ],
    ids=["bare", "shoulders", "verge"],
)
def test_what_is_no_line_leaves_but_a_stray(
    things: tuple[Callable[[Floats, Floats], Floats], ...],
) -> None:
    mapping = camera(75.0, -60.0, yaw_deg=60.0, size=SIZE)
    luma = picture(STRAIGHT, mapping, *things)
    marks = watched((STRAIGHT,), mapping, [luma])
    assert len(marks) <= 4
    assert align((STRAIGHT,), gather((), marks), Camera(*camera_above_ground(mapping))) is None


def test_a_line_on_coarse_asphalt_shows_over_a_long_way() -> None:
    mapping = camera(75.0, -60.0, yaw_deg=60.0, size=SIZE)
    luma = picture(STRAIGHT, mapping, solid(-7.2), blotches=COARSE)
    lines = LaneLines((STRAIGHT,))
    for n in range(MIN_PICTURES):
        lines.update(luma, mapping, n * STEP_S)
    (grid,) = lines._grids or ()
    assert grid is not None
    short, both = _offsets(grid, WINDOW_M), lines.marks
    on_line = np.abs(locate(STRAIGHT, both.enu)[1] + 7.2) < 0.3
    assert on_line.sum() > (np.abs(short[:, 1] + 7.2) < 0.3).sum()
    assert on_line.mean() > 0.6


def test_vehicles_that_pass_hide_nothing_and_leave_nothing() -> None:
    mapping = camera(60.0, size=SIZE)
    bare = picture(STRAIGHT, mapping, solid(0.0), solid(-7.2))
    pictures = []
    for n in range(8):
        roof = strip(-2.7, -0.9, 220.0)
        where = 370.0 + n * 5.0
        passing = picture(
            STRAIGHT,
            mapping,
            solid(0.0),
            solid(-7.2),
            lambda s, d, where=where, roof=roof: roof(s, d) * (np.abs(s - where) < 2.5),
        )
        pictures.append(passing)
    offset = locate(STRAIGHT, watched((STRAIGHT,), mapping, pictures).enu)[1]
    assert len(offset) >= len(watched((STRAIGHT,), mapping, [bare]).enu) - 2
    assert np.abs(offset - np.round(offset / 7.2) * 7.2).max() < 0.3


def test_carriageways_side_by_side_see_a_line_once() -> None:
    other = Approach("SB", STRAIGHT.axis_enu[::-1] + np.array([0.0, 3.0]), 0.0, 2, 3.6)
    mapping = camera(60.0, size=SIZE)
    luma = picture(STRAIGHT, mapping, solid(0.0), solid(-7.2), solid(3.0))
    one = watched((STRAIGHT,), mapping, [luma])
    both = watched((STRAIGHT, other), mapping, [luma])
    assert len(both) <= len(one) + 2


def test_nothing_until_enough_was_seen_near_enough() -> None:
    mapping = camera(60.0, size=SIZE)
    luma = picture(STRAIGHT, mapping, solid(0.0), solid(-7.2))
    lines = LaneLines((STRAIGHT,))
    assert len(lines.marks) == len(NO_MARKS)
    for n in range(20):  # more often than it looks
        lines.update(luma, mapping, n * 0.05)
    assert len(lines.marks) == 0
    high = camera(250.0, size=SIZE)
    far = picture(STRAIGHT, high, solid(0.0), solid(-7.2))
    assert len(watched((STRAIGHT,), high, [far])) == 0
    # Turned away after the first picture: nothing was seen often enough.
    turned = LaneLines((STRAIGHT,))
    turned.update(luma, mapping, 0.0)
    for n in range(1, 2 * MIN_PICTURES):
        turned.update(luma, camera(60.0, size=SIZE, at=(36.2, -97.057)), n * STEP_S)
    assert len(turned.marks) == 0
    away = Approach("away", STRAIGHT.axis_enu + 5000.0, 0.0, 2, 3.6)
    assert len(watched((away,), mapping, [luma])) == 0
