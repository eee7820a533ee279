"""Two clocks joined by messages: offsets, queues, drift, restarts; one height of two sensors."""

from __future__ import annotations

import math
import random

import pytest

from queuetail.link.clock import ClockEstimate, UtcEstimate
from queuetail.link.height import HeightFinder
from queuetail.link.messages import Altitude, Attitude, Height, HeightSource, Lidar


def test_queues_delay_messages_but_do_not_shift_the_clock() -> None:
    noise = random.Random(3)
    clock = ClockEstimate()
    for i in range(1000):
        sent_s = i / 20
        clock.add(sent_s, 500.0 + sent_s + 0.02 + noise.expovariate(1 / 0.05), 0.02)
    assert clock.offset_s == pytest.approx(500.0, abs=0.003)
    assert clock.sigma_s == pytest.approx(0.035, abs=0.03)
    assert clock.received_s(12.0) == pytest.approx(512.0, abs=0.003)


def test_a_crystal_that_drifts_is_followed() -> None:
    clock = ClockEstimate()
    for i in range(36_000):  # an hour at 10 Hz, 50 millionths too slow
        sent_s = i / 10
        clock.add(sent_s, 1.00005 * sent_s)
    assert clock.received_s(3600.0) == pytest.approx(3600.18, abs=0.005)


def test_a_sender_that_restarts_gets_a_new_offset_at_once() -> None:
    clock = ClockEstimate()
    clock.add(100.0, 200.0)
    clock.add(0.5, 207.0)
    assert clock.received_s(1.0) == pytest.approx(207.5)
    assert clock.restarts == 1


def test_before_any_message_nothing_is_known() -> None:
    clock, utc = ClockEstimate(), UtcEstimate()
    assert clock.received_s(1.0) is clock.offset_s is clock.sigma_s is utc.utc_s(0.0) is None


def test_utc_follows_a_clock_that_is_set() -> None:
    utc = UtcEstimate()
    utc.add(10.0, 100.0)
    utc.add(11.0, 101.02)
    utc.add(12.0, 102.0)
    assert utc.utc_s(20.0) == pytest.approx(110.0)
    utc.add(13.0, 1.8e9)
    assert utc.utc_s(14.0) == pytest.approx(1.8e9 + 1)


def test_the_lidars_slant_counts_and_the_altitude_takes_over_without_a_step() -> None:
    finder = HeightFinder()
    assert finder.add(Altitude(80.0), 0.0) == Height(80.0, HeightSource.TAKEOFF)
    finder.add(Attitude(10.0, 5.0), 0.1)
    height = finder.add(Lidar(100.0), 0.15)
    slant = math.cos(math.radians(10)) * math.cos(math.radians(5))
    assert height == Height(pytest.approx(100 * slant), HeightSource.LIDAR)
    assert finder.add(Altitude(80.5), 0.2) is None
    assert finder.add(Lidar(None), 0.3) is None
    later = finder.add(Altitude(81.0), 3.0)
    assert later == Height(pytest.approx(100 * slant + 1), HeightSource.LIDAR_AND_ALTITUDE)


@pytest.mark.parametrize("lidar", [Lidar(None), Lidar(0.0)])
def test_no_echo_gives_no_height(lidar: Lidar) -> None:
    assert HeightFinder().add(lidar, 0.0) is None


def test_a_drone_on_its_side_gives_no_height() -> None:
    finder = HeightFinder()
    finder.add(Attitude(60.0, 0.0), 0.0)
    assert finder.add(Lidar(30.0), 0.1) is None
