"""What is refused before any time is spent: a camera that sees no road, or hardly any."""

from __future__ import annotations

import numpy as np

from queuetail.errors import InputError
from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.flight import look
from queuetail.sim.scenario import Scenario

LEAST_ROAD_M = 40.0
LEAST_LANE_PX = 2.0


def check_drawable(scenario: Scenario) -> None:
    """Raise InputError where the camera sees no road, or too little of it, before time is spent."""
    view = look(scenario)
    axis = Axis.of(scenario.road)
    station = VIEW_STATION_M + np.arange(-700.0, 700.1, 1.0)
    middle = np.full_like(station, -0.5 * scenario.road.lanes * scenario.road.lane_width_m)
    px = view.ground_px(axis.enu(station, middle))
    lens = view.pose.intrinsics
    seen = ((px >= 0) & (px < [lens.width_px, lens.height_px])).all(axis=1)
    name = scenario.scenario.name
    if seen.sum() < LEAST_ROAD_M:
        raise InputError(
            f"scenario '{name}': the camera sees {int(seen.sum())} m of the road, at least "
            f"{LEAST_ROAD_M:g} m are needed; change [flight] height_m, pitch_deg, hfov_deg or aim_m"
        )
    edge = view.ground_px(axis.enu(station[seen], middle[seen] + scenario.road.lane_width_m))
    lane_px = float(np.linalg.norm(edge - px[seen], axis=1).max())
    if lane_px < LEAST_LANE_PX:
        raise InputError(
            f"scenario '{name}': a lane is only {lane_px:.1f} px wide in the picture; lower "
            "[flight] height_m or hfov_deg, or raise [picture] width_px"
        )
