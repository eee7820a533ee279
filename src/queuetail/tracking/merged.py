"""Vehicles that share one interval of their lane: which of them each body in it is.

A queue under a low sun is one long silhouette; bodies, which are no cast shadow, tell where each of
its vehicles stands, and how many they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from queuetail.tracking.lane_correction import correct_many
from queuetail.tracking.lane_vehicle import Interval, LaneVehicle

Body = tuple[float, float]  # stations of its rear and front

BODY_SIGMA_M = 0.5  # of a body's rear: a vehicle's own shade may hide a little of it
REACH, ALIKE = 0.75, 0.35  # of its length: to a body's middle, and what that may be shorter, longer
FAR_M = 1e3
LONGER_RATE = 0.1
WITHIN = 0.3  # of a vehicle's length that lies in other vehicles' bodies: it is none of its own
NONE_FOR_S = 2.0  # and for so long


def correct_merged(
    vehicles: Sequence[LaneVehicle], interval: Interval, dt_s: float
) -> list[LaneVehicle]:
    """Correct the vehicles of one interval, the last one first; return those that are none."""
    pairs = paired(vehicles, interval.bodies)
    own = [vehicle for vehicle, _ in pairs]
    ends = replace(
        interval,
        cut_rear=interval.cut_rear or vehicles[0] in own,
        cut_front=interval.cut_front or vehicles[-1] in own,
    )
    correct_many(vehicles, ends)
    for vehicle, (rear_m, front_m) in pairs:
        vehicle.correct(rear_m, BODY_SIGMA_M)
        longer_m = front_m - rear_m - vehicle.length_m
        if longer_m > 0:
            vehicle.length_m += LONGER_RATE * longer_m
    return _surplus(vehicles, pairs, dt_s)


def paired(
    vehicles: Sequence[LaneVehicle], bodies: Sequence[Body]
) -> list[tuple[LaneVehicle, Body]]:
    """Return which vehicle each body is: by their places in the row, as near as can be."""
    if not bodies:
        return []
    rears, fronts = np.array(bodies).T
    middle = np.array([(v.rear_m + v.front_m) / 2 for v in vehicles])
    length = np.array([v.length_m for v in vehicles])
    away = np.abs(middle[:, None] - (rears + fronts) / 2)
    far = away > REACH * length[:, None]
    far |= np.abs(fronts - rears - length[:, None]) > ALIKE * length[:, None]
    rows, columns = linear_sum_assignment(np.where(far, FAR_M, away))
    pairs = zip(rows.tolist(), columns.tolist(), strict=True)
    return [(vehicles[i], bodies[j]) for i, j in pairs if not far[i, j]]


def _surplus(
    vehicles: Sequence[LaneVehicle], pairs: Sequence[tuple[LaneVehicle, Body]], dt_s: float
) -> list[LaneVehicle]:
    """Return who has long been where the bodies of others are, and has none."""
    own = [vehicle for vehicle, _ in pairs]
    gone = []
    for vehicle in vehicles:
        inside = vehicle not in own and _within(vehicle, [body for _, body in pairs]) > WITHIN
        vehicle.none_s = vehicle.none_s + dt_s if inside else 0.0
        if vehicle.none_s > NONE_FOR_S:
            gone.append(vehicle)
    return gone


def _within(vehicle: LaneVehicle, bodies: Sequence[Body]) -> float:
    """Return the share of a vehicle's length that lies in bodies."""
    overlaps = (min(vehicle.front_m, b[1]) - max(vehicle.rear_m, b[0]) for b in bodies)
    return sum(max(o, 0.0) for o in overlaps) / max(vehicle.length_m, 0.1)
