"""Where on earth is that pixel? For a video with telemetry, and for a still with metadata."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from queuetail.config import Site, read_site
from queuetail.errors import InputError
from queuetail.flight import open_flight
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import covariance, mapping_from_pose, px_to_enu
from queuetail.mapping import camera_pose, corrected
from queuetail.presets import telemetry_or_control_points
from queuetail.registrar import STILL
from queuetail.telemetry.stills import read_still
from queuetail.types import GroundMapping, Origin, Unknown

STILL_SUFFIXES = {".jpg", ".jpeg", ".dng", ".png", ".tif", ".tiff"}


@dataclass(frozen=True, slots=True)
class Place:
    """A located pixel; `sigma_m` is one standard deviation along its worst direction."""

    lat_deg: float | None
    lon_deg: float | None
    enu_m: tuple[float, float]
    sigma_m: float


def locate(
    source: Path,
    px: tuple[float, float],
    time_s: float = 0.0,
    telemetry: Path | None = None,
    site_file: Path | None = None,
) -> Place:
    """Return the ground place under a pixel of a video (at `time_s`) or of a still.

    Raises InputError when the pixel is outside the picture or above the horizon.
    """
    site = read_site(site_file) if site_file else Site()
    if source.suffix.lower() in STILL_SUFFIXES and telemetry is None:
        mapping, size = _still_mapping(source, site)
    else:
        mapping, size = _video_mapping(source, time_s, telemetry, site, site_file)
    if not (0 <= px[0] <= size[0] and 0 <= px[1] <= size[1]):
        raise InputError(f"pixel {px[0]:g},{px[1]:g} lies outside {source} ({size[0]}×{size[1]})")
    point = np.array([px], float)
    enu = px_to_enu(mapping, point)
    if not np.isfinite(enu).all():
        raise InputError(f"pixel {px[0]:g},{px[1]:g} of {source} looks at or above the horizon")
    sigma = float(np.sqrt(np.linalg.eigvalsh(covariance(mapping, point)[0])[-1]))
    east, north = (float(v) for v in enu[0])
    if mapping.origin is None:
        return Place(None, None, (east, north), sigma)
    lat, lon = geodetic_from_enu(enu, mapping.origin)
    return Place(float(lat[0]), float(lon[0]), (east, north), sigma)


def _still_mapping(source: Path, site: Site) -> tuple[GroundMapping, tuple[int, int]]:
    still = read_still(source)
    size = still.width_px, still.height_px
    constants = site.telemetry.constants
    lacking = {k: v for k, v in constants.items() if getattr(still.sample, k) is None}
    sample = corrected(dataclasses.replace(still.sample, **lacking), site.telemetry)
    pose = camera_pose(sample, *size, site.camera)
    if isinstance(pose, Unknown):
        raise InputError(f"{source}: {'; '.join(pose.reasons)}; give it in a site file (--site)")
    return mapping_from_pose(pose, Origin(pose.lat_deg, pose.lon_deg)), size


def _video_mapping(
    source: Path, time_s: float, telemetry: Path | None, site: Site, site_file: Path | None
) -> tuple[GroundMapping, tuple[int, int]]:
    with open_flight(source, telemetry, site) as flight:
        size = flight.video.width_px, flight.video.height_px
        end_s = flight.video.duration_s
        if not 0 <= time_s <= (math.inf if end_s is None else end_s):
            runs = "from 0 s" if end_s is None else f"0 … {end_s:.1f} s"
            raise InputError(f"{source} has no picture at {time_s:g} s (it runs {runs})")
        try:
            mapper = telemetry_or_control_points(site, flight.origin, *size)
        except InputError as error:
            raise InputError(f"{site_file}: {error}") from None
        mapping = mapper.mapping(flight.telemetry_at(time_s), STILL)
    if isinstance(mapping, Unknown):
        raise InputError(f"{source} at {time_s:g} s: {'; '.join(mapping.reasons)}")
    return mapping, size
