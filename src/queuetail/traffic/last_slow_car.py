"""The paper's queue: the last slow car, decided anew in every frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from queuetail.traffic.growth import Growth
from queuetail.traffic.queue import end_of_queue, slow_vehicles
from queuetail.types import (
    Approach,
    Bools,
    QueueState,
    QueueStatus,
    RoadVehicles,
    Scene,
)


class LastSlowCar:
    """EOQ = the most upstream car below the queue speed going the approach's way.

    Source: Messenger et al. (2023). It knows neither hysteresis nor the picture's edge.
    """

    def __init__(self, queue_speed_mps: float) -> None:
        self._queue_speed_mps = queue_speed_mps
        self._growth: dict[str, Growth] = {}

    def update(
        self, vehicles: RoadVehicles, approaches: Sequence[Approach], scene: Scene
    ) -> tuple[RoadVehicles, tuple[QueueState, ...]]:
        """Return the vehicles with `queued` set, and the state of every approach."""
        marked = vehicles.queued.copy()
        states = []
        for index, approach in enumerate(approaches):
            queued = slow_vehicles(vehicles, index, self._queue_speed_mps)
            marked |= queued
            states.append(self._state(vehicles, queued, approach, scene))
        return dataclasses.replace(vehicles, queued=marked), tuple(states)

    def _state(
        self, vehicles: RoadVehicles, queued: Bools, approach: Approach, scene: Scene
    ) -> QueueState:
        growth = self._growth.setdefault(approach.name, Growth())
        eoq = end_of_queue(vehicles, queued, approach, scene.mapping)
        rate = growth.update(scene.t_s, None if eoq is None else eoq.station_m)
        if eoq is None:
            return QueueState(approach.name, QueueStatus.CLEAR)
        eoq = dataclasses.replace(eoq, growth_mps=rate)
        return QueueState(approach.name, QueueStatus.QUEUED, eoq)
