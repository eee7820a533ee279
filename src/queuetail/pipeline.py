"""The whole system on one screen: each stage one call, each result one record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    Frame,
    GroundMapping,
    Image,
    Observation,
    QueueState,
    QueueStatus,
    Registration,
    RoadVehicles,
    Scene,
    TelemetrySample,
    Tracks,
    Unknown,
)

# What a preset's view, background, detector and tracker hand to each other: the spine only carries
# it, and each part's own signature says which record it is.
Carried = Any

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


class Registrar(Protocol):
    def register(self, frame: Frame, telemetry: TelemetrySample) -> Registration: ...


class Mapper(Protocol):
    def mapping(
        self, telemetry: TelemetrySample, registration: Registration
    ) -> GroundMapping | Unknown: ...


class Road(Protocol):
    approaches: tuple[Approach, ...]

    @property
    def notes(self) -> tuple[str, ...]: ...

    def look(self, frame: Frame, mapping: GroundMapping, registration: Registration) -> None: ...

    def locate(self, tracks: Tracks) -> RoadVehicles: ...


class View(Protocol):
    def render(
        self, frame: Frame, mapping: GroundMapping, approaches: tuple[Approach, ...]
    ) -> Carried: ...

    def cover(self, footprints: Carried) -> Image: ...

    def low(self, footprints: Carried) -> Carried: ...

    def locate(self, detections: Carried, raster: Carried, mapping: GroundMapping) -> Carried: ...


class Background(Protocol):
    def apply(self, raster: Carried, t_s: float, protect: Image) -> Carried: ...


class Detector(Protocol):
    def find(self, masks: Carried, raster: Carried, low: Carried) -> Carried: ...


class Tracker(Protocol):
    def footprints(self) -> Carried: ...

    def update(self, points: Carried, scene: Scene) -> Tracks: ...


class Queue(Protocol):
    def update(
        self, vehicles: RoadVehicles, approaches: Sequence[Approach], scene: Scene
    ) -> tuple[RoadVehicles, tuple[QueueState, ...]]: ...


@dataclass(slots=True)
class Pipeline:
    """A preset's parts, plugged together; `lap` is told each stage's name as it ends."""

    registrar: Registrar
    mapper: Mapper
    road: Road
    view: View
    background: Background
    detector: Detector
    tracker: Tracker
    queue: Queue
    lap: Callable[[str], None]
    longest_s: float = 0.0  # that may pass between two frames that are processed; 0 wants all

    def step(self, frame: Frame, telemetry: TelemetrySample) -> Observation:
        """Take one frame and what telemetry said then; return all that they tell."""
        registration = self.registrar.register(frame, telemetry)
        self.lap("register")
        mapping = self.mapper.mapping(telemetry, registration)
        self.lap("map")
        if isinstance(mapping, Unknown):
            return self._blind(frame, mapping, registration)
        self.road.look(frame, mapping, registration)
        self.lap("road")
        raster = self.view.render(frame, mapping, self.road.approaches)
        self.lap("view")
        known = self.tracker.footprints()
        masks = self.background.apply(raster, frame.t_s, self.view.cover(known))
        self.lap("background")
        detections = self.detector.find(masks, raster, self.view.low(known))
        self.lap("detect")
        points = self.view.locate(detections, raster, mapping)
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
            registration=registration,
            detections_px=points.boxes_px,
            approaches=self.road.approaches,
            vehicles=vehicles,
            states=states or self._unknown(NO_ROAD_YET),
        )

    def _blind(self, frame: Frame, why: Unknown, registration: Registration) -> Observation:
        """Return the observation of a frame whose place on the ground is unknown."""
        return Observation(
            frame_index=frame.index,
            t_s=frame.t_s,
            mapping=why,
            registration=registration,
            detections_px=np.empty((0, 4)),
            approaches=self.road.approaches,
            vehicles=assign(NO_TRACKS, self.road.approaches),
            states=self._unknown(why),
        )

    def _unknown(self, why: Unknown) -> tuple[QueueState, ...]:
        names = [a.name for a in self.road.approaches] or [""]
        return tuple(QueueState(n, QueueStatus.UNKNOWN, None, why.reasons) for n in names)
