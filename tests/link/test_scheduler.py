"""The rate scheduler: the line is never overfull, what matters most is kept, and it says so."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.link.frames import Decoder
from queuetail.link.messages import (
    IDS,
    Altitude,
    Attitude,
    ClockSource,
    ClockTime,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lens,
    Lidar,
    Position,
    Quantity,
    Sensors,
    Status,
    header_of,
)
from queuetail.link.scheduler import FILL, WISHES, RateScheduler, fitted_rates, frame_bytes

ALL: tuple[Quantity, ...] = (
    Position(36.0, -97.0),
    Height(110.0, HeightSource.LIDAR),
    Altitude(109.0, 400.0),
    Heading(75.0),
    Attitude(1.0, -2.0),
    Gimbal(75.0, -55.0, 0.0),
    Lidar(110.0),
    Lens(84.0),
    ClockTime(1.8e9, ClockSource.GPS),
)


def drive(
    scheduler: RateScheduler, seconds: float, quantities: tuple[Quantity, ...] = ALL
) -> dict[str, float]:
    """Offer everything 20 times a second and return how often each was sent per second."""
    decoder = Decoder()
    sent = dict.fromkeys(IDS, 0)
    for tick in range(int(seconds * 200)):
        now_s = tick / 200
        if tick % 10 == 0:
            for quantity in quantities:
                scheduler.offer(quantity, now_s)
        if tick % 200 == 0:
            scheduler.offer(scheduler.status(now_s, Sensors.NONE), now_s)
        frame = scheduler.next_frame(now_s)
        if frame is not None:
            for message in decoder.feed(frame):
                sent[header_of(message.quantity)] += 1
    assert decoder.counts.bad_frames == 0
    return {header: count / seconds for header, count in sent.items()}


def test_at_9600_baud_every_wish_is_met() -> None:
    rates = drive(RateScheduler(9600), 30.0)
    for header, wish in WISHES.items():
        assert rates[header] == pytest.approx(wish.rate_hz, rel=0.07), header
    used = sum(rate * frame_bytes(header) for header, rate in rates.items())
    assert 0.88 * 960 < used <= FILL * 960 * 1.01


@pytest.mark.parametrize("baud", [4800, 2400, 1200])
def test_a_slower_line_gives_up_the_least_important_first(baud: int) -> None:
    scheduler = RateScheduler(baud)
    rates = drive(scheduler, 30.0)
    assert sum(rate * frame_bytes(header) for header, rate in rates.items()) <= baud / 10
    assert rates["GMB"] >= 1.9
    assert rates["POS"] >= (1.8 if baud > 1200 else 1.0)
    assert rates["ATT"] == 0
    status = scheduler.status(30.0, Sensors.LIDAR)
    reduced = {rate.header for rate in status.rates if rate.is_reduced}
    assert {"ATT", "ALT", "LDR"} <= reduced
    assert status.sensors is Sensors.LIDAR
    assert 70 <= status.load_percent <= 101


def test_a_sensor_that_is_not_there_leaves_its_share_to_the_others() -> None:
    few = tuple(q for q in ALL if isinstance(q, Position | Gimbal))
    rates = drive(RateScheduler(4800), 20.0, few)
    assert rates["POS"] == pytest.approx(10, rel=0.1)
    assert rates["GMB"] == pytest.approx(10, rel=0.1)


@given(
    st.dictionaries(st.sampled_from(sorted(WISHES)), st.floats(0.1, 20), min_size=1),
    st.floats(1, 2000),
)
def test_fitted_rates_fit_and_never_exceed_what_is_wanted(
    wanted: dict[str, float], bytes_per_s: float
) -> None:
    rates = fitted_rates(wanted, bytes_per_s)
    assert sum(rate * frame_bytes(h) for h, rate in rates.items()) <= bytes_per_s * 1.000001
    assert all(0 <= rates[h] <= wanted[h] for h in wanted)
    if sum(rate * frame_bytes(h) for h, rate in wanted.items()) <= bytes_per_s:
        assert rates == wanted


def test_only_the_newest_value_waits() -> None:
    scheduler = RateScheduler()
    for metres in range(10):
        scheduler.offer(Lidar(float(metres)), metres / 100)
    frame = scheduler.next_frame(0.1)
    assert frame is not None
    (message,) = Decoder().feed(frame)
    assert (message.quantity, message.sent_s) == (Lidar(9.0), 0.09)
    assert scheduler.next_frame(5.0) is None


def test_a_value_that_cannot_be_sent_is_counted_and_does_not_block() -> None:
    scheduler = RateScheduler()
    scheduler.offer(Position(math.nan, 0.0), 0.0)
    scheduler.offer(Lens(84.0), 0.0)
    frame = scheduler.next_frame(0.0)
    assert frame is not None
    assert frame[:3] == b"FOV"
    assert scheduler.refused == 1


def test_a_blocked_line_is_taken_as_slower_and_recovers() -> None:
    scheduler = RateScheduler(9600)
    drive(scheduler, 5.0)
    for tick in range(50):
        scheduler.line_blocked(5 + tick / 20)
    assert scheduler.capacity_bytes_per_s < 400
    for tick in range(200):
        scheduler.offer(Heading(1.0), 8 + tick / 10)
        scheduler.next_frame(8 + tick / 10)
    assert scheduler.capacity_bytes_per_s == 960


def test_the_status_itself_goes_over_the_line() -> None:
    scheduler = RateScheduler()
    drive(scheduler, 4.0)
    status = scheduler.status(4.0, Sensors.FLIGHT_CONTROLLER | Sensors.LIDAR)
    scheduler.offer(status, 4.0)
    heard = []
    for tick in range(400):
        frame = scheduler.next_frame(4 + tick / 200)
        heard += Decoder().feed(frame or b"")
    (received,) = [m.quantity for m in heard if isinstance(m.quantity, Status)]
    assert received.sensors == Sensors.FLIGHT_CONTROLLER | Sensors.LIDAR
    assert {r.header for r in received.rates} == set(IDS)
    assert not any(r.is_reduced for r in received.rates)
