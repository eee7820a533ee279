"""From telemetry or control points to the ground mapping of each frame; from a site to its road."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np

from queuetail.config import CameraOverride, Site
from queuetail.errors import InputError
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import mapping_from_control_points, mapping_from_pose
from queuetail.types import (
    Approach,
    CameraPose,
    GroundMapping,
    Intrinsics,
    Origin,
    TelemetrySample,
    Unknown,
)

# What a pose needs, in the words of the telemetry columns and of the site file's [telemetry] table.
POSE_FIELDS = ("lat_deg", "lon_deg", "height_agl_m", "heading_deg", "gimbal_pitch_deg", "hfov_deg")


class Mapper(Protocol):
    """Says which ground lies under which pixel at one time."""

    def mapping(self, sample: TelemetrySample) -> GroundMapping | Unknown:
        """Return the mapping of the frame that `sample` was taken with."""


class TelemetryMapper:
    """The pose that telemetry reports, taken at its word."""

    def __init__(
        self, width_px: int, height_px: int, camera: CameraOverride, origin: Origin
    ) -> None:
        self._size = (width_px, height_px)
        self._camera = camera
        self._origin = origin

    def mapping(self, sample: TelemetrySample) -> GroundMapping | Unknown:
        """Return the exact pinhole mapping, or what is missing for it."""
        pose = camera_pose(sample, *self._size, self._camera)
        if isinstance(pose, Unknown):
            return pose
        return mapping_from_pose(pose, self._origin)


class FixedMapper:
    """One mapping for the whole video: a camera that stands still, seen by control points."""

    def __init__(self, mapping: GroundMapping) -> None:
        self._mapping = mapping

    def mapping(self, sample: TelemetrySample) -> GroundMapping:
        """Return the mapping; telemetry has nothing to add."""
        return self._mapping


def camera_pose(
    sample: TelemetrySample,
    width_px: int,
    height_px: int,
    camera: CameraOverride,
) -> CameraPose | Unknown:
    """Return the pose that `sample` reports for a picture of this size, or what it lacks.

    A missing roll is taken as 0: gimbals hold the horizon, and few logs write it.
    """
    if camera.hfov_deg is not None:
        sample = dataclasses.replace(sample, hfov_deg=camera.hfov_deg)
    missing = [name for name in POSE_FIELDS if getattr(sample, name) is None]
    if missing:
        return Unknown(tuple(f"telemetry lacks {name}" for name in missing))
    assert sample.lat_deg is not None
    assert sample.lon_deg is not None
    assert sample.height_agl_m is not None
    assert sample.heading_deg is not None
    assert sample.gimbal_pitch_deg is not None
    assert sample.hfov_deg is not None
    if sample.height_agl_m <= 0:
        return Unknown((f"the height above ground is {sample.height_agl_m:.1f} m",))
    lens = intrinsics_from_hfov(width_px, height_px, sample.hfov_deg, camera.distortion)
    return CameraPose(
        lat_deg=sample.lat_deg,
        lon_deg=sample.lon_deg,
        height_agl_m=sample.height_agl_m,
        yaw_deg=sample.heading_deg,
        pitch_deg=sample.gimbal_pitch_deg,
        roll_deg=sample.gimbal_roll_deg or 0.0,
        intrinsics=lens,
    )


def site_origin(site: Site) -> Origin | None:
    """Return the place of ENU (0, 0) that the site file implies: its own, or its first place."""
    places = [p.at for p in site.control_point if p.at is not None]
    axes = [a.axis[0] for a in site.approach if a.axis is not None]
    chosen = site.site.origin or (places[0] if places else axes[0] if axes else None)
    return Origin(*chosen) if chosen else None


def site_approaches(site: Site, origin: Origin | None) -> tuple[Approach, ...]:
    """Return the site's approaches in ENU; degrees imply one."""
    found = []
    for entry in site.approach:
        if entry.axis is not None and origin is not None:
            points = np.array(entry.axis)
            axis = enu_from_geodetic(points[:, 0], points[:, 1], origin)
        else:
            axis = np.array(entry.axis_enu_m, float)
        found.append(
            Approach(entry.name, axis, entry.start_station_m, entry.lanes, entry.lane_width_m)
        )
    return tuple(found)


def control_point_mapping(
    site: Site, origin: Origin | None, width_px: int, height_px: int
) -> GroundMapping:
    """Fit the mapping to the site's control points; raises InputError when they do not give one."""
    points = site.control_point
    enu = np.empty((len(points), 2))
    for row, point in enumerate(points):
        if point.at is not None and origin is not None:
            lat, lon = point.at
            enu[row] = enu_from_geodetic(np.array(lat), np.array(lon), origin)
        else:
            enu[row] = point.enu_m
    px = np.array([p.px for p in points], float)
    lens = _distorting_lens(site.camera, width_px, height_px)
    try:
        return mapping_from_control_points(px, enu, origin, lens)
    except ValueError as error:
        raise InputError(f"[[control_point]]: {error}") from None


def _distorting_lens(camera: CameraOverride, width_px: int, height_px: int) -> Intrinsics | None:
    if not camera.distortion:
        return None
    if camera.hfov_deg is None:
        raise InputError(
            "[camera] distortion needs hfov_deg beside it when control points are used"
        )
    return intrinsics_from_hfov(width_px, height_px, camera.hfov_deg, camera.distortion)
