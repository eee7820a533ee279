"""Learnt road in a new layout: the same ground, wherever the layout puts it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rasters import STRAIGHT, arc, asphalt, band, raster

from queuetail.types import Approach, Floats, RoadRaster
from queuetail.vision.carried_road import carried, places_before

OF = band()
ROAD = asphalt(OF).astype(np.float32)
BARE = np.full(ROAD.shape, 255, np.uint8)
OLD = raster(ROAD.astype(np.uint8), OF)


def laid_out(
    first_column: int = 0, approach: Approach = STRAIGHT, H: Floats | None = None
) -> RoadRaster:
    new = raster(OLD.image, band(first_column=first_column), plan=2)
    H = np.eye(3) if H is None else H
    return dataclasses.replace(new, approaches=(approach,), H_true_enu=H)


def test_the_same_layout_carries_everything() -> None:
    road, known = carried(ROAD, BARE, OLD, laid_out(), OF)
    assert road == pytest.approx(ROAD, abs=0.05)
    assert known.all()


def test_columns_move_with_the_first_one() -> None:
    new = laid_out(first_column=50)
    road, known = carried(ROAD, BARE, OLD, new, new.bands[0])
    assert road[:, :540] == pytest.approx(ROAD[:, 50:590], abs=0.05)
    assert known[:, :540].all()
    assert not known[:, 555:].any()


def test_a_correction_of_where_the_picture_lies_moves_the_road_with_it() -> None:
    """What was taken for a place lies 2 m to the left of it: ten rows up in the new layout."""
    H = np.eye(3)
    H[1, 2] = 2.0
    new = laid_out(H=H)
    road, known = carried(ROAD, BARE, OLD, new, OF)
    assert road[:-12] == pytest.approx(ROAD[10:-2], abs=0.05)
    assert known[:-12].all()
    assert not known[-8:].any()


def test_a_better_axis_moves_the_road_with_it() -> None:
    beside = dataclasses.replace(STRAIGHT, axis_enu=np.subtract(STRAIGHT.axis_enu, (0.0, 1.0)))
    road, _ = carried(ROAD, BARE, OLD, laid_out(approach=beside), OF)
    assert road[:-7] == pytest.approx(ROAD[5:-2], abs=0.05)


def test_what_was_not_seen_bare_is_not_known() -> None:
    bare = BARE.copy()
    bare[:, 200:300] = 0
    _, known = carried(ROAD, bare, OLD, laid_out(), OF)
    assert not known[:, 202:298].any()
    assert known[:, :198].all()


def test_another_road_knows_nothing() -> None:
    far = dataclasses.replace(STRAIGHT, axis_enu=np.add(STRAIGHT.axis_enu, (0.0, 60.0)))
    _, known = carried(ROAD, BARE, OLD, laid_out(approach=far), OF)
    assert not known.any()


def test_a_bend_is_followed() -> None:
    bend = arc()
    one = laid_out(approach=bend)
    across, down = places_before(one, laid_out(approach=bend), OF)
    rows, columns = np.mgrid[2:58, 2:598]
    assert across[2:58, 2:598] == pytest.approx(columns, abs=0.4)
    assert down[2:58, 2:598] == pytest.approx(rows, abs=0.4)
