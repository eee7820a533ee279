"""What a lane shows beside its intervals, used by its vehicles: motion, and what is hidden."""

from __future__ import annotations

import numpy as np

from queuetail.tracking.lane_vehicle import DRIVING_MPS, STANDING_MPS, LaneVehicle
from queuetail.types import LaneSight

HIDDEN_SHARE = 0.5  # of a vehicle's length, for it to be hidden
GATE_MPS, GATE_SIGMAS = 2.0, 3.0
# Sigma of a lane's own motion by its median absolute spread along a vehicle, as it was measured.
FLOW_SIGMA_MPS, FLOW_SPREAD, MOST_SPREAD_MPS = 0.15, 1.3, 2.0
FLOW_SHARE = 0.25  # of a vehicle's length whose motion is known
RESTING_MPS = 0.3
OWN_MOTION, OWN_SIGMA_MPS = 0.5, 1.5  # share by which what is its own may differ from its speed


def follow_flow(vehicle: LaneVehicle, sight: LaneSight | None, was_seen: bool) -> None:
    """Correct a vehicle's speed by how the picture moves where it is, unless that is another's.

    Where a vehicle `was_seen` no more, it is the road or a bridge that stands still; and where some
    of it goes on as before, it is something in front of the rest.
    """
    flow = flow_mps(sight, vehicle.rear_m, vehicle.front_m)
    if flow is None or flow[0] < -RESTING_MPS:
        return
    speed_mps, sigma_mps = flow
    if vehicle.speed_mps > DRIVING_MPS and speed_mps < (1 - OWN_MOTION) * vehicle.speed_mps:
        own = _own_motion_mps(sight, vehicle)
        if own is None and abs(speed_mps) < RESTING_MPS and not was_seen:
            return
        speed_mps, sigma_mps = own or flow
    if abs(speed_mps) < RESTING_MPS and vehicle.speed_mps < STANDING_MPS:
        # Still is still: noise that is cut off at 0 would make it creep.
        speed_mps = 0.0
    gate_mps = GATE_MPS + GATE_SIGMAS * float(np.sqrt(vehicle.var_speed))
    if abs(speed_mps - vehicle.speed_mps) < gate_mps:
        vehicle.correct_speed(speed_mps, sigma_mps)


def flow_mps(sight: LaneSight | None, rear_m: float, front_m: float) -> tuple[float, float] | None:
    """Return how fast the picture moves between two stations, and its sigma, in m/s.

    None where too little tells, or where it tells too many things: a body moves as one.
    """
    if sight is None:
        return None
    first, last = _columns(sight, rear_m, front_m)
    speeds = sight.speed_mps[first:last]
    known = speeds[np.isfinite(speeds)]
    if not len(known) or len(known) < FLOW_SHARE * len(speeds):
        return None
    half = len(known) // 2
    middle = float(np.partition(known, half)[half])
    spread = float(np.partition(np.abs(known - middle), half)[half])
    if spread > MOST_SPREAD_MPS:
        return None
    return middle, FLOW_SIGMA_MPS + FLOW_SPREAD * spread


def _own_motion_mps(sight: LaneSight | None, vehicle: LaneVehicle) -> tuple[float, float] | None:
    """Return the motion, and its sigma, of what goes as fast as a vehicle where it is, if any."""
    if sight is None:
        return None
    first, last = _columns(sight, vehicle.rear_m, vehicle.front_m)
    speeds = sight.speed_mps[first:last]
    own = speeds[np.abs(speeds - vehicle.speed_mps) < OWN_MOTION * vehicle.speed_mps]
    if not len(own) or len(own) < FLOW_SHARE * np.isfinite(speeds).sum():
        return None
    return float(np.median(own)), OWN_SIGMA_MPS


def is_hidden(sight: LaneSight | None, rear_m: float, front_m: float) -> bool:
    """Tell whether a tall vehicle stands before most of a stretch of lane."""
    if sight is None:
        return False
    first, last = _columns(sight, rear_m, front_m)
    hidden = sight.hidden[first:last]
    return bool(len(hidden)) and bool(np.count_nonzero(hidden) >= HIDDEN_SHARE * len(hidden))


def _columns(sight: LaneSight, rear_m: float, front_m: float) -> tuple[int, int]:
    """Return the first column of a stretch, and the one after its last."""
    first = int((rear_m - sight.start_m) / sight.step_m)
    last = int((front_m - sight.start_m) / sight.step_m) + 1
    return max(first, 0), max(last, 0)
