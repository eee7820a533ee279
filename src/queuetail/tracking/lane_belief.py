"""What is believed to be a vehicle: by its looks, by how it drives, and by what others do there.

Stains, shadows and patches of light stand where vehicles drive through them or into them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from queuetail.tracking.lane_correction import FAST_MPS, too_near_m
from queuetail.tracking.lane_vehicle import (
    DRIVING_MPS,
    FAINT,
    LEAST_BODY,
    SHADE_MOVED_M,
    SURE_BODY,
    Interval,
    LaneVehicle,
    shared,
)

STAIN_CONTRAST, MIN_STANDING_M = 0.17, 2.8
DRIVES_HITS, DRIVES_SIGMAS = 2, 3.0  # of its speed, at the least
APPEARS_S = 0.3  # after it came, a vehicle is seen
LOST_S = 0.35  # unseen for so long, and not just merged with another one in a picture
FASTEST_STOP_MPS2, CRASH_MPS = 8.0, 4.0  # braking on dry asphalt, and what is no braking at all
SAME_PLACE = 0.45  # overlap, as a share of the shorter, at which one drives through the other
RUN_INTO = 2  # vehicles: no one of them may be lost for another reason
DROVE_THROUGH, DROVE_INTO = 2, 4  # vehicles, where what stands has driven itself


def looks_like_a_vehicle(thing: LaneVehicle, slack: float = 1.0) -> bool:
    """Tell whether what has never moved may be a vehicle: stains are flat, shadows all dark."""
    if thing.in_row:
        return True
    marked = thing.contrast >= slack * STAIN_CONTRAST and thing.body >= slack * LEAST_BODY
    return marked and thing.length_m >= slack * MIN_STANDING_M


def surely_drives(vehicle: LaneVehicle) -> bool:
    """Tell whether what came from where vehicles come from drives, and is no shadow.

    That shows in its body at once, and in a way that it went without a caster beside it.
    """
    if vehicle.apparition or vehicle.mark or vehicle.is_long_shade:
        return False
    is_body = vehicle.body >= SURE_BODY and vehicle.contrast >= FAINT
    least_mps = max(FAST_MPS, DRIVES_SIGMAS * float(np.sqrt(vehicle.var_speed)))
    is_fast = vehicle.hits >= DRIVES_HITS and vehicle.speed_mps > least_mps
    return is_fast and (is_body or vehicle.way_m > SHADE_MOVED_M / 2)


def drives_into(behind: LaneVehicle, ahead: LaneVehicle, unseen_s: float) -> bool:
    """Tell whether a vehicle that is not seen any more drove into what stands ahead.

    Who was seen driving a moment ago cannot have braked so hard: what stands there may be a stain.
    """
    brakes = behind.speed_mps <= FASTEST_STOP_MPS2 * unseen_s + CRASH_MPS
    lost = behind.moved and ahead.stands and unseen_s > LOST_S and not brakes
    return lost and too_near_m(behind, ahead) > 0


def came_through(vehicle: LaneVehicle, thing: LaneVehicle, t_s: float) -> bool:
    """Tell whether a vehicle that drives freely appeared just ahead of a thing of its lane.

    A moment before it must have been where that stands, which then is none: nobody changes lanes so
    fast.
    """
    began_m = vehicle.rear_m - vehicle.speed_mps * (t_s - vehicle.born_s)
    first_m, last_m = thing.rear_m, thing.front_m + APPEARS_S * vehicle.speed_mps
    same_lane = (vehicle.approach, vehicle.lane) == (thing.approach, thing.lane)
    fast = vehicle.speed_mps > FAST_MPS
    return fast and same_lane and thing.stands and first_m < began_m < last_m


def unmasked(vehicles: Sequence[LaneVehicle]) -> list[Interval]:
    """Disbelieve standing things that others drive through or into; return where they stand.

    Of what has driven itself it takes several at speed: one may be in the next lane, or lost.
    """
    places: list[Interval] = []
    driving = [v for v in vehicles if v.confirmed and v.moved and v.speed_mps > DRIVING_MPS]
    for thing in vehicles:
        if not thing.stands and thing.moved:
            thing.run_into = 0
            thing.driven_through.clear()
        if thing.mark or not thing.stands:
            continue
        thing.driven_through |= {v.track_id for v in driving if _drives_through(v, thing)}
        if _is_driven_over(thing):
            thing.disbelieve()
            thing.mark = True
            places.append(thing.place)
    return places


def _drives_through(vehicle: LaneVehicle, thing: LaneVehicle) -> bool:
    same_lane = vehicle.lane == thing.lane and vehicle.approach == thing.approach
    fast = vehicle.speed_mps > FAST_MPS or not thing.moved
    return same_lane and fast and shared(vehicle, thing.place) > SAME_PLACE


def _is_driven_over(thing: LaneVehicle) -> bool:
    through = len(thing.driven_through)
    if thing.moved:
        return through >= DROVE_THROUGH or thing.run_into >= DROVE_INTO
    return through > 0 or thing.run_into >= RUN_INTO
