"""JSON telemetry: our names, DJI's osd and osd_info_push, and texts that are neither."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.link.json_fields import JsonReading, read_json
from queuetail.link.messages import (
    Altitude,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lens,
    Lidar,
    Position,
)

OSD = {
    "tid": "t",
    "bid": "b",
    "timestamp": 1_780_000_000_500,
    "gateway": "5YSZKAB0020ABC",
    "data": {
        "61-0-0": {
            "gimbal_pitch": -55.0,
            "gimbal_roll": 0,
            "gimbal_yaw": -30.5,
            "payload_index": "61-0-0",
        },
        "latitude": 36.1101897,
        "longitude": -97.0575359,
        "height": 372.1,
        "elevation": 110.2,
        "attitude_head": -30,
        "mode_code": 3,
    },
}


def test_djis_osd() -> None:
    assert read_json(json.dumps(OSD)) == JsonReading(
        (
            Position(36.1101897, -97.0575359),
            Heading(330.0),
            Altitude(110.2),
            Gimbal(329.5, -55.0, 0.0),
        ),
        1_780_000_000.5,
        1_780_000_000.5,
        "5YSZKAB0020ABC",
    )


def test_djis_quick_osd() -> None:
    data = {"attitude_head": 60, "latitude": 36.0, "longitude": -97.0, "height": 10.1}
    data |= {"gimbal_pitch": -60, "gimbal_roll": 0, "gimbal_yaw": 61}
    quick = {"method": "osd_info_push", "timestamp": 1000, "data": data}
    reading = read_json(json.dumps(quick))
    assert reading is not None
    assert Gimbal(61.0, -60.0, 0.0) in reading.quantities
    assert reading.sent_s == 1.0


def test_our_own_names() -> None:
    ours = {
        "utc": "2026-06-01T14:00:00.5Z",
        "lat": 36.0,
        "lon": "-97.0",
        "height_agl_m": 110,
        "heading_deg": 75.0,
        "gimbal_pitch_deg": -55,
        "drone_heading_deg": 80,
        "lidar_m": None,
        "hfov_deg": 84,
    }
    reading = read_json(json.dumps(ours))
    assert reading is not None
    assert set(reading.quantities) == {
        Position(36.0, -97.0),
        Gimbal(75.0, -55.0, None),
        Heading(80.0),
        Height(110.0, HeightSource.LIDAR),
        Lidar(None),
        Lens(84.0),
    }
    assert reading.utc_s == reading.sent_s == 1_780_322_400.5


@pytest.mark.parametrize("text", ["", "[]", "7", "{", b"\xff\xfe", "[" * 5000, "null"])
def test_what_is_no_object_is_none(text: str | bytes) -> None:
    assert read_json(text) is None


def test_values_that_are_no_numbers_are_left_out() -> None:
    text = '{"lat": NaN, "lon": 1, "heading_deg": true, "hfov_deg": "wide", "utc": "soon"}'
    assert read_json(text) == JsonReading(())
    assert read_json('{"latitude": 0, "longitude": 0}') == JsonReading(())


@given(
    st.dictionaries(
        st.sampled_from(["lat", "lon", "data", "utc", "t_s", "latitude", "61-0-0", "gimbal_yaw"]),
        st.recursive(
            st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
            lambda inner: (
                st.lists(inner, max_size=3)
                | st.dictionaries(st.sampled_from(["gimbal_yaw", "latitude"]), inner, max_size=3)
            ),
        ),
    )
)
def test_no_object_raises(value: dict[str, object]) -> None:
    assert read_json(json.dumps(value)) is not None
