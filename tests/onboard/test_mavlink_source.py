"""MAVLink over UDP from a small vehicle: what is heard, what is asked for, and its loss."""

from __future__ import annotations

import socket
import time

import pytest

from link_doubles import Heard, Vehicle, free_port, running, wait_for
from queuetail.errors import InputError
from queuetail.link.messages import (
    Altitude,
    Attitude,
    ClockTime,
    Gimbal,
    Heading,
    Lens,
    Lidar,
    Position,
)
from queuetail.onboard import mavlink, sources


def test_a_vehicle_over_udp_is_heard() -> None:
    port = free_port()
    heard, vehicle = Heard(), Vehicle(port)
    source = sources.flight_controller(f"udpin:127.0.0.1:{port}")
    source.start(heard)
    with running(vehicle.run):
        wait_for(lambda: len(heard.of(Gimbal)) > 20 and vehicle.beats, "the vehicle")
        source.stop()
    assert heard.of(Position)[-1] == Position(36.1101897, -97.0575359)
    assert heard.of(Altitude)[-1] == Altitude(110.25, 402.5)
    assert heard.of(Heading)[-1].deg == pytest.approx(75, abs=1e-4)
    assert heard.of(Attitude)[-1].roll_deg == pytest.approx(2, abs=1e-4)
    assert heard.of(Lidar)[-1] == Lidar(95.0)
    assert heard.of(Lens)[-1] == Lens(84.0)
    gimbal = heard.of(Gimbal)[-1]
    assert (gimbal.yaw_deg, gimbal.pitch_deg) == (pytest.approx(75), pytest.approx(-55))
    told, stamp = next(pair for pair in reversed(heard.pairs) if isinstance(pair[0], ClockTime))
    assert told.utc_s == pytest.approx(time.time(), abs=10)
    assert stamp.utc_s == pytest.approx(told.utc_s, abs=0.5)
    assert all(stamp.measured_s <= stamp.arrived_s for _, stamp in heard.pairs)


def test_what_is_missing_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mavlink, "MISSING_S", 0.1)
    monkeypatch.setattr(mavlink, "BEAT_S", 0.1)
    port = free_port()
    heard, vehicle = Heard(), Vehicle(port)
    vehicle.is_mute = True
    source = sources.flight_controller(f"udp:127.0.0.1:{port}")
    source.start(heard)
    d = vehicle.dialect
    with running(vehicle.run):

        def beat() -> bool:
            vehicle.mav.heartbeat_send(d.MAV_TYPE_QUADROTOR, 3, 0, 0, 0)
            return len(vehicle.requests) >= 6

        wait_for(beat, "requests for messages")
        source.stop()
    assert d.MAVLINK_MSG_ID_GLOBAL_POSITION_INT in vehicle.requests
    assert d.MAVLINK_MSG_ID_DISTANCE_SENSOR in vehicle.requests


def test_only_one_vehicle_counts_and_noise_is_skipped() -> None:
    port = free_port()
    heard = Heard()
    source = sources.flight_controller(f"udpin:127.0.0.1:{port}")
    source.start(heard)
    first, second = Vehicle(port, 1), Vehicle(port, 2)
    second.yaw_deg = 200.0
    with running(first.run):
        wait_for(lambda: heard.of(Heading), "the first vehicle")
        with (
            running(second.run),
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise,
        ):
            noise.sendto(b"\xfd\x09garbage" * 9, ("127.0.0.1", port))
            before = len(heard.pairs)
            wait_for(lambda: len(heard.pairs) > before + 100, "more of the first vehicle")
        source.stop()
    assert {round(heading.deg) for heading in heard.of(Heading)} == {75}


def test_a_vehicle_that_dies_and_returns_is_heard_again(monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    heard, vehicle = Heard(), Vehicle(port)
    source = sources.flight_controller(f"udpin:127.0.0.1:{port}")
    source.start(heard)
    with running(vehicle.run):
        wait_for(lambda: heard.pairs, "the vehicle")
    count = len(heard.pairs)
    again = Vehicle(port)
    again.started_s = time.monotonic()  # its clock starts from 0 after the reboot
    with running(again.run):
        wait_for(lambda: len(heard.pairs) > count + 50, "the vehicle after its reboot")
        source.stop()
    _, stamp = heard.pairs[-1]
    assert stamp.measured_s == pytest.approx(stamp.arrived_s, abs=1.0)


@pytest.mark.parametrize("spec", ["udp:14550", "udpin:host:0", "tcp::x", "/dev/ttyACM0:fast", "x:"])
def test_words_that_name_no_source_are_refused(spec: str) -> None:
    with pytest.raises(InputError, match="write"):
        sources.flight_controller(spec)
