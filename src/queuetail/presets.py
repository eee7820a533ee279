"""Presets: a dict from name to the function that plugs its parts together."""

from __future__ import annotations

from collections.abc import Callable

from queuetail.config import Site
from queuetail.mapping import (
    FixedMapper,
    Mapper,
    TelemetryMapper,
    control_point_mapping,
    site_approaches,
)
from queuetail.pipeline import Pipeline
from queuetail.tracking.meanshift import MeanShiftTracker
from queuetail.traffic.discovery import StraightRoad
from queuetail.traffic.last_slow_car import LastSlowCar
from queuetail.traffic.road import KnownRoad
from queuetail.types import Origin
from queuetail.vision.background import MODELS, PaperBackground
from queuetail.vision.blobs import SimpleBlobs
from queuetail.vision.view import WholeFrame

Build = Callable[[Site, Origin | None, int, int, Callable[[str], None]], Pipeline]


def paper(
    site: Site, origin: Origin | None, width_px: int, height_px: int, lap: Callable[[str], None]
) -> Pipeline:
    """The method of Messenger et al. (2023), step by step: the yardstick."""
    settings = site.paper
    view = WholeFrame(settings.width_px)
    return Pipeline(
        mapper=choose_mapper(site, origin, width_px, height_px),
        view=view,
        background=PaperBackground(
            MODELS[settings.background](), settings.blur_px, settings.dilate_px
        ),
        blobs=SimpleBlobs(settings.min_blob_px2),
        tracker=MeanShiftTracker(view.locate),
        road=KnownRoad(site_approaches(site, origin))
        if site.approach
        else StraightRoad(settings.direction_deg),
        queue=LastSlowCar(site.queue_speed_mps),
        lap=lap,
    )


PRESETS: dict[str, Build] = {"paper": paper}
DEFAULT_PRESET = "paper"


def choose_mapper(site: Site, origin: Origin | None, width_px: int, height_px: int) -> Mapper:
    """Return the site's control points as a fixed mapping, or else what telemetry says."""
    if site.control_point:
        return FixedMapper(control_point_mapping(site, origin, width_px, height_px))
    assert origin is not None, "without control points telemetry gives the origin"
    return TelemetryMapper(width_px, height_px, site.camera, origin)
