"""Vehicles followed along their lanes, in road metres, by one Kalman filter each.

In a lane nobody overtakes, so where vehicles merge into one interval their order tells which end is
whose.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from queuetail.tracking.driving_lines import DrivingLines
from queuetail.tracking.lane_belief import (
    came_through,
    drives_into,
    looks_like_a_vehicle,
    surely_drives,
    unmasked,
)
from queuetail.tracking.lane_correction import correct_one, keep_behind
from queuetail.tracking.lane_sight import flow_mps, follow_flow, is_hidden
from queuetail.tracking.lane_tracks import carried_over, tracks_of
from queuetail.tracking.lane_vehicle import (
    DRIVING_MPS,
    FIRST_SPEED_SIGMA_MPS,
    SHADE_KNOWN_S,
    STANDING_MPS,
    Interval,
    LaneVehicle,
    is_elsewhere,
    overlap_m,
    overlaps,
    owns,
    same_place,
    shared,
    stopped_dead,
    that_fit,
    without_doubles,
)
from queuetail.tracking.merged import correct_merged
from queuetail.tracking.parts import joined_parts, mark_rows, merge_followers, stands_in_row
from queuetail.types import (
    Approach,
    LaneSight,
    RoadPoints,
    RoadRaster,
    Scene,
    Tracks,
)

TYPICAL_LENGTH_M = 4.7
LONGEST_M = 19.0
SLOT_M = 7.2  # a standing car with its gap, where nothing else tells merged cars apart
CONFIRM_HITS, CONFIRM_S, CONFIRM_SPEED_SIGMA_MPS = 4, 0.3, 2.5
COLD_START_S = 2.0
EARLY_S = 10.0  # after the first picture: who stands there may have been sought in wrong places
ENTRY_M = 20.0  # from the upstream end of what is seen, where vehicles may first show up
APPARITION_S = 6.0
COAST_S, TENTATIVE_COAST_S = 1.2, 0.25  # without a trace in the picture
HIDDEN_S, HIDDEN_DRIVING_S = 60.0, 3.0  # behind a tall vehicle that stands, or that drives
FLOW_FIRST_SIGMA_MPS = 1.0  # at the least, of a newcomer: it may be something else that moves there
SHADE_HIDDEN_S = 3.0
BACK_M = 2.0  # from where it was born
ASTRIDE_SHARED = 0.6  # of the shorter, of a vehicle and what is seen between its lane and the next


class LaneTracker:
    """Follows the vehicles of all lanes; see the module's docstring."""

    def __init__(self) -> None:
        self._vehicles: list[LaneVehicle] = []
        self._next_id = 1
        self._driven: list[Interval] = []  # where standing things turned out to be no vehicles
        self._approaches: tuple[Approach, ...] = ()
        self._lines = DrivingLines()
        self._last_s: float | None = None
        self._first_s: float | None = None
        self._tracks: Tracks | None = None

    def footprints(self) -> list[tuple[int, int, float, float, bool, bool]]:
        """Return every vehicle that the background must keep.

        Each is (approach, lane, rear, front), whether it is surely a car, and whether it has moved.
        """
        kept = (
            v
            for v in self._vehicles
            if not (v.mark or v.only_shade) and (v.moved or looks_like_a_vehicle(v, 0.75))
        )
        return [(v.approach, v.lane, v.rear_m, v.front_m, v.is_car, v.moved) for v in kept]

    def update(self, points: RoadPoints, scene: Scene) -> Tracks:
        """Move all vehicles to the frame's time, take in what was measured, return them all."""
        assert isinstance(scene.raster, RoadRaster)
        if scene.raster.approaches is not self._approaches:
            self._lay_out(scene.raster.approaches, scene)
        before_s = scene.t_s if self._last_s is None else self._last_s
        dt_s, self._last_s = max(scene.t_s - before_s, 0.0), scene.t_s
        self._first_s = scene.t_s if self._first_s is None else self._first_s
        measured, astride = _by_lane(points)
        for vehicle in self._vehicles:
            vehicle.predict(dt_s)
        self._follow_astride(astride, scene.t_s, dt_s)
        for vehicle in self._vehicles:
            sight = points.sights.get((vehicle.approach, vehicle.lane))
            follow_flow(vehicle, sight, vehicle.seen_s >= before_s and not vehicle.astride)
        lanes = sorted({(v.approach, v.lane) for v in self._vehicles})
        left: list[Interval] = []
        for key in sorted(set(lanes) | set(measured)):
            sight = points.sights.get(key)
            left += self._update_lane(key, measured.get(key, []), sight, scene.t_s, dt_s)
        left = [i for i in left if not i.shadow or stands_in_row(i, self._vehicles)]
        left = self._changed_lanes(left, scene.t_s)
        for interval in left:
            begin_m = points.spans.get(interval.approach, (-np.inf, np.inf))[0]
            self._start(interval, begin_m, points.sights, scene.t_s)
        self._driven += unmasked(self._vehicles)
        self._retire(points, scene.t_s)
        self._tracks = tracks_of(self._vehicles, self._approaches, scene)
        return self._tracks

    def _lay_out(self, approaches: tuple[Approach, ...], scene: Scene) -> None:
        """Take another road, or another idea of where it is: stations no longer mean the same."""
        early = self._first_s is not None and scene.t_s - self._first_s < EARLY_S
        if early or not self._approaches:
            self._first_s = None
        self._approaches, self._driven, self._lines = approaches, [], DrivingLines()
        if self._tracks is not None:
            self._vehicles = carried_over(self._vehicles, self._tracks, approaches, scene.mapping)

    def _update_lane(
        self,
        key: tuple[int, int],
        intervals: list[Interval],
        sight: LaneSight | None,
        t_s: float,
        dt_s: float,
    ) -> list[Interval]:
        """Correct one lane's vehicles; return the intervals that nobody claims."""
        vehicles = sorted(
            (v for v in self._vehicles if (v.approach, v.lane) == key), key=lambda v: v.rear_m
        )
        unclaimed: list[Interval] = []
        gone: list[LaneVehicle] = []
        intervals = joined_parts(vehicles, intervals)
        for interval in intervals:
            inside = claimants(interval, vehicles, intervals, sight, t_s)
            if not inside:
                unclaimed.append(interval)
            elif len(inside) == 1:
                unclaimed += correct_one(inside[0], interval, dt_s)
            else:
                gone += correct_merged(inside, interval, dt_s)
            for vehicle in inside:
                vehicle.take_in(interval, t_s)
        for vehicle in vehicles:
            if vehicle.seen_s < t_s and vehicle.speed_mps < STANDING_MPS:
                vehicle.speed_mps = 0.0  # noise would carry it away while it is not seen
        for behind, ahead in pairwise(vehicles):
            if behind.confirmed and ahead.confirmed and behind.seen_s < t_s:
                ahead.run_into += drives_into(behind, ahead, t_s - behind.seen_s)
                keep_behind(behind, ahead)
        gone += merge_followers([v for v in vehicles if v not in gone], dt_s)
        self._vehicles = [v for v in self._vehicles if v not in gone]
        return unclaimed

    def _follow_astride(self, intervals: list[Interval], t_s: float, dt_s: float) -> None:
        """Follow vehicles that drive on the edge between two lanes; nothing is born there."""
        for interval in intervals:
            beside = [
                v
                for v in self._vehicles
                if v.approach == interval.approach
                and v.lane in (interval.lane, interval.lane + 1)
                and v.confirmed
                and v.moved
                and shared(v, interval) > ASTRIDE_SHARED
            ]
            if beside:
                vehicle = max(beside, key=lambda v: shared(v, interval))
                correct_one(vehicle, interval, dt_s)
                vehicle.offset_m = interval.offset_m
                vehicle.take_in(interval, t_s)

    def _changed_lanes(self, intervals: list[Interval], t_s: float) -> list[Interval]:
        """Let vehicles that lost their interval take one beside them; return what is left."""
        left = []
        for interval in intervals:
            beside = [
                v
                for v in self._vehicles
                if v.approach == interval.approach
                and abs(v.lane - interval.lane) == 1
                and v.seen_s < t_s
                and overlap_m(v, interval)
                > 0.6 * min(v.length_m, interval.front_m - interval.rear_m)
            ]
            if not beside:
                left.append(interval)
                continue
            vehicle = max(beside, key=lambda v: v.hits)
            vehicle.lane = interval.lane
            vehicle.seen_at_m = interval.rear_m
            correct_one(vehicle, interval, 0.0)
            vehicle.hits += 1
            vehicle.seen_s = t_s
        return left

    def _is_apparition(self, interval: Interval, begin_m: float, t_s: float) -> bool:
        """Vehicles come from upstream; only the first picture shows some in mid-view."""
        assert self._first_s is not None
        return t_s - self._first_s > COLD_START_S and interval.rear_m > begin_m + ENTRY_M

    def _start(
        self,
        interval: Interval,
        begin_m: float,
        sights: dict[tuple[int, int], LaneSight],
        t_s: float,
    ) -> None:
        length = interval.front_m - interval.rear_m
        pieces = max(1, round(length / SLOT_M)) if length > LONGEST_M else 1
        for piece in range(pieces):
            rear = interval.rear_m + piece * length / pieces
            own = length / pieces - (2.0 if pieces > 1 else 0.0)
            if interval.cut_rear:
                # Its rear is still outside: the front is all that is known.
                own = max(own, TYPICAL_LENGTH_M)
                rear = interval.front_m - own
            sight = sights.get((interval.approach, interval.lane))
            flow = flow_mps(sight, rear, rear + own)
            speed, sigma = self._speed_around(interval, rear)
            if flow is not None:
                speed, sigma = max(flow[0], 0.0), max(flow[1], FLOW_FIRST_SIGMA_MPS)
            self._vehicles.append(
                LaneVehicle(
                    self._next_id,
                    interval.approach,
                    interval.lane,
                    rear,
                    speed,
                    max(own, 2.5),
                    interval.offset_m,
                    t_s,
                    var_speed=sigma**2,
                    length_known=not (interval.cut_rear or interval.cut_front),
                    seen_s=t_s,
                    apparition=self._is_apparition(interval, begin_m, t_s),
                    mark=any(same_place(interval, place) for place in self._driven),
                    born_at_m=rear,
                    contrast=interval.contrast,
                    body=interval.body,
                )
            )
            self._next_id += 1

    def _speed_around(self, interval: Interval, rear_m: float) -> tuple[float, float]:
        """Guess a newcomer's speed from the nearest believed vehicle of its lane."""
        near = [
            v
            for v in self._vehicles
            if v.confirmed and v.approach == interval.approach and abs(v.rear_m - rear_m) < 60.0
        ]
        if not near:
            return 0.0, FIRST_SPEED_SIGMA_MPS
        nearest = min(near, key=lambda v: abs(v.rear_m - rear_m) + 20 * (v.lane != interval.lane))
        return nearest.speed_mps, 8.0

    def _retire(self, points: RoadPoints, t_s: float) -> None:
        """Confirm what was seen often enough and let go of what left or was lost."""
        kept = []
        mark_rows(self._vehicles)
        self._lines.learn(self._vehicles, t_s)
        for v in self._vehicles:
            if v.hits <= CONFIRM_HITS:
                v.born_at_m = v.rear_m  # until then it may slip along what it was first seen in
            elif v.speed_mps > STANDING_MPS:
                if v.seen_s == t_s:  # what is only supposed to go on proves nothing
                    v.way_m = max(v.way_m, v.rear_m - v.born_at_m)
            elif v.rear_m - v.born_at_m < BACK_M:
                v.way_m = 0.0  # who passed it seemed to take it along: no vehicle comes back
            if v.moved:
                v.apparition = v.mark = False
            settled = v.var_speed < CONFIRM_SPEED_SIGMA_MPS**2 and v.hits >= CONFIRM_HITS
            wait_s = APPARITION_S if v.apparition else CONFIRM_S
            on_road = v.in_row or not self._lines.is_aside(v)
            settled &= v.moved or (on_road and looks_like_a_vehicle(v))
            v.confirmed &= v.moved or (on_road and looks_like_a_vehicle(v, 0.75))
            if settled and t_s - v.born_s >= wait_s and not v.mark and not v.confirmed:
                v.confirmed = True
                for thing in self._vehicles:
                    thing.run_into += came_through(v, thing, t_s)
            v.shown = v.confirmed or (v.seen_s == t_s and on_road and surely_drives(v))
            begin_m, end_m = points.spans.get(v.approach, (-np.inf, np.inf))
            gone = v.rear_m > end_m - 1.0 or v.front_m < begin_m - 1.0
            unseen_s = t_s - v.seen_s
            limit_s = COAST_S if v.confirmed else TENTATIVE_COAST_S
            if v.only_shade and t_s - v.born_s > SHADE_KNOWN_S:
                limit_s = SHADE_HIDDEN_S  # a vehicle drives through it, and must not become it
            sight = points.sights.get((v.approach, v.lane))
            if v.confirmed and is_hidden(sight, v.rear_m, v.front_m):
                limit_s = HIDDEN_S if v.speed_mps < DRIVING_MPS else HIDDEN_DRIVING_S
            if not gone and unseen_s <= limit_s:
                kept.append(v)
        self._vehicles = without_doubles(kept)


def claimants(
    interval: Interval,
    vehicles: list[LaneVehicle],
    intervals: list[Interval],
    sight: LaneSight | None,
    t_s: float,
) -> list[LaneVehicle]:
    """Return the vehicles of a lane that one of its intervals shows, the last one first."""
    known = [v for v in vehicles if owns(v, interval, t_s)]
    here = [
        v for v in vehicles if overlaps(v, interval) and not is_elsewhere(v, interval, intervals)
    ]
    inside = known[:1] or that_fit(here, interval)
    if any(v.confirmed for v in inside):
        return inside
    flow = flow_mps(sight, interval.rear_m, interval.front_m)
    if flow is None or abs(flow[0]) >= STANDING_MPS:
        return inside
    crashed = stopped_dead(vehicles, interval, intervals, t_s)
    if crashed is None:
        return inside
    crashed.restart(interval.rear_m, 0.0, FLOW_FIRST_SIGMA_MPS)
    return [crashed]


def _by_lane(points: RoadPoints) -> tuple[dict[tuple[int, int], list[Interval]], list[Interval]]:
    """Return the intervals of every lane, and those between two."""
    lanes: dict[tuple[int, int], list[Interval]] = {}
    astride: list[Interval] = []
    rows = zip(
        points.approach.tolist(),
        points.lane.tolist(),
        points.rear_m.tolist(),
        points.front_m.tolist(),
        points.offset_m.tolist(),
        points.cut_rear.tolist(),
        points.cut_front.tolist(),
        points.contrast.tolist(),
        points.body.tolist(),
        points.shadow.tolist(),
        points.roof.tolist(),
        points.astride.tolist(),
        [tuple(map(tuple, b.tolist())) for b in points.bodies] or [()] * len(points),
        strict=True,
    )
    for row in rows:
        interval = Interval(*row)
        if interval.astride:
            astride.append(interval)
        else:
            lanes.setdefault((row[0], row[1]), []).append(interval)
    return lanes, astride
