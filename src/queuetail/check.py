"""The accuracy check of a recorded flight and of a run: what `queuetail check` does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from queuetail.accuracy.improve import Improvement
from queuetail.accuracy.points import KnownPoint
from queuetail.accuracy.speed import SpeedCheck, check_speed
from queuetail.config import MPS_PER_MPH, Site, TelemetryFill
from queuetail.errors import InputError
from queuetail.flight import open_flight
from queuetail.presets import telemetry_or_control_points
from queuetail.registrar import STILL
from queuetail.sinks.folder import read_tracks
from queuetail.site_editor import with_table
from queuetail.types import GroundMapping, Unknown

DIGITS = 4  # of offsets in site files: a tenth of a millimetre


@dataclass(frozen=True, slots=True)
class DrivenSpeed:
    """A vehicle of a run that was driven at a known speed, perhaps only for a while."""

    track_id: int
    speed_mps: float
    span_s: tuple[float, float] | None = None


def mappings_of(
    points: Sequence[KnownPoint], video: Path, telemetry: Path | None, site: Site
) -> list[GroundMapping]:
    """Return where telemetry or control points put the picture at each point's time.

    Raises InputError where a point is not in the video, or its place on earth is not known.
    """
    found = []
    with open_flight(video, telemetry, site) as flight:
        size = flight.video.width_px, flight.video.height_px
        end_s = math.inf if flight.video.duration_s is None else flight.video.duration_s
        mapper = telemetry_or_control_points(site, flight.origin, *size)
        for number, point in enumerate(points, 1):
            inside = 0 <= point.px[0] <= size[0] and 0 <= point.px[1] <= size[1]
            if not inside or not 0 <= point.t_s <= end_s:
                raise InputError(
                    f"point {number} ({point.px[0]:g}, {point.px[1]:g} at {point.t_s:g} s) lies "
                    f"outside {video} ({size[0]}×{size[1]}, {end_s:.1f} s)"
                )
            mapping = mapper.mapping(flight.telemetry_at(point.t_s), STILL)
            if isinstance(mapping, Unknown):
                raise InputError(f"{video} at {point.t_s:g} s: {'; '.join(mapping.reasons)}")
            if mapping.origin is None:
                raise InputError(
                    "the site's control points are in local metres, so pixels have no latitude "
                    "to compare; give [site] an origin"
                )
            found.append(mapping)
    return found


def with_offsets(fill: TelemetryFill, found: Improvement) -> dict[str, float]:
    """Return the keys of `[telemetry]` that change: what was added before, and what is found."""
    pairs = zip(
        ("heading_offset_deg", "pitch_offset_deg", "height_offset_m"), found.offsets, strict=True
    )
    return {
        key: round(_turned(getattr(fill, key) + o.value, key), DIGITS)
        for key, o in pairs
        if o.is_determined
    }


def improved_text(text: str, keys: Mapping[str, float]) -> str:
    """Return a site file's text with such keys."""
    return with_table(text, "telemetry", keys)


def check_speeds(run_dir: Path, driven: Sequence[DrivenSpeed]) -> list[SpeedCheck]:
    """Compare vehicles of a run with their true speeds; raises InputError."""
    tables = read_tracks(run_dir, thin_s=0.0)
    if not tables:
        raise InputError(f"{run_dir} has no tracks.csv, which queuetail run writes")
    ids = np.concatenate([t.track_id for t in tables])
    t_s = np.concatenate([t.t_s for t in tables])
    speeds = np.concatenate([t.speed_mps for t in tables])
    found = []
    for one in driven:
        mine = ids == one.track_id
        if not mine.any():
            raise InputError(
                f"{run_dir} has no vehicle {one.track_id}; annotated.mp4 and tracks.csv show "
                "the numbers"
            )
        try:
            found.append(
                check_speed(one.track_id, t_s[mine], speeds[mine], one.speed_mps, one.span_s)
            )
        except ValueError as error:
            raise InputError(f"{run_dir}: {error}") from None
    return found


def parse_driven(text: str) -> DrivenSpeed:
    """Parse TRACK_ID=MPH or TRACK_ID=MPH@FROM-TO; raises ValueError."""
    name, _, rest = text.partition("=")
    speed, _, span = rest.partition("@")
    first, _, last = span.partition("-")
    mph = float(speed)
    span_s = (float(first), float(last)) if span else None
    if not 0 < mph < 200 or (span_s is not None and not span_s[0] < span_s[1]):
        raise ValueError(text)
    return DrivenSpeed(int(name), mph * MPS_PER_MPH, span_s)


def _turned(value: float, key: str) -> float:
    """Return a heading's offset within half a turn."""
    return (value + 180.0) % 360.0 - 180.0 if key == "heading_offset_deg" else value
