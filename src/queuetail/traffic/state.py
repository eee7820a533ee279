"""The queue over time: hysteresis in speed and time for vehicles, a state machine for roads.

A vehicle is queued from 1 s after it falls below the queue speed until it has been above 1.25 × it
for 1 s; the end of the queue is the rear of the most upstream queued vehicle that has another
queued one within 60 m downstream (the definition that ground truth uses).  For who brakes to that
speed just before the picture ends, while the road goes on, that one is beyond the picture.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.geo.ground import covariance
from queuetail.traffic.growth import Growth
from queuetail.traffic.queue import end_of_queue
from queuetail.traffic.road import length_m, locate
from queuetail.types import (
    Approach,
    Bools,
    EndOfQueue,
    Floats,
    QueueState,
    QueueStatus,
    RoadRaster,
    RoadVehicles,
    Scene,
    TrackState,
)

SLOW_S, FAST_S = 0.95, 0.95  # below or above the speed before a vehicle changes its mind: the
# definition's second, less what the tracker needs to see a braking
RELEASE_FACTOR = 1.25
JOINING_FACTOR = 1.15  # of the queue speed: from there down a vehicle may be queued in a moment
COMPANION_M = 60.0
SHORTEST_M = 3.5  # a car and its gap: what is nearer in one lane is the same vehicle, seen in parts
BRAKED = 2.0  # from so many times the queue speed: for somebody ahead,
GAP_M, GAP_S = 3.0, 1.5  # who is no farther than this, and the way driven in that time
EDGE_M = 4.0  # nearer to the end of what is seen, a queue may go on beyond it
WATCH_S = 1.0  # of road in view before it may be called clear: a queue takes as long to show
BREAK_S = 0.5  # out of view after which watching begins anew
ENTRY_M, STANDING_MPS = 3.0, 3.0
REVERSE_MPS = 1.5
FAR_INSIDE_M = 40.0  # where an end that was beyond the edge is surely in the picture
CLEAR_HOLD_S = 0.4  # a queue is not over because of one bad frame
FLOOR_SIGMA_M = 0.35
SIGMA_EVERY_S = 1.0


@dataclass(slots=True)
class _Memory:
    """What is remembered of one vehicle: queued or not, and since when it disagrees."""

    queued: bool = False
    since_s: float | None = None
    seen_s: float = 0.0
    fastest_mps: float = 0.0


class QueueWatch:
    """Decides the state of every approach from its vehicles."""

    def __init__(self, queue_speed_mps: float) -> None:
        self._speed_mps = queue_speed_mps
        self._memories: dict[int, _Memory] = {}
        self._growth: dict[str, Growth] = {}
        self._seen: dict[str, tuple[float, float]] = {}  # since when, and when last
        self._sigmas: dict[str, tuple[float, float]] = {}
        self._held: dict[str, tuple[float, QueueState]] = {}

    def update(
        self, vehicles: RoadVehicles, approaches: Sequence[Approach], scene: Scene
    ) -> tuple[RoadVehicles, tuple[QueueState, ...]]:
        """Return the vehicles with `queued` set, and the state of every approach."""
        assert isinstance(scene.raster, RoadRaster)
        slow = self._queued(vehicles, scene.raster.spans, scene.t_s)
        marked = np.zeros(len(vehicles), np.bool_)
        states = []
        for index, approach in enumerate(approaches):
            span = scene.raster.spans.get(index)
            ours = slow & (vehicles.approach == index)
            queued = with_companions(
                vehicles, ours, self._follow_unseen(vehicles, ours, approach, span)
            )
            marked |= queued
            states.append(self._state(vehicles, queued, index, approach, span, scene))
        return dataclasses.replace(vehicles, queued=marked), tuple(states)

    def _queued(
        self, vehicles: RoadVehicles, spans: dict[int, tuple[float, float]], t_s: float
    ) -> Bools:
        """Return which vehicles are queued by speed and time alone.

        The speed of one that is only half in the picture is a guess, unless it stands.
        """
        result = np.zeros(len(vehicles), np.bool_)
        ids = vehicles.tracks.ids.tolist()
        speeds = vehicles.speed_mps.tolist()
        for i, (track_id, speed) in enumerate(zip(ids, speeds, strict=True)):
            if vehicles.tracks.states[i] is TrackState.TENTATIVE or not np.isfinite(speed):
                continue
            if speed < -REVERSE_MPS:
                continue  # it does not head the approach's way
            begin_m = spans.get(int(vehicles.approach[i]), (-np.inf, np.inf))[0]
            if vehicles.rear_station_m[i] < begin_m + ENTRY_M and speed > STANDING_MPS:
                continue
            memory = self._memories.setdefault(track_id, _Memory())
            if vehicles.tracks.states[i] is TrackState.COASTING and not memory.queued:
                memory.since_s = None  # the speed of what is not seen is a guess
            else:
                step(memory, speed, t_s, self._speed_mps)
            result[i] = memory.queued
        if len(self._memories) > 4 * len(ids) + 100:
            alive = set(ids)
            self._memories = {k: m for k, m in self._memories.items() if k in alive}
        return result

    def _follow_unseen(
        self,
        vehicles: RoadVehicles,
        slow: Bools,
        approach: Approach,
        span: tuple[float, float] | None,
    ) -> Bools:
        """Return which slow vehicles braked for one that the picture does not show any more."""
        result = np.zeros_like(slow)
        if span is None or not slow.any():
            return result
        if span[1] > approach.start_station_m + length_m(approach) - COMPANION_M:
            return result  # the road as it is known goes no farther than what is seen
        front_m = vehicles.rear_station_m + vehicles.tracks.length_m
        for i in np.flatnonzero(slow).tolist():
            speed_mps = vehicles.speed_mps[i]
            braked = self._memories[int(vehicles.tracks.ids[i])].fastest_mps / self._speed_mps
            is_last = front_m[i] + GAP_M + GAP_S * speed_mps > span[1]
            result[i] = is_last and braked > BRAKED and speed_mps < self._speed_mps
        return result

    def _state(
        self,
        vehicles: RoadVehicles,
        queued: Bools,
        index: int,
        approach: Approach,
        span: tuple[float, float] | None,
        scene: Scene,
    ) -> QueueState:
        growth = self._growth.setdefault(approach.name, Growth())
        watched_s = self._watched(approach.name, span is not None, scene.t_s)
        if span is None:
            why = ("the approach is not in the picture, or too small in it",)
            return QueueState(approach.name, QueueStatus.UNKNOWN, None, why)
        eoq = end_of_queue(vehicles, queued, approach, scene.mapping)
        rate = growth.update(scene.t_s, None if eoq is None else eoq.station_m)
        if eoq is None and watched_s < WATCH_S:
            why = (f"the road was watched for {watched_s:.1f} s only",)
            return QueueState(approach.name, QueueStatus.UNKNOWN, None, why)
        if eoq is None:
            return self._held_or_clear(approach.name, scene.t_s)
        sigma = float(np.hypot(eoq.sigma_m, FLOOR_SIGMA_M))
        sigma = float(np.hypot(sigma, self._mapping_sigma(approach, eoq, scene)))
        # Two sigma shall cover the jump when a vehicle is near the speed at which it changes side.
        others = (vehicles.approach == index) & ~queued
        sigma = float(np.hypot(sigma, self._next_end_m(vehicles, queued, others) / 2))
        eoq = dataclasses.replace(eoq, growth_mps=rate, sigma_m=sigma)
        beyond = self._reaches_beyond(vehicles, queued, approach, eoq.station_m, span[0])
        status = QueueStatus.BEYOND_VIEW if beyond else QueueStatus.QUEUED
        state = QueueState(approach.name, status, eoq)
        self._held[approach.name] = (scene.t_s, state)
        return state

    def _watched(self, name: str, visible: bool, t_s: float) -> float:
        """Return for how long the approach has been in view without a break, in seconds."""
        since_s, last_s = self._seen.get(name, (t_s, t_s))
        if not visible or t_s - last_s > BREAK_S:
            since_s = t_s
        self._seen[name] = (since_s, t_s)
        return t_s - since_s

    def _reaches_beyond(
        self,
        vehicles: RoadVehicles,
        queued: Bools,
        approach: Approach,
        station_m: float,
        edge_m: float,
    ) -> bool:
        """Tell whether the queue runs out of the picture upstream.

        Once it did, it does until its end is far inside or someone drives freely up to it.
        """
        held = self._held.get(approach.name)
        was = held is not None and held[1].status is QueueStatus.BEYOND_VIEW
        if not was:
            return station_m < edge_m + EDGE_M
        on_road = np.isfinite(vehicles.station_m) & ~queued
        follows = on_road & (vehicles.station_m < station_m) & (vehicles.station_m > edge_m)
        confirmed = [s is not TrackState.TENTATIVE for s in vehicles.tracks.states]
        moving = vehicles.speed_mps > RELEASE_FACTOR * self._speed_mps
        return station_m < edge_m + FAR_INSIDE_M and not bool(
            (follows & moving & np.array(confirmed, np.bool_)).any()
        )

    def _next_end_m(self, vehicles: RoadVehicles, queued: Bools, others: Bools) -> float:
        """Return how far the end may be about to jump: to who joins next, or stays last.

        `others` are the approach's vehicles that are not queued.
        """
        rear = vehicles.rear_station_m
        order = np.flatnonzero(queued)[np.argsort(rear[queued])]
        behind_m = rear[order[0]] - rear
        confirmed = np.array([s is not TrackState.TENTATIVE for s in vehicles.tracks.states], bool)
        slow = vehicles.speed_mps < JOINING_FACTOR * self._speed_mps
        joins = others & confirmed & slow & (behind_m > 0) & (behind_m <= COMPANION_M)
        jumps = [float(behind_m[joins].min())] if joins.any() else [0.0]
        last = self._memories.get(int(vehicles.tracks.ids[order[0]]))
        if len(order) > 1 and last is not None and last.since_s is not None:
            jumps.append(float(rear[order[1]] - rear[order[0]]))
        return max(jumps)

    def _mapping_sigma(self, approach: Approach, eoq: EndOfQueue, scene: Scene) -> float:
        """Return how well the mapping knows the station of the end of the queue, in metres."""
        known = self._sigmas.get(approach.name)
        if known is None or scene.t_s - known[0] >= SIGMA_EVERY_S:
            spread = covariance(scene.mapping, np.array([eoq.px]))[0]
            course = locate(approach, np.array([eoq.enu]))[2][0]
            along = float(np.sqrt(max(course @ spread @ course, 0.0)))
            known = self._sigmas[approach.name] = (scene.t_s, along)
        return known[1]

    def _held_or_clear(self, name: str, t_s: float) -> QueueState:
        """Hold the last queue for a moment: dissolving takes longer than one frame."""
        held = self._held.get(name)
        if held is not None and t_s - held[0] < CLEAR_HOLD_S:
            return held[1]
        return QueueState(name, QueueStatus.CLEAR)


def step(memory: _Memory, speed_mps: float, t_s: float, queue_speed_mps: float) -> None:
    """Advance one vehicle's hysteresis in speed and time."""
    memory.seen_s = t_s
    memory.fastest_mps = max(memory.fastest_mps, speed_mps)
    limit = queue_speed_mps * (RELEASE_FACTOR if memory.queued else 1.0)
    disagrees = speed_mps > limit if memory.queued else speed_mps < limit
    if not disagrees:
        memory.since_s = None
    elif memory.since_s is None:
        memory.since_s = t_s
    elif t_s - memory.since_s >= (FAST_S if memory.queued else SLOW_S):
        memory.queued, memory.since_s = not memory.queued, None


def with_companions(vehicles: RoadVehicles, slow: Bools, follow_unseen: Bools) -> Bools:
    """Keep the slow vehicles of a queue: those with another one close downstream, and those ones.

    A lone slow vehicle, or one far behind the rest, is not a queue, nor are two parts of one; what
    the `follow_unseen` ones (n,) brake for counts as another one.
    """
    rows = np.flatnonzero(slow)
    rear: Floats = vehicles.rear_station_m[rows]
    ahead_m = rear - rear[:, None]
    is_other = (vehicles.lane[rows] != vehicles.lane[rows][:, None]) | (ahead_m > SHORTEST_M)
    near = (ahead_m >= 0) & (ahead_m <= COMPANION_M) & is_other
    kept = near.any(axis=0) | near.any(axis=1)
    kept |= follow_unseen[rows]
    result = np.zeros_like(slow)
    result[rows[kept]] = True
    return result
