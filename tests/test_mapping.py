"""From telemetry, control points and site files to the ground mapping and the road."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from queuetail.config import CameraOverride, Site, parse_settings
from queuetail.errors import InputError
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.mapping import (
    POSE_FIELDS,
    FixedMapper,
    TelemetryMapper,
    camera_pose,
    control_point_mapping,
    site_approaches,
    site_origin,
)
from queuetail.registrar import STILL
from queuetail.types import CameraPose, GroundMapping, Origin, TelemetrySample, Unknown

ORIGIN = Origin(36.11, -97.057)
SAMPLE = TelemetrySample(3.0, 36.11, -97.057, 100.0, 30.0, -60.0, 2.0, 84.0)
CORNERS = [(100.0, 100.0), (1200.0, 120.0), (1180.0, 700.0), (90.0, 690.0), (640.0, 360.0)]


def site(**tables: object) -> Site:
    return parse_settings(Site, tables, "site.toml")


def test_a_full_sample_is_a_pose() -> None:
    pose = camera_pose(SAMPLE, 1280, 720, CameraOverride())
    assert isinstance(pose, CameraPose)
    assert (pose.height_agl_m, pose.yaw_deg, pose.pitch_deg, pose.roll_deg) == (100, 30, -60, 2)
    assert pose.intrinsics.fx_px == pytest.approx(640 / np.tan(np.radians(42)))


@pytest.mark.parametrize("name", POSE_FIELDS)
def test_what_is_missing_is_named(name: str) -> None:
    sample = dataclasses.replace(SAMPLE, **{name: None})
    answer = TelemetryMapper(1280, 720, CameraOverride(), ORIGIN).mapping(sample, STILL)
    assert answer == Unknown((f"telemetry lacks {name}",))


def test_all_that_is_missing_is_named() -> None:
    answer = camera_pose(TelemetrySample(0.0), 1280, 720, CameraOverride())
    assert isinstance(answer, Unknown)
    assert len(answer.reasons) == len(POSE_FIELDS)


def test_a_missing_roll_is_level() -> None:
    pose = camera_pose(
        dataclasses.replace(SAMPLE, gimbal_roll_deg=None), 1280, 720, CameraOverride()
    )
    assert isinstance(pose, CameraPose)
    assert pose.roll_deg == 0.0


@pytest.mark.parametrize("height_m", [0.0, -3.0])
def test_a_drone_on_the_ground_sees_no_ground(height_m: float) -> None:
    sample = dataclasses.replace(SAMPLE, height_agl_m=height_m)
    answer = camera_pose(sample, 1280, 720, CameraOverride())
    assert isinstance(answer, Unknown)
    assert "height above ground" in answer.reasons[0]


def test_the_site_knows_the_lens_better() -> None:
    camera = CameraOverride(hfov_deg=60.0, distortion=(0.01,))
    for sample in (SAMPLE, dataclasses.replace(SAMPLE, hfov_deg=None)):
        pose = camera_pose(sample, 1280, 720, camera)
        assert isinstance(pose, CameraPose)
        assert pose.intrinsics.fx_px == pytest.approx(640 / np.tan(np.radians(30)))
        assert pose.intrinsics.distortion == (0.01,)


def _true_mapping() -> GroundMapping:
    pose = camera_pose(SAMPLE, 1280, 720, CameraOverride())
    assert isinstance(pose, CameraPose)
    return mapping_from_pose(pose, ORIGIN)


def _points(kind: str) -> list[dict[str, object]]:
    enu = px_to_enu(_true_mapping(), np.array(CORNERS))
    if kind == "enu_m":
        return [{"px": list(p), "enu_m": list(e)} for p, e in zip(CORNERS, enu, strict=True)]
    lat, lon = geodetic_from_enu(enu, ORIGIN)
    return [{"px": list(p), "at": [a, o]} for p, a, o in zip(CORNERS, lat, lon, strict=True)]


@pytest.mark.parametrize("kind", ["at", "enu_m"])
def test_control_points_stand_in_for_telemetry(kind: str) -> None:
    settings = site(control_point=_points(kind))
    origin = site_origin(settings)
    assert (origin is None) == (kind == "enu_m")
    mapping = control_point_mapping(settings, origin, 1280, 720)
    px = np.array([[300.0, 300.0], [900.0, 650.0]])
    got, true = px_to_enu(mapping, px), px_to_enu(_true_mapping(), px)
    if origin is None:
        np.testing.assert_allclose(got, true, atol=1e-6)
    else:
        for a, b in zip(
            geodetic_from_enu(got, origin), geodetic_from_enu(true, ORIGIN), strict=True
        ):
            np.testing.assert_allclose(a, b, atol=1e-9)
    carried = FixedMapper(mapping).mapping(TelemetrySample(0.0), STILL)
    assert isinstance(carried, GroundMapping)
    assert np.allclose(carried.H_enu_px, mapping.H_enu_px)


def test_control_points_on_a_line_are_refused() -> None:
    points = [{"px": [k, k], "enu_m": [k, 0]} for k in range(5)]
    with pytest.raises(InputError, match=r"\[\[control_point\]\]: .* on a line"):
        control_point_mapping(site(control_point=points), None, 1280, 720)


def test_distortion_beside_control_points_needs_the_lens() -> None:
    settings = site(control_point=_points("enu_m"), camera={"distortion": [0.1]})
    with pytest.raises(InputError, match="hfov_deg"):
        control_point_mapping(settings, None, 1280, 720)
    both = site(control_point=_points("enu_m"), camera={"distortion": [0.0], "hfov_deg": 84.0})
    assert control_point_mapping(both, None, 1280, 720).sigma_m < 1e-6


def test_the_origin_is_the_sites_own_or_its_first_place() -> None:
    axis = [[36.2, -97.1], [36.3, -97.1]]
    road = {"name": "NB", "axis": axis}
    assert site_origin(Site()) is None
    assert site_origin(site(approach=[road])) == Origin(36.2, -97.1)
    own = site(site={"origin": [36.0, -97.0]}, approach=[road])
    assert site_origin(own) == Origin(36.0, -97.0)


def test_approaches_come_out_in_metres() -> None:
    road = {"name": "NB", "axis": [[36.11, -97.057], [36.12, -97.057]], "lanes": 2}
    (approach,) = site_approaches(site(approach=[road]), ORIGIN)
    np.testing.assert_allclose(approach.axis_enu[0], [0, 0], atol=1e-9)
    assert approach.axis_enu[1, 1] == pytest.approx(1109.6, abs=0.5)  # a hundredth of a degree
    local = {"name": "NB", "axis_enu_m": [[0, 0], [0, 100]], "start_station_m": 50}
    (approach,) = site_approaches(site(site={"origin": [36.11, -97.057]}, approach=[local]), ORIGIN)
    np.testing.assert_allclose(approach.axis_enu, [[0, 0], [0, 100]])
    assert approach.start_station_m == 50


def test_local_metres_at_an_unknown_place_are_refused() -> None:
    """With telemetry they would be put where the drone happened to start."""
    local = {"name": "NB", "axis_enu_m": [[0, 0], [0, 100]]}
    with pytest.raises(InputError, match="origin = "):
        site(approach=[local])
    assert site(approach=[local], control_point=_points("enu_m")).approach
