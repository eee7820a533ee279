"""One vehicle in its lane: a Kalman filter of its rear bumper, and how intervals correct it.

The state is the rear bumper's station and the speed (constant velocity, white acceleration:
Bar-Shalom, Li & Kirubarajan 2001, section 6.2); length and offset are averaged beside it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

ACCELERATION_MPS2 = 2.5  # one sigma of what drivers do
END_SIGMA_M = 0.35  # of a measured rear or front
FIRST_SPEED_SIGMA_MPS = 15.0
GATE_M, GATE_SIGMAS = 2.5, 3.5
SURE_S = 1.5  # that its length was seen alike, before it is sure
CAR_LENGTH_M = 6.5
DEAD_STOP_S, ALIKE_LENGTH, ALIKE_CONTRAST = 0.5, 0.4, 0.6
FAINT, DRIVING_MPS = 0.15, 4.0  # a contrast that stains have too
FULL = 0.75  # of the lengths of all vehicles in an interval: in less they are not all there
REVERSE_MPS = 1.5  # what is faster drives the wrong way
STANDING_MPS = 0.7
ENOUGH_WAY_M, STANDS = 3.0, 0.3  # an end that moved less of the way stands, if the other did not
LEAST_BODY, SURE_BODY = 0.15, 0.4  # share that is more than shade: below all may be, above not
MOVED_M, SHADE_MOVED_M = 2.5, 12.0  # a tree's shadow sways, and goes nowhere
SHADE_KNOWN_S, SHADE_SWAY_M = 1.5, 1.5
CONTRAST_RATE = 0.2


@dataclass(slots=True)
class SeenEnds:
    """Which ends of a vehicle's interval stand while it drives: the edges of what hides it."""

    way_m: float = 0.0  # that it drove since its ends were noted
    rear_m: float | None = None
    front_m: float | None = None
    rear_stands: bool = False
    front_stands: bool = False

    def note(self, rear_m: float, front_m: float) -> None:
        """Compare the ends with those before, once the vehicle drove far enough."""
        if self.rear_m is None or self.front_m is None:
            self.rear_m, self.front_m, self.way_m = rear_m, front_m, 0.0
        way_m = self.way_m
        if way_m < ENOUGH_WAY_M:
            return
        rear_share, front_share = (rear_m - self.rear_m) / way_m, (front_m - self.front_m) / way_m
        self.rear_stands = abs(rear_share) < STANDS and abs(front_share - 1) < STANDS
        self.front_stands = abs(front_share) < STANDS and abs(rear_share - 1) < STANDS
        self.rear_m, self.front_m, self.way_m = rear_m, front_m, 0.0


@dataclass(slots=True, eq=False)
class LaneVehicle:
    """One followed vehicle; stations in metres, covariance of (station, speed)."""

    track_id: int
    approach: int
    lane: int
    rear_m: float
    speed_mps: float
    length_m: float
    offset_m: float
    born_s: float
    var_station: float = END_SIGMA_M**2
    covar: float = 0.0
    var_speed: float = FIRST_SPEED_SIGMA_MPS**2
    length_known: bool = False
    hits: int = 1
    seen_s: float = 0.0
    seen_at_m: float = 0.0  # its interval's rear, then
    whole_s: float = 0.0  # for how long its length was seen alike, at speed
    longer_s: float = 0.0
    follows_s: float = 0.0  # for how long it has been nearer to the one ahead than anybody drives
    none_s: float = 0.0  # for how long it has been where only the bodies of others are
    apparition: bool = False  # came out of nothing in mid-view, and has not moved since
    mark: bool = False  # stands where others have driven through: a stain, until it moves
    driven_through: set[int] = field(default_factory=set)  # by whom, while it stands
    run_into: int = 0  # how many drove to where it stands without braking, or came from there
    in_row: bool = (
        False  # stands between vehicles of its lane, as long as a car: none but a car does
    )
    way_m: float = 0.0  # the farthest that it was from where it was born
    ends: SeenEnds = field(default_factory=SeenEnds)
    contrast: float = 0.0  # of its interval, as a share of the road's brightness
    driving_contrast: float = 0.0  # the same while it drove
    body: float = 1.0  # share of its interval that shows more than cast shadow
    born_at_m: float = 0.0
    confirmed: bool = False
    shown: bool = False  # it is told: confirmed, or surely driving
    astride: bool = False  # it was last seen between two lanes

    @property
    def front_m(self) -> float:
        return self.rear_m + self.length_m

    @property
    def place(self) -> Interval:
        """Where it is, as an interval of its lane."""
        ends = self.rear_m, self.front_m
        return Interval(self.approach, self.lane, *ends, self.offset_m, False, False)

    @property
    def stands(self) -> bool:
        """Whether it stands, as far as can be told."""
        return abs(self.speed_mps) < STANDING_MPS

    @property
    def is_car(self) -> bool:
        """Whether it was seen whole, and is too short to be taller than a car."""
        return self.confirmed and self.length_known and self.length_m < CAR_LENGTH_M

    @property
    def length_sure(self) -> bool:
        """Whether its length was seen so often that a part of it is taken for a part."""
        return self.whole_s > SURE_S

    @property
    def moved(self) -> bool:
        """Whether it went a way, as only vehicles do."""
        return self.way_m > (MOVED_M if self.body >= LEAST_BODY else SHADE_MOVED_M)

    @property
    def is_long_shade(self) -> bool:
        """Whether it is as long as a truck and shows nothing but shade: that of one beside it."""
        return self.length_m > CAR_LENGTH_M and self.body < LEAST_BODY

    @property
    def is_fainter_than_it_was(self) -> bool:
        """Whether it stands, and looks much less like a vehicle than while it drove: a stain."""
        faint = self.contrast < min(FAINT, ALIKE_CONTRAST * self.driving_contrast)
        return faint and self.stands

    def disbelieve(self) -> None:
        """Take it for no vehicle, until it has gone a way anew."""
        self.confirmed, self.way_m, self.born_at_m = False, 0.0, self.rear_m
        self.run_into, self.driven_through = 0, set()

    @property
    def only_shade(self) -> bool:
        """Whether it looks like a shadow, has not moved like a vehicle, and stands in no queue."""
        return self.body < LEAST_BODY and not self.moved and not self.in_row

    def predict(self, dt_s: float) -> None:
        self.rear_m += self.speed_mps * dt_s
        self.ends.way_m += self.speed_mps * dt_s
        q = ACCELERATION_MPS2**2 * dt_s
        self.var_station += dt_s * (2 * self.covar + dt_s * self.var_speed) + q * dt_s**2 / 3
        self.covar += dt_s * self.var_speed + q * dt_s / 2
        self.var_speed += q
        if -REVERSE_MPS < self.speed_mps < 0.0:
            self.speed_mps = 0.0  # nobody reverses: what seems to is noise, and would add up

    def restart(self, rear_m: float, speed_mps: float, sigma_mps: float) -> None:
        """Forget how it moved: it is here now."""
        self.rear_m, self.speed_mps = rear_m, speed_mps
        self.var_station, self.covar, self.var_speed = END_SIGMA_M**2, 0.0, sigma_mps**2

    def move(self, by_m: float) -> None:
        """Give all its stations as another road counts them."""
        self.rear_m += by_m
        self.born_at_m += by_m
        self.seen_at_m += by_m
        self.ends = SeenEnds()
        self.var_station += END_SIGMA_M**2

    def correct(self, rear_m: float, sigma_m: float) -> None:
        innovation = rear_m - self.rear_m
        total = self.var_station + sigma_m**2
        gain, speed_gain = self.var_station / total, self.covar / total
        self.rear_m += gain * innovation
        self.speed_mps += speed_gain * innovation
        self.var_speed -= speed_gain * self.covar
        self.covar *= 1 - gain
        self.var_station *= 1 - gain

    def correct_speed(self, speed_mps: float, sigma_mps: float) -> None:
        """Take in a speed that was measured by itself."""
        innovation = speed_mps - self.speed_mps
        total = self.var_speed + sigma_mps**2
        gain, station_gain = self.var_speed / total, self.covar / total
        self.speed_mps += gain * innovation
        self.rear_m += station_gain * innovation
        self.var_station -= station_gain * self.covar
        self.covar *= 1 - gain
        self.var_speed *= 1 - gain

    def take_in(self, interval: Interval, t_s: float) -> None:
        """Remember an interval that showed it, besides where its ends were."""
        self.seen_at_m, self.seen_s = interval.rear_m, t_s
        self.astride = interval.astride
        self.contrast += CONTRAST_RATE * (interval.contrast - self.contrast)
        self.body += CONTRAST_RATE * (interval.body - self.body)
        self.hits += 1
        if interval.shadow and not self.moved:
            self.born_at_m, self.way_m = self.rear_m, 0.0  # beside its caster a shadow goes far
        if self.speed_mps > DRIVING_MPS:
            self.driving_contrast += CONTRAST_RATE * (interval.contrast - self.driving_contrast)
        if (interval.shadow and self.is_long_shade) or self.is_fainter_than_it_was:
            self.disbelieve()

    def absorb(self, ahead: LaneVehicle) -> None:
        """Take the vehicle ahead for its own front part; whoever was seen longer gives the id."""
        self.length_m, self.length_known = ahead.front_m - self.rear_m, True
        if ahead.hits > self.hits:
            self.track_id, ahead.track_id = ahead.track_id, self.track_id
        self.hits = max(self.hits, ahead.hits)
        self.way_m = max(self.way_m, ahead.way_m)
        self.body, self.contrast = max(self.body, ahead.body), max(self.contrast, ahead.contrast)
        self.confirmed |= ahead.confirmed
        self.apparition &= ahead.apparition

    def gate_m(self) -> float:
        return GATE_M + GATE_SIGMAS * float(np.sqrt(self.var_station))


@dataclass(frozen=True, slots=True)
class Interval:
    """One measured interval of a lane."""

    approach: int
    lane: int
    rear_m: float
    front_m: float
    offset_m: float
    cut_rear: bool
    cut_front: bool
    contrast: float = 0.0
    body: float = 1.0  # share of it that shows more than cast shadow
    shadow: bool = False  # it is only the shadow of what is beside it
    roof: bool = False  # it is only what shows beyond a tall vehicle: its ends are rough
    astride: bool = False  # on the edge between its lane and the next to the right
    bodies: tuple[tuple[float, float], ...] = ()  # stations of what in it is no cast shadow
    joined: bool = False  # of parts of one vehicle, its rear and its front among them


def overlap_m(vehicle: LaneVehicle, interval: Interval) -> float:
    return min(vehicle.front_m, interval.front_m) - max(vehicle.rear_m, interval.rear_m)


def shared(vehicle: LaneVehicle, interval: Interval) -> float:
    """Return the overlap as a share of the shorter of the two."""
    shorter = min(vehicle.length_m, interval.front_m - interval.rear_m)
    return overlap_m(vehicle, interval) / max(shorter, 0.1)


def overlaps(vehicle: LaneVehicle, interval: Interval) -> bool:
    """Tell whether a vehicle may be what the interval shows."""
    low, high = sorted((vehicle.body, interval.body))
    known_dark = vehicle.body < LEAST_BODY and (vehicle.moved or vehicle.in_row)
    if low < LEAST_BODY and high >= SURE_BODY and not known_dark:
        return False  # one is a shadow, the other throws one
    if shared(vehicle, interval) >= 0.4:
        return True
    return not vehicle.confirmed and -overlap_m(vehicle, interval) < min(vehicle.gate_m(), 6.0)


def is_elsewhere(vehicle: LaneVehicle, interval: Interval, intervals: Sequence[Interval]) -> bool:
    """Tell whether a vehicle is only near an interval, and within another one."""
    if overlap_m(vehicle, interval) > 0:
        return False
    return any(overlap_m(vehicle, other) > 0 for other in intervals)


def that_fit(vehicles: list[LaneVehicle], interval: Interval) -> list[LaneVehicle]:
    """Leave out what is not believed yet where an interval is too short for all of them."""
    room_m = interval.front_m - interval.rear_m
    if len(vehicles) < 2 or room_m > FULL * sum(v.length_m for v in vehicles):
        return vehicles
    return [v for v in vehicles if v.confirmed] or vehicles


def stopped_dead(
    vehicles: Sequence[LaneVehicle],
    interval: Interval,
    intervals: Sequence[Interval],
    t_s: float,
) -> LaneVehicle | None:
    """Return the vehicle of a lane that lost its interval, and must be this one.

    Nobody brakes so hard, but who drives into another one stops so.
    """
    length_m = interval.front_m - interval.rear_m
    lost = [
        v
        for v in vehicles
        if v.confirmed
        and 0 < t_s - v.seen_s <= DEAD_STOP_S
        and v.seen_at_m - 1.0 < interval.rear_m < v.rear_m + 1.0
        and abs(length_m - v.length_m) < ALIKE_LENGTH * v.length_m
        and interval.contrast > ALIKE_CONTRAST * v.contrast
        and not any(overlaps(v, other) for other in intervals)
    ]
    return lost[0] if len(lost) == 1 else None


def owns(thing: LaneVehicle, interval: Interval, t_s: float) -> bool:
    """Tell whether an interval is the shadow or stain that has been lying there, and no vehicle."""
    is_shade = thing.only_shade and interval.body < LEAST_BODY
    known = thing.mark or (is_shade and t_s - thing.born_s > SHADE_KNOWN_S)
    return (
        known
        and abs(interval.rear_m - thing.rear_m) < SHADE_SWAY_M
        and abs(interval.front_m - thing.front_m) < SHADE_SWAY_M
    )


def same_place(interval: Interval, place: Interval) -> bool:
    """Tell whether an interval lies, but for a metre, where another one did."""
    return (
        (interval.approach, interval.lane) == (place.approach, place.lane)
        and interval.rear_m > place.rear_m - 1.0
        and interval.front_m < place.front_m + 1.0
    )


def without_doubles(vehicles: list[LaneVehicle]) -> list[LaneVehicle]:
    """Of two vehicles of a lane at one place keep the one that moved, then the more often seen."""
    kept: list[LaneVehicle] = []
    for v in sorted(vehicles, key=lambda v: (not v.moved, -v.hits)):
        if v.only_shade or not any(
            not k.only_shade
            and k.approach == v.approach
            and k.lane == v.lane
            and min(k.front_m, v.front_m) - max(k.rear_m, v.rear_m)
            > 0.5 * min(k.length_m, v.length_m)
            for k in kept
        ):
            kept.append(v)
    return kept
