"""The whole system on one screen: each stage one call, each result one record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from queuetail.mapping import Mapper
from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    Detections,
    Frame,
    GroundMapping,
    GroundPoints,
    Image,
    Observation,
    QueueState,
    QueueStatus,
    Raster,
    Registration,
    RoadVehicles,
    Scene,
    TelemetrySample,
    Tracks,
    Unknown,
)
from queuetail.vision.view import boxes_to_px

NO_TRACKS = Tracks(
    ids=np.empty(0, np.int64),
    states=(),
    px=np.empty((0, 2)),
    boxes_px=np.empty((0, 4)),
    enu=np.empty((0, 2)),
    velocity_mps=np.empty((0, 2)),
    sigma_m=np.empty(0),
    length_m=np.empty(0),
)
NO_ROAD_YET = Unknown(("no site file, and too few vehicles yet to see where the road is",))


class View(Protocol):
    def render(self, frame: Frame, mapping: GroundMapping) -> Raster: ...

    def locate(
        self, detections: Detections, raster: Raster, mapping: GroundMapping
    ) -> GroundPoints: ...


class Background(Protocol):
    def apply(self, image: Image) -> Image: ...


class Blobs(Protocol):
    def find(self, mask: Image) -> Detections: ...


class Tracker(Protocol):
    def update(self, points: GroundPoints, scene: Scene) -> Tracks: ...


class Road(Protocol):
    approaches: tuple[Approach, ...]

    def locate(self, tracks: Tracks) -> RoadVehicles: ...


class Queue(Protocol):
    def update(
        self, vehicles: RoadVehicles, approaches: Sequence[Approach], scene: Scene
    ) -> tuple[RoadVehicles, tuple[QueueState, ...]]: ...


@dataclass(slots=True)
class Pipeline:
    """A preset's parts, plugged together; `lap` is told each stage's name as it ends."""

    mapper: Mapper
    view: View
    background: Background
    blobs: Blobs
    tracker: Tracker
    road: Road
    queue: Queue
    lap: Callable[[str], None]

    def step(self, frame: Frame, telemetry: TelemetrySample) -> Observation:
        """Take one frame and what telemetry said then; return all that they tell."""
        mapping = self.mapper.mapping(telemetry)
        self.lap("map")
        if isinstance(mapping, Unknown):
            return self._blind(frame, mapping)
        raster = self.view.render(frame, mapping)
        self.lap("view")
        mask = self.background.apply(raster.image)
        self.lap("background")
        detections = self.blobs.find(mask)
        self.lap("blobs")
        points = self.view.locate(detections, raster, mapping)
        self.lap("locate")
        scene = Scene(frame.t_s, raster, mapping)
        tracks = self.tracker.update(points, scene)
        self.lap("track")
        vehicles = self.road.locate(tracks)
        vehicles, states = self.queue.update(vehicles, self.road.approaches, scene)
        self.lap("queue")
        return Observation(
            frame_index=frame.index,
            t_s=frame.t_s,
            mapping=mapping,
            registration=Registration(np.eye(3), 1.0),
            detections_px=boxes_to_px(detections.boxes, raster),
            approaches=self.road.approaches,
            vehicles=vehicles,
            states=states or self._unknown(NO_ROAD_YET),
        )

    def _blind(self, frame: Frame, why: Unknown) -> Observation:
        """Return the observation of a frame whose place on the ground is unknown."""
        return Observation(
            frame_index=frame.index,
            t_s=frame.t_s,
            mapping=why,
            registration=Registration(np.eye(3), 0.0, "; ".join(why.reasons)),
            detections_px=np.empty((0, 4)),
            approaches=self.road.approaches,
            vehicles=assign(NO_TRACKS, self.road.approaches),
            states=self._unknown(why),
        )

    def _unknown(self, why: Unknown) -> tuple[QueueState, ...]:
        names = [a.name for a in self.road.approaches] or [""]
        return tuple(QueueState(n, QueueStatus.UNKNOWN, None, why.reasons) for n in names)
