"""A road that traffic showed in part goes on to the picture's edges."""

from __future__ import annotations

import numpy as np
import pytest
from answers_double import MAPPING, SIZE

from queuetail.console.setup_api import through_view
from queuetail.geo.ground import enu_to_px
from queuetail.types import Approach


def test_a_found_road_goes_straight_on_to_the_edges() -> None:
    part = Approach("NB", np.array([[-10.0, 60.0], [0.0, 60.0], [10.0, 60.0]]), 100.0, 2, 3.6)
    whole = through_view(part, MAPPING, SIZE)
    px = enu_to_px(MAPPING, whole.axis_enu[[0, -1]])
    assert px[0, 0] < 40
    assert px[1, 0] > SIZE[0] - 40
    assert ((px >= 0) & (px <= np.array(SIZE))).all()
    begun_m = -10.0 - whole.axis_enu[0, 0]
    assert whole.start_station_m == pytest.approx(100.0 - begun_m)
    assert whole.axis_enu[:, 1] == pytest.approx(60.0)


def test_a_road_beyond_the_picture_stays_as_it_is() -> None:
    far = Approach("NB", np.array([[-900.0, 60.0], [900.0, 60.0]]), 0.0)
    assert through_view(far, MAPPING, SIZE).axis_enu.tolist() == far.axis_enu.tolist()
