"""MISB ST 0601: rotation chain, heights, checksums, raw packets and packets inside a video."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from stanag4609.klv.checksum import running_sum_16
from stanag4609.st0601 import ST0601_KEY, encode_uas_local_set

from queuetail.errors import InputError
from queuetail.geo.camera import rotation_enu_camera
from queuetail.telemetry import read_telemetry
from queuetail.telemetry.klv_pose import angles_of, height_agl_m, rotation_ned, sensor_angles_deg
from queuetail.telemetry.read import VideoClock

START = datetime(2026, 6, 1, 14, 0, tzinfo=UTC)
HOVER = {
    13: 36.11,
    14: -97.05,
    15: 400.0,
    16: 84.0,
    25: 290.0,
    5: 80.0,
    6: 0.0,
    7: 0.0,
    18: 355.0,
    19: -55.0,
    20: 0.0,
    65: 19,
}
NED_FROM_ENU = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])


def packet(t_s: float, **changed: Any) -> bytes:
    values: dict[int, Any] = {2: START + timedelta(seconds=t_s), **HOVER}
    values |= {int(tag.removeprefix("tag")): value for tag, value in changed.items()}
    return encode_uas_local_set({tag: v for tag, v in values.items() if v is not None})


def test_the_chain_is_composed_and_not_added() -> None:
    # A platform rolled 30° to the right with a sensor looking straight down sees to the left.
    yaw, pitch, _, _ = sensor_angles_deg({5: 0.0, 6: 0.0, 7: 30.0, 18: 0.0, 19: -90.0, 20: 0.0})
    assert (yaw, pitch) == (pytest.approx(270), pytest.approx(-60))
    # Sensor to the right of a platform that heads south looks west, whatever the pitch.
    yaw, pitch, _, _ = sensor_angles_deg({5: 180.0, 90: 10.0, 91: 0.0, 18: 90.0, 19: 0.0, 20: 0.0})
    assert (yaw, pitch) == (pytest.approx(270), pytest.approx(0, abs=1e-9))


@settings(deadline=None)
@given(st.floats(0, 359.9), st.floats(-89, 89), st.floats(-179, 179))
def test_angles_come_back_from_the_rotation(yaw: float, pitch: float, roll: float) -> None:
    found = angles_of(rotation_ned(yaw, pitch, roll))
    assert np.allclose(rotation_ned(*found), rotation_ned(yaw, pitch, roll), atol=1e-9)
    assert found[1] == pytest.approx(pitch, abs=1e-6)


@settings(deadline=None)
@given(st.floats(0, 359.9), st.floats(-89.9, 89), st.floats(-179, 179))
def test_the_convention_is_that_of_the_camera_model(yaw: float, pitch: float, roll: float) -> None:
    forward_right_down = rotation_ned(yaw, pitch, roll)
    right_down_forward = forward_right_down[:, [1, 2, 0]]
    ours = rotation_enu_camera(yaw, pitch, roll)
    assert np.allclose(ours, NED_FROM_ENU.T @ right_down_forward, atol=1e-9)


def test_straight_down_keeps_the_heading() -> None:
    yaw, pitch, roll, _ = sensor_angles_deg({5: 75.0, 6: 0.0, 7: 0.0, 18: 0.0, 19: -90.0, 20: 0.0})
    assert (yaw, pitch, roll) == (pytest.approx(75), pytest.approx(-90), 0)


def test_without_angles_the_frame_centre_gives_them() -> None:
    north = {13: 36.0, 14: -97.0, 15: 400.0, 23: 36.001, 24: -97.0, 25: 289.0}
    yaw, pitch, roll, notes = sensor_angles_deg(north)
    assert yaw == pytest.approx(0, abs=1e-6)
    assert pitch == pytest.approx(-45, abs=0.1)  # 0.001° of latitude are 111 m
    assert roll is None
    assert "frame centre" in notes[0]
    assert sensor_angles_deg({13: 36.0}) == (None, None, None, ())


@pytest.mark.parametrize(
    ("values", "height", "note"),
    [
        ({15: 400.0, 25: 290.0, 75: 370.0, 78: 259.0}, 110, "sea level"),
        ({75: 370.0, 78: 259.0}, 111, "ellipsoid"),
        ({75: 370.0, 25: 290.0, 21: 220.0}, 110, "slant range"),  # datums are never mixed
        ({15: 400.0}, None, "not the ground's"),
        ({}, None, ""),
    ],
)
def test_heights(values: dict[int, float], height: float | None, note: str) -> None:
    found, notes = height_agl_m(values, -30.0)
    assert found == (None if height is None else pytest.approx(height))
    assert note in " ".join(notes)


def test_raw_packets(tmp_path: Path) -> None:
    path = tmp_path / "flight.klv"
    path.write_bytes(b"".join(packet(i / 2, tag18=(350 + 10 * i) % 360) for i in range(4)))
    flight = read_telemetry(path)
    sample = flight.at(0.75)
    assert flight.span_s == (0, 1.5)
    assert sample.lat_deg == pytest.approx(36.11, abs=1e-7)
    assert sample.lon_deg == pytest.approx(-97.05, abs=1e-7)
    assert sample.height_agl_m == pytest.approx(110, abs=0.4)
    assert sample.heading_deg == pytest.approx(80 + 5, abs=0.01)
    assert sample.gimbal_pitch_deg == pytest.approx(-55, abs=0.01)
    assert sample.hfov_deg == pytest.approx(84, abs=0.01)
    late = read_telemetry(path, VideoClock(start_utc=START + timedelta(seconds=1)))
    assert late.span_s == (-1, 0.5)


def test_bad_packets_are_dropped_and_counted(tmp_path: Path) -> None:
    good, bad = packet(0), bytearray(packet(1))
    bad[40] ^= 0xFF
    path = tmp_path / "flight.bin"
    path.write_bytes(good + bytes(bad) + b"noise" + packet(2) + packet(3)[:-9])
    flight = read_telemetry(path)
    assert [s.t_s for s in flight.samples] == [0, 2]
    assert "1 of 4 KLV packets dropped: wrong checksum" in flight.notes
    assert "1 of 4 KLV packets dropped: malformed" in flight.notes
    path.write_bytes(bytes(bad))
    with pytest.raises(InputError, match="wrong checksum"):
        read_telemetry(path)
    path.write_bytes(good[:60])
    with pytest.raises(InputError, match="malformed"):
        read_telemetry(path)


def test_a_wrong_length_does_not_swallow_the_packets_after_it(tmp_path: Path) -> None:
    long = bytearray(packet(0))
    long[17] += 90  # of the BER length 0x81 nn
    path = tmp_path / "flight.bin"
    path.write_bytes(bytes(long) + packet(1) + packet(2))
    assert [s.t_s for s in read_telemetry(path).samples] == [0, 1]


def test_a_time_stamp_beyond_all_calendars_is_malformed(tmp_path: Path) -> None:
    body = b"\x02\x08" + b"\xff" * 8 + b"\x01\x02"
    head = ST0601_KEY + bytes([len(body) + 2]) + body
    path = tmp_path / "flight.bin"
    path.write_bytes(head + running_sum_16(head).to_bytes(2, "big"))
    with pytest.raises(InputError, match="KLV packets"):
        read_telemetry(path)


def test_missing_and_unmeasured_items_are_none(tmp_path: Path) -> None:
    path = tmp_path / "flight.bin"
    path.write_bytes(packet(0, tag25=None, tag16=None) + packet(1, tag7=80.0))  # roll beyond ±50°
    flight = read_telemetry(path)
    assert flight.samples[0].height_agl_m is None
    assert flight.samples[0].hfov_deg is None
    assert any("pitch or roll is missing" in note for note in flight.notes)


def write_transport_stream(path: Path, klv: list[tuple[float, bytes]]) -> None:
    """A second of grey pictures from 1.4 s on, as MPEG-TS starts, with KLV beside them."""
    with av.open(str(path), "w", format="mpegts") as container:
        video = container.add_stream("mpeg2video", rate=25)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        data = container.add_data_stream("klv")
        grey = av.VideoFrame.from_ndarray(np.full((48, 64, 3), 128, np.uint8), format="rgb24")
        for i in range(25):
            grey.pts, grey.time_base = i, Fraction(1, 25)
            container.mux(video.encode(grey))
        container.mux(video.encode(None))
        for t_s, body in klv:
            raw = av.Packet(body)
            raw.stream, raw.time_base = data, Fraction(1, 90_000)
            raw.pts = raw.dts = round(t_s * 90_000)
            container.mux(raw)


def test_packets_inside_a_video(tmp_path: Path) -> None:
    path = tmp_path / "flight.ts"
    # The packets' own clock is a day off: inside a video the PTS counts.
    write_transport_stream(path, [(t / 5, packet(86_400 + t)) for t in range(5)])
    flight = read_telemetry(path)
    assert len(flight.samples) == 5
    assert flight.span_s == (pytest.approx(0, abs=0.05), pytest.approx(0.8, abs=0.05))
    assert flight.at(0.5).gimbal_pitch_deg == pytest.approx(-55, abs=0.01)


def test_a_cut_video_gives_what_was_readable(tmp_path: Path) -> None:
    path = tmp_path / "flight.ts"
    write_transport_stream(path, [(t / 5, packet(t)) for t in range(5)])
    path.write_bytes(path.read_bytes()[:-700])
    assert 1 <= len(read_telemetry(path).samples) <= 5


def test_a_video_without_telemetry(flagger: Path) -> None:
    with pytest.raises(InputError, match="no telemetry stream"):
        read_telemetry(flagger / "flight.mp4")


def test_a_real_stream(shared: Path) -> None:
    flight = read_telemetry(shared / "telemetry" / "h264_klv.ts")
    sample = flight.at(0)
    assert len(flight.samples) == 30
    assert flight.span_s == (0, pytest.approx(0.967, abs=0.001))
    assert (sample.lat_deg, sample.lon_deg) == (
        pytest.approx(60.176822967),
        pytest.approx(128.426759042),
    )
    assert sample.hfov_deg == pytest.approx(144.5713, abs=1e-4)
    assert "30 of 30 samples: height dropped (outside -500 … 10000 m)" in flight.notes  # 10975 m


def test_the_old_kind_of_stream_is_refused(shared: Path) -> None:
    with pytest.raises(InputError, match="EG 0104"):
        read_telemetry(shared / "telemetry" / "aphill_short.ts")


def test_real_single_packets(shared: Path) -> None:
    flight = read_telemetry(shared / "telemetry" / "klv_DynamicOnlyMISMMSPacketData.bin")
    assert flight.samples[0].lat_deg == pytest.approx(60.176822967)
    with pytest.raises(InputError, match="wrong checksum"):
        read_telemetry(shared / "telemetry" / "klv_DynamicConstantMISMMSPacketData.bin")
