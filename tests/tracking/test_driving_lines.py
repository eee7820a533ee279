"""Where the traffic drives across its lane, and what stands beside that."""

from __future__ import annotations

import pytest

from queuetail.tracking.driving_lines import DrivingLines
from queuetail.tracking.lane_vehicle import LaneVehicle


def vehicle(offset_m: float, speed_mps: float = 15.0, way_m: float = 50.0) -> LaneVehicle:
    made = LaneVehicle(1, 0, 2, 100.0, speed_mps, 4.6, offset_m, 0.0, way_m=way_m, seen_s=1.0)
    made.confirmed = True
    return made


def learnt(offset_m: float, count: int = 60, **how: float) -> DrivingLines:
    lines = DrivingLines()
    for _ in range(count):
        lines.learn([vehicle(offset_m, **how)], 1.0)
    return lines


@pytest.mark.parametrize(("at_m", "aside"), [(-5.4, False), (-4.6, False), (-7.4, True)])
def test_what_stands_beside_where_all_drive_is_aside(at_m: float, aside: bool) -> None:
    """However far the site's lanes lie aside: here by almost a metre."""
    assert learnt(-4.5 - 0.9).is_aside(vehicle(at_m, 0.0, 0.0)) is aside


def test_until_enough_have_driven_nothing_is_aside() -> None:
    assert not learnt(-5.4, count=20).is_aside(vehicle(-8.0))
    assert not DrivingLines().is_aside(vehicle(-8.0))


@pytest.mark.parametrize("how", [{"speed_mps": 1.0}, {"way_m": 0.0}])
def test_what_does_not_drive_shows_no_line(how: dict[str, float]) -> None:
    assert not learnt(-5.4, **how).is_aside(vehicle(-8.0))
