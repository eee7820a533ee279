"""Presets: a dict from name to the function that plugs its parts together."""

from __future__ import annotations

from collections.abc import Callable

from queuetail.config import Site
from queuetail.mapping import (
    FixedMapper,
    RegisteredMapper,
    TelemetryMapper,
    control_point_mapping,
    site_approaches,
)
from queuetail.pipeline import Pipeline
from queuetail.registrar import FrameRegistrar, NoRegistration
from queuetail.scouted_road import FoundRoad, SiteRoad
from queuetail.tracking.lane_tracker import LaneTracker
from queuetail.tracking.meanshift import MeanShiftTracker
from queuetail.traffic.discovery import StraightRoad
from queuetail.traffic.last_slow_car import LastSlowCar
from queuetail.traffic.road import KnownRoad
from queuetail.traffic.state import QueueWatch
from queuetail.types import Origin
from queuetail.vision.asphalt import RoadBackground
from queuetail.vision.background import MODELS, PaperBackground
from queuetail.vision.blobs import SimpleBlobs
from queuetail.vision.lanes import LaneDetector
from queuetail.vision.road_view import RoadView
from queuetail.vision.view import WholeFrame

# Between two pictures: every fourth of 30 a second, every third of 25, each of 10.
ROAD_LONGEST_S = 0.136

Lap = Callable[[str], None]
Build = Callable[[Site, Origin | None, int, int, Lap], Pipeline]


def paper(site: Site, origin: Origin | None, width_px: int, height_px: int, lap: Lap) -> Pipeline:
    """The method of Messenger et al. (2023), step by step: the yardstick."""
    settings = site.paper
    view = WholeFrame(settings.width_px)
    return Pipeline(
        registrar=NoRegistration(),
        mapper=telemetry_or_control_points(site, origin, width_px, height_px),
        road=KnownRoad(site_approaches(site, origin))
        if site.approach
        else StraightRoad(settings.direction_deg),
        view=view,
        background=PaperBackground(
            MODELS[settings.background](), settings.blur_px, settings.dilate_px
        ),
        detector=SimpleBlobs(settings.min_blob_px2),
        tracker=MeanShiftTracker(view.locate),
        queue=LastSlowCar(site.queue_speed_mps),
        lap=lap,
    )


def road(site: Site, origin: Origin | None, width_px: int, height_px: int, lap: Lap) -> Pipeline:
    """Registration, a metric strip of the road, a background that keeps what stops."""
    mapper = telemetry_or_control_points(site, origin, width_px, height_px)
    if isinstance(mapper, TelemetryMapper):
        registrar = FrameRegistrar(width_px, height_px, mapper)
        registered: RegisteredMapper | FixedMapper = RegisteredMapper(mapper, width_px, height_px)
    else:
        registrar, registered = FrameRegistrar(width_px, height_px, None), mapper
    approaches = site_approaches(site, origin)
    return Pipeline(
        registrar=registrar,
        mapper=registered,
        road=SiteRoad(approaches, registered) if approaches else FoundRoad(),
        view=RoadView(),
        background=RoadBackground(),
        detector=LaneDetector(),
        tracker=LaneTracker(),
        queue=QueueWatch(site.queue_speed_mps),
        lap=lap,
        longest_s=ROAD_LONGEST_S,
    )


PRESETS: dict[str, Build] = {"paper": paper, "road": road}
DEFAULT_PRESET = "road"


def telemetry_or_control_points(
    site: Site, origin: Origin | None, width_px: int, height_px: int
) -> TelemetryMapper | FixedMapper:
    """Return the site's control points as a fixed mapping, or else what telemetry says."""
    if site.control_point:
        return FixedMapper(control_point_mapping(site, origin, width_px, height_px))
    assert origin is not None, "without control points telemetry gives the origin"
    return TelemetryMapper(width_px, height_px, site.camera, origin)
