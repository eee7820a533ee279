"""What belongs together in a lane: the parts of one long vehicle, and the cars of a row.

A trailer the colour of asphalt shows its cab, and its rear.  Nobody follows another vehicle by a
few metres at speed: what seems to is one vehicle, and once its length is known, whatever shows
within that length is its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from queuetail.tracking.lane_vehicle import (
    STANDING_MPS,
    SURE_S,
    Interval,
    LaneVehicle,
    overlap_m,
)

FOLLOWING_S = 0.35  # no driver keeps a shorter gap than he drives in so long,
MERGING_MPS, SAME_SPEED_MPS = 10.0, 1.5  # at such a speed, both alike,
FOLLOWING_FOR_S = 0.8  # both of them seen, for so long
LONGEST_M, LONG_M = 23.5, 6.5
SLACK_M = 1.5  # by which a part may stick out of its vehicle
CAR_M, LEAST_GAP_M, ROW_GAP_M, ROW_HITS = (3.2, 6.5), 0.5, 12.0, 4
OWN, OTHER = 0.6, 0.3  # shares of a part that lie in its vehicle, and in another at the most


def joined_parts(vehicles: Sequence[LaneVehicle], intervals: list[Interval]) -> list[Interval]:
    """Join the intervals of one lane that are parts of one known long vehicle."""
    long_ones = [v for v in vehicles if v.confirmed and v.length_sure and v.length_m > LONG_M]
    if not long_ones or len(intervals) < 2:
        return intervals
    joined: list[Interval] = []
    owner: LaneVehicle | None = None
    for interval in sorted(intervals, key=lambda i: i.rear_m):
        whose = _owner(interval, long_ones, vehicles)
        if joined and whose is not None and whose is owner:
            last = joined[-1]
            joined[-1] = replace(
                last,
                front_m=interval.front_m,
                cut_front=interval.cut_front,
                contrast=max(last.contrast, interval.contrast),
                body=max(last.body, interval.body),
                shadow=last.shadow and interval.shadow,
                roof=last.roof and interval.roof,
                bodies=(),
                joined=True,
            )
        else:
            joined.append(interval)
        owner = whose
    return joined


def merge_followers(vehicles: Sequence[LaneVehicle], dt_s: float) -> list[LaneVehicle]:
    """Make one of two parts of a lane, sorted by station, that drive as no two vehicles do.

    Returns those that are no more.
    """
    gone: list[LaneVehicle] = []
    for behind, ahead in pairwise(vehicles):
        if not _follows_too_closely(behind, ahead):
            behind.follows_s = 0.0
            continue
        behind.follows_s += dt_s
        if behind.follows_s < FOLLOWING_FOR_S or behind in gone:
            continue
        behind.absorb(ahead)
        behind.whole_s = SURE_S + FOLLOWING_FOR_S
        gone.append(ahead)
    return gone


def mark_rows(vehicles: Sequence[LaneVehicle]) -> None:
    """Mark what stands as long as a car between standing vehicles of its lane: a dark car.

    With one before and one behind it, it is never the end of the queue by itself.
    """
    lanes: dict[tuple[int, int], list[LaneVehicle]] = {}
    for v in vehicles:
        if v.speed_mps < STANDING_MPS and (v.confirmed or v.only_shade):
            lanes.setdefault((v.approach, v.lane), []).append(v)
    for standing in lanes.values():
        standing.sort(key=lambda v: v.rear_m)
        for behind, v, ahead in zip(standing, standing[1:], standing[2:], strict=False):
            v.in_row |= (
                v.only_shade
                and v.hits >= ROW_HITS
                and behind.confirmed
                and _is_car_long(v.length_m)
                and _is_row_gap(v.rear_m - behind.front_m)
                and _is_row_gap(ahead.rear_m - v.front_m)
            )


def stands_in_row(interval: Interval, vehicles: Sequence[LaneVehicle]) -> bool:
    """Tell whether something lies, as long as a car, between standing vehicles of its lane."""
    if not _is_car_long(interval.front_m - interval.rear_m):
        return False
    standing = [
        v
        for v in vehicles
        if (v.approach, v.lane) == (interval.approach, interval.lane)
        and v.confirmed
        and v.speed_mps < STANDING_MPS
    ]
    behind = any(_is_row_gap(interval.rear_m - v.front_m) for v in standing)
    ahead = any(_is_row_gap(v.rear_m - interval.front_m) for v in standing)
    return behind and ahead


def _is_car_long(length_m: float) -> bool:
    return CAR_M[0] < length_m < CAR_M[1]


def _is_row_gap(gap_m: float) -> bool:
    """Tell whether vehicles that stand in one row are so far apart."""
    return LEAST_GAP_M < gap_m < ROW_GAP_M


def _follows_too_closely(behind: LaneVehicle, ahead: LaneVehicle) -> bool:
    slower = min(behind.speed_mps, ahead.speed_mps)
    return (
        slower > MERGING_MPS
        and abs(behind.speed_mps - ahead.speed_mps) < SAME_SPEED_MPS
        and ahead.rear_m - behind.front_m < FOLLOWING_S * slower
        and ahead.front_m - behind.rear_m < LONGEST_M
        and behind.confirmed
        and ahead.confirmed
        and behind.seen_s == ahead.seen_s
    )


def _owner(
    interval: Interval, long_ones: Sequence[LaneVehicle], vehicles: Sequence[LaneVehicle]
) -> LaneVehicle | None:
    """Return the long vehicle that an interval is a part of, and no other vehicle's."""
    length_m = max(interval.front_m - interval.rear_m, 0.1)
    for v in long_ones:
        inside = interval.rear_m > v.rear_m - SLACK_M and interval.front_m < v.front_m + SLACK_M
        if inside and overlap_m(v, interval) > OWN * length_m:
            others = (o for o in vehicles if o is not v and o.confirmed)
            if all(overlap_m(o, interval) < OTHER * length_m for o in others):
                return v
    return None
