"""MAVLink messages as quantities: frames of yaw, angles straight down, values that are none."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.link.mavlink import MavlinkReader, euler_deg
from queuetail.link.messages import Gimbal, Heading, Lens, Lidar, Position, Quantity


def message(kind: str, **fields: Any) -> SimpleNamespace:
    return SimpleNamespace(get_type=lambda: kind, **fields)


def quaternion(yaw_deg: float, pitch_deg: float, roll_deg: float) -> list[float]:
    y, p, r = (math.radians(deg) / 2 for deg in (yaw_deg, pitch_deg, roll_deg))
    cy, sy, cp, sp = math.cos(y), math.sin(y), math.cos(p), math.sin(p)
    cr, sr = math.cos(r), math.sin(r)
    return [
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    ]


@given(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_come_back_from_a_quaternion(yaw: float, pitch: float, roll: float) -> None:
    assert euler_deg(quaternion(yaw, pitch, roll)) == pytest.approx((yaw, pitch, roll), abs=1e-6)


def test_straight_down_the_yaw_is_that_of_the_pictures_top() -> None:
    angles = euler_deg(quaternion(40, -90, 0))
    assert angles == pytest.approx((40, -90, 0), abs=1e-3)


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [math.nan, 0, 0, 1], [3, 0, 0, 0]])
def test_no_rotation_gives_no_angles(q: list[float]) -> None:
    assert euler_deg(q) is None


@pytest.mark.parametrize(
    ("flags", "yaw"), [(32, 40.0), (64, 330.0), (16, 330.0), (0, 40.0), (32 | 16, 40.0)]
)
def test_the_flags_say_where_the_gimbals_yaw_counts_from(flags: int, yaw: float) -> None:
    reader = MavlinkReader()
    reader.quantities(message("ATTITUDE", roll=0.0, pitch=0.0, yaw=math.radians(70)), 1.0)
    status = message("GIMBAL_DEVICE_ATTITUDE_STATUS", flags=flags, q=quaternion(-30, -60, 1))
    (gimbal,) = reader.quantities(status, 1.5)
    assert isinstance(gimbal, Gimbal)
    assert (gimbal.yaw_deg, gimbal.pitch_deg) == (pytest.approx(yaw), pytest.approx(-60))
    (late,) = reader.quantities(status, 9.0)  # the nose's heading is old by now
    assert (late.yaw_deg is None) == (yaw == 40.0)


def test_the_older_mount_message_counts_until_the_gimbals_own_comes() -> None:
    reader = MavlinkReader()
    mount = message("MOUNT_ORIENTATION", roll=0.5, pitch=-45.0, yaw=10.0, yaw_absolute=math.nan)
    assert reader.quantities(mount, 0.0) == [Gimbal(None, -45.0, 0.5)]
    reader.quantities(message("ATTITUDE", roll=0.0, pitch=0.0, yaw=math.radians(355)), 0.1)
    assert reader.quantities(mount, 0.2) == [Gimbal(pytest.approx(5.0), -45.0, 0.5)]
    mount.yaw_absolute = -20.0
    assert reader.quantities(mount, 0.3) == [Gimbal(340.0, -45.0, 0.5)]
    status = message("GIMBAL_DEVICE_ATTITUDE_STATUS", flags=64, q=quaternion(0, 0, 0))
    reader.quantities(status, 0.4)
    assert reader.quantities(mount, 0.5) == []


def position(**changed: Any) -> SimpleNamespace:
    fields = {"lat": 361101897, "lon": -970575359, "alt": 0, "relative_alt": 0, "hdg": 7500}
    return message("GLOBAL_POSITION_INT", **(fields | changed))


def test_no_fix_and_no_heading_are_not_told() -> None:
    kinds = [type(q) for q in MavlinkReader().quantities(position(lat=0, lon=0, hdg=65535), 0.0)]
    assert Position not in kinds
    assert Heading not in kinds
    assert Heading(75.0) in MavlinkReader().quantities(position(), 0.0)


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({}, [Lidar(61.42)]),
        ({"current_distance": 10_000}, [Lidar(None)]),
        ({"current_distance": 5}, [Lidar(None)]),
        ({"signal_quality": 1}, [Lidar(None)]),
        ({"orientation": 0}, []),
    ],
)
def test_a_rangefinder_counts_where_it_looks_down_and_sees(
    fields: dict[str, int], expected: list[Quantity]
) -> None:
    usual = {"min_distance": 20, "max_distance": 10_000, "current_distance": 6_142}
    told = message("DISTANCE_SENSOR", **(usual | {"orientation": 25, "signal_quality": 0} | fields))
    assert MavlinkReader().quantities(told, 0.0) == expected


def test_the_lens_from_its_field_of_view_or_from_its_focal_length() -> None:
    reader = MavlinkReader()
    assert reader.quantities(message("CAMERA_FOV_STATUS", hfov=math.nan), 0.0) == []
    camera = message("CAMERA_INFORMATION", focal_length=18.0, sensor_size_h=36.0)
    assert reader.quantities(camera, 0.0) == [Lens(pytest.approx(90.0))]
    assert reader.quantities(message("CAMERA_FOV_STATUS", hfov=84.0), 1.0) == [Lens(84.0)]
    assert reader.quantities(camera, 2.0) == []
    assert reader.quantities(message("SYSTEM_TIME", time_unix_usec=0), 0.0) == []
    assert reader.quantities(message("PARAM_VALUE"), 0.0) == []
