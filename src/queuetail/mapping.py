"""From telemetry or control points to the ground mapping of each frame; from a site to its road."""

from __future__ import annotations

import dataclasses

import numpy as np

from queuetail.config import CameraOverride, Site, TelemetryFill
from queuetail.errors import InputError
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import (
    apply_homography,
    mapping_from_control_points,
    mapping_from_pose,
    px_to_enu,
)
from queuetail.types import (
    Approach,
    CameraPose,
    Floats,
    GroundMapping,
    Intrinsics,
    Origin,
    PoseSigma,
    Registration,
    TelemetrySample,
    Unknown,
)

MISFIT_RANGE = (0.1, 2.0)
PLAIN_HFOV_DEG = 60.0
SETTLE_S = 3.0  # over which the place of the reference picture is averaged
# What a pose needs, in the words of the telemetry columns and of the site file's [telemetry] table.
POSE_FIELDS = ("lat_deg", "lon_deg", "height_agl_m", "heading_deg", "gimbal_pitch_deg", "hfov_deg")


class TelemetryMapper:
    """The pose that telemetry reports, taken at its word."""

    def __init__(
        self, width_px: int, height_px: int, camera: CameraOverride, origin: Origin
    ) -> None:
        self._size = (width_px, height_px)
        self._camera = camera
        self._origin = origin
        self._last: tuple[TelemetrySample, GroundMapping | Unknown] | None = None

    def mapping(
        self, telemetry: TelemetrySample, registration: Registration
    ) -> GroundMapping | Unknown:
        """Return the exact pinhole mapping, or what is missing for it."""
        if self._last is None or self._last[0] is not telemetry:
            pose = self.pose(telemetry)
            known = pose if isinstance(pose, Unknown) else mapping_from_pose(pose, self._origin)
            self._last = (telemetry, known)
        return self._last[1]

    def pose(self, telemetry: TelemetrySample) -> CameraPose | Unknown:
        """Return the pose alone, or what is missing for it."""
        return camera_pose(telemetry, *self._size, self._camera)


class FixedMapper:
    """The mapping of a reference picture by control points, carried on by registration."""

    def __init__(self, mapping: GroundMapping) -> None:
        self._mapping = mapping

    def mapping(
        self, telemetry: TelemetrySample, registration: Registration
    ) -> GroundMapping | Unknown:
        """Return the mapping; telemetry has nothing to add."""
        if registration.reason:
            return Unknown((registration.reason,))
        if registration.epoch:
            return Unknown(("the scene changed, and the control points belong to the first one",))
        return moved(self._mapping, registration.H_ref_frame)


class RegisteredMapper:
    """Telemetry says where the reference picture is, registration what moved since.

    So a walking GPS does not move the road.  The reference is averaged over the first seconds.
    """

    def __init__(self, telemetry_mapper: TelemetryMapper, width_px: int, height_px: int) -> None:
        self._telemetry = telemetry_mapper
        # Points low in the picture, where every camera that sees a road sees ground.
        across, down = np.array([0.1, 0.9, 0.9, 0.1]), np.array([0.55, 0.55, 0.95, 0.95])
        self._points_px = np.column_stack([across * width_px, down * height_px])
        self._epoch = -1
        self._since_s = 0.0
        self._count = 0
        self._places = np.zeros((4, 2))
        self._reference: GroundMapping | None = None
        self.H_true_enu = np.eye(3)
        self._misfit = 1.0

    def correct(self, H_true_enu: Floats | None, misfit: float) -> None:
        """Take telemetry's ENU to be moved by a homography (3, 3), None for as before.

        Its sigmas are scaled by `misfit`: how far telemetry was off where that could be seen says
        how far it may be where it cannot.
        """
        if H_true_enu is not None:
            self.H_true_enu = H_true_enu
        self._misfit = float(np.clip(misfit, *MISFIT_RANGE))

    def mapping(
        self, telemetry: TelemetrySample, registration: Registration
    ) -> GroundMapping | Unknown:
        """Return the frame's mapping; unknown while the picture is lost, never the last one."""
        if registration.reason:
            return Unknown((registration.reason,))
        pose: CameraPose | Unknown | None = self._telemetry.pose(telemetry)
        if registration.epoch != self._epoch:
            if isinstance(pose, Unknown):
                return pose
            self._epoch, self._since_s, self._count = registration.epoch, telemetry.t_s, 0
            self._reference = None
        if telemetry.t_s - self._since_s < SETTLE_S or self._reference is None:
            told = self._telemetry.mapping(telemetry, registration)
            if not isinstance(told, Unknown):
                self._learn(told, registration)
        if self._reference is None:
            return Unknown(("telemetry does not say where the picture is",))
        if isinstance(pose, Unknown):
            pose = self._reference.pose
        reference = dataclasses.replace(
            self._reference,
            H_enu_px=self.H_true_enu @ self._reference.H_enu_px,
            H_px_enu=self._reference.H_px_enu @ np.linalg.inv(self.H_true_enu),
            pose_sigma=scaled(self._reference.pose_sigma, self._misfit),
            H_true_enu=self.H_true_enu,
        )
        frame_mapping = moved(reference, registration.H_ref_frame)
        return dataclasses.replace(frame_mapping, pose=pose)

    def _learn(self, told: GroundMapping, registration: Registration) -> None:
        """Average where the reference picture's points lie, as each telemetry sample sees them."""
        in_frame = apply_homography(
            np.asarray(np.linalg.inv(registration.H_ref_frame)), self._points_px
        )
        places = px_to_enu(told, in_frame)
        if not np.isfinite(places).all():
            return
        self._count += 1
        self._places += (places - self._places) / self._count
        fitted = mapping_from_control_points(self._points_px, self._places, told.origin)
        self._reference = dataclasses.replace(
            fitted, intrinsics=told.intrinsics, pose=told.pose, pose_sigma=told.pose_sigma
        )


def uncorrected(mapping: GroundMapping) -> GroundMapping:
    """Return a mapping as telemetry alone tells it."""
    H = mapping.H_true_enu
    return dataclasses.replace(
        mapping,
        H_enu_px=np.linalg.inv(H) @ mapping.H_enu_px,
        H_px_enu=mapping.H_px_enu @ H,
        H_true_enu=np.eye(3),
    )


def scaled(sigma: PoseSigma, factor: float) -> PoseSigma:
    """Return the pose's sigmas times `factor`; the pixel's own stays."""
    return PoseSigma(
        horizontal_m=sigma.horizontal_m * factor,
        height_m=sigma.height_m * factor,
        yaw_deg=sigma.yaw_deg * factor,
        pitch_deg=sigma.pitch_deg * factor,
        roll_deg=sigma.roll_deg * factor,
        pixel_px=sigma.pixel_px,
    )


def moved(reference: GroundMapping, H_ref_frame: Floats) -> GroundMapping:
    """Return a frame's mapping from the reference picture's."""
    return dataclasses.replace(
        reference,
        H_enu_px=reference.H_enu_px @ H_ref_frame,
        H_px_enu=np.linalg.inv(H_ref_frame) @ reference.H_px_enu,
    )


def corrected(sample: TelemetrySample, fill: TelemetryFill) -> TelemetrySample:
    """Return the sample with the site's offsets of heading, pitch and height added."""
    heading, pitch, height = sample.heading_deg, sample.gimbal_pitch_deg, sample.height_agl_m
    if not (fill.heading_offset_deg or fill.pitch_offset_deg or fill.height_offset_m):
        return sample
    return dataclasses.replace(
        sample,
        heading_deg=None if heading is None else (heading + fill.heading_offset_deg) % 360.0,
        gimbal_pitch_deg=None if pitch is None else pitch + fill.pitch_offset_deg,
        height_agl_m=None if height is None else height + fill.height_offset_m,
    )


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
    lens = _lens(site.camera, width_px, height_px)
    try:
        return mapping_from_control_points(px, enu, origin, lens)
    except ValueError as error:
        raise InputError(f"[[control_point]]: {error}") from None


def _lens(camera: CameraOverride, width_px: int, height_px: int) -> Intrinsics:
    """Return the lens of a camera known by control points.

    Without distortion only its centre matters: it tells where the camera stands above the road.
    """
    if camera.distortion and camera.hfov_deg is None:
        raise InputError(
            "[camera] distortion needs hfov_deg beside it when control points are used"
        )
    hfov_deg = camera.hfov_deg or PLAIN_HFOV_DEG
    return intrinsics_from_hfov(width_px, height_px, hfov_deg, camera.distortion)
