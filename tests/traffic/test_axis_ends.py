"""An axis goes on at its ends as the road does, but not into another road."""

from __future__ import annotations

import numpy as np
import pytest
from synthetic_traffic import opposite, road

from queuetail.traffic.axis_ends import ONWARD_M, lengthened
from queuetail.traffic.road import locate, place
from queuetail.types import Approach


def both_ways(*approaches: Approach) -> list[Approach]:
    return lengthened(approaches, [(ONWARD_M, ONWARD_M)] * len(approaches))


def test_a_ramp_does_not_go_on_into_the_road_that_it_joins() -> None:
    main = road(length_m=300.0, lanes=2)
    s = np.arange(0.0, 201.0, 2.0)
    ramp = Approach("ramp", place(main, s, -3.0 - 0.05 * (200.0 - s)), 0.0, 1)
    longer = [locate(main, a.axis_enu[[0, -1]])[0] for a in both_ways(main, ramp)]
    assert longer[0] == pytest.approx([-ONWARD_M, 300.0 + ONWARD_M], abs=1.0)
    assert longer[1] == pytest.approx([-ONWARD_M, 200.0], abs=1.0)


@pytest.mark.parametrize("median_m", [0.5, 6.0])
def test_carriageways_side_by_side_both_go_on_at_both_ends(median_m: float) -> None:
    main = road(length_m=200.0, lanes=2)
    both = both_ways(main, opposite(main, median_m))
    for approach, longer in zip((main, opposite(main, median_m)), both, strict=True):
        ends = locate(approach, longer.axis_enu[[0, -1]])[0]
        assert ends == pytest.approx([-ONWARD_M, 200.0 + ONWARD_M], abs=1.0)


def test_each_end_goes_on_as_far_as_it_is_told() -> None:
    main = road(length_m=200.0, lanes=2)
    (longer,) = lengthened([main], [(75.0, 30.0)])
    assert locate(main, longer.axis_enu[[0, -1]])[0] == pytest.approx([-75.0, 230.0], abs=8.0)
