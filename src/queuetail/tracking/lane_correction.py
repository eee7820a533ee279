"""How the intervals of a lane correct its vehicles: alone, merged, half hidden, or in part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from queuetail.tracking.lane_vehicle import (
    END_SIGMA_M,
    STANDING_MPS,
    Interval,
    LaneVehicle,
    SeenEnds,
)

ROOF_SIGMA_M = 2.0  # of an end of which only the roof is seen,
CLEAN, CLEAN_ROOF_SIGMA_M = 0.3, 0.6  # and of the middle of one that is as long as its vehicle
MERGED_SIGMA_M = 1.0  # of an end that is shared with another vehicle
SMALLEST_GAP_M = 1.0
# Longer than known by this much for a while: another vehicle is inside, the shortest with its gap.
LENGTH_STEP_M = 4.4
FAST_MPS = 8.0  # vehicles of one lane keep well apart
ALIKE = 0.15  # share by which lengths may differ that agree
LONGEST_SURE_S, DOUBT = 3.0, 0.5  # at the most, and how fast that fades while only a part is seen
PART, JOINED_M = 0.7, 1.5  # of a sure length: what is shorter is a part, what is longer is joined
LENGTH_RATE, ROOF_LENGTH_RATE, OFFSET_RATE = 0.15, 0.03, 0.08


def correct_one(vehicle: LaneVehicle, interval: Interval, dt_s: float) -> list[Interval]:
    """Correct a vehicle that has an interval to itself; return what else must be inside it."""
    interval = _without_edges(vehicle, interval)
    length = interval.front_m - interval.rear_m
    whole = not (interval.cut_rear or interval.cut_front)
    if interval.roof and vehicle.length_known:
        _correct_by_roof(vehicle, interval, whole)
        return []
    vehicle.offset_m += OFFSET_RATE * (interval.offset_m - vehicle.offset_m)
    longer = length - vehicle.length_m
    if vehicle.length_known and longer > LENGTH_STEP_M:
        vehicle.longer_s += dt_s
        by_rear = _correct_nearest_end(vehicle, interval)
        if vehicle.longer_s < 0.5:
            return []
        vehicle.longer_s = 0.0
        return [_remainder(interval, vehicle, by_rear)]
    vehicle.longer_s = 0.0
    if whole and vehicle.length_sure and not -(1 - PART) * vehicle.length_m < longer < JOINED_M:
        # A part of it, or joined to a part of something else: that tells of one end only.
        _correct_nearest_end(vehicle, interval)
        if vehicle.speed_mps > STANDING_MPS:  # what stands is as long as it was
            vehicle.whole_s -= DOUBT * dt_s
        return []
    if whole:
        if not vehicle.length_known:
            vehicle.length_m, vehicle.length_known = length, True
        alike = abs(length - vehicle.length_m) < ALIKE * vehicle.length_m
        if vehicle.speed_mps > FAST_MPS or interval.joined:  # in a crawl two cars look like a truck
            vehicle.whole_s = min(vehicle.whole_s + (dt_s if alike else -dt_s), LONGEST_SURE_S)
        vehicle.length_m += LENGTH_RATE * (length - vehicle.length_m)
        vehicle.correct(interval.rear_m, END_SIGMA_M)
    elif interval.cut_rear:
        vehicle.correct(interval.front_m - vehicle.length_m, END_SIGMA_M)
        # What is longer than thought has its rear farther outside: that is no slowing down.
        longer = 0.0 if vehicle.length_sure else max(length - vehicle.length_m, 0.0)
        vehicle.length_m += longer
        vehicle.rear_m -= longer
    else:
        vehicle.correct(interval.rear_m, END_SIGMA_M)
        if not vehicle.length_sure:
            vehicle.length_m = max(vehicle.length_m, length)
    return []


def _correct_nearest_end(vehicle: LaneVehicle, interval: Interval) -> bool:
    """Correct a vehicle by the end of an interval that is nearest its own; tell if by the rear."""
    rear_gap = interval.rear_m - vehicle.rear_m
    front_gap = interval.front_m - vehicle.front_m
    by_rear = abs(rear_gap) <= abs(front_gap)
    gap = rear_gap if by_rear else front_gap
    if abs(gap) < vehicle.gate_m():
        vehicle.correct(vehicle.rear_m + gap, MERGED_SIGMA_M)
    return by_rear


def _correct_by_roof(vehicle: LaneVehicle, interval: Interval, whole: bool) -> None:
    """Correct a vehicle by what shows beyond a truck: roughly, unless all of its roof does."""
    length = interval.front_m - interval.rear_m
    rear, front = interval.rear_m, interval.front_m - vehicle.length_m
    if abs(length - vehicle.length_m) < CLEAN * vehicle.length_m:
        vehicle.correct((rear + front) / 2, CLEAN_ROOF_SIGMA_M)
        return
    nearest = min(rear, front, key=lambda end_m: abs(end_m - vehicle.rear_m))
    if abs(nearest - vehicle.rear_m) >= vehicle.gate_m():
        return
    vehicle.correct(nearest, ROOF_SIGMA_M)
    if whole and length < PART * vehicle.length_m:
        vehicle.length_m += ROOF_LENGTH_RATE * (length - vehicle.length_m)


def _without_edges(vehicle: LaneVehicle, interval: Interval) -> Interval:
    """Take an end that stands while the vehicle drives for the edge of a bridge, not its own."""
    if interval.cut_rear or interval.cut_front:
        vehicle.ends = SeenEnds()  # the edge of what is seen stands as well
        return interval
    ends = vehicle.ends
    ends.note(interval.rear_m, interval.front_m)
    if vehicle.length_sure or not (ends.rear_stands or ends.front_stands):
        return interval
    if ends.rear_stands:
        vehicle.length_known = False
    return replace(
        interval,
        cut_rear=interval.cut_rear or ends.rear_stands,
        cut_front=interval.cut_front or ends.front_stands,
    )


def correct_many(vehicles: Sequence[LaneVehicle], interval: Interval) -> None:
    """Give the rear of a merged interval to its last vehicle and the front to its first."""
    last, first = vehicles[0], vehicles[-1]
    sigma_m = ROOF_SIGMA_M if interval.roof else MERGED_SIGMA_M
    if not interval.cut_rear and abs(interval.rear_m - last.rear_m) < last.gate_m():
        last.correct(interval.rear_m, sigma_m if interval.roof else END_SIGMA_M)
    if not interval.cut_front and abs(interval.front_m - first.front_m) < first.gate_m():
        first.correct(interval.front_m - first.length_m, sigma_m)
    for behind, ahead in pairwise(vehicles):
        # Nobody drives into the one ahead: a filter that says so has missed a braking.
        overlap = behind.front_m + 0.5 - ahead.rear_m
        if overlap > 0:
            behind.correct(behind.rear_m - overlap, MERGED_SIGMA_M)


def keep_behind(behind: LaneVehicle, ahead: LaneVehicle) -> None:
    """Stop a vehicle that is not seen before it would be inside the one ahead."""
    overlap = too_near_m(behind, ahead)
    if overlap > 0:
        behind.rear_m -= overlap
        behind.speed_mps = min(behind.speed_mps, ahead.speed_mps)


def too_near_m(behind: LaneVehicle, ahead: LaneVehicle) -> float:
    """Return by how much a vehicle comes nearer to the one ahead than vehicles stand."""
    return behind.front_m + SMALLEST_GAP_M - ahead.rear_m


def _remainder(interval: Interval, vehicle: LaneVehicle, by_rear: bool) -> Interval:
    """Return the part of an interval that its one vehicle does not explain."""
    if by_rear:
        rear, front = interval.rear_m + vehicle.length_m + 1.0, interval.front_m
    else:
        rear, front = interval.rear_m, interval.front_m - vehicle.length_m - 1.0
    return Interval(
        interval.approach,
        interval.lane,
        rear,
        max(front, rear + 2.0),
        interval.offset_m,
        interval.cut_rear and not by_rear,
        interval.cut_front and by_rear,
        interval.contrast,
    )
