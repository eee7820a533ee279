"""The rolling log: interpolation, ages, and what it refuses."""

from __future__ import annotations

import math
import threading
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.telemetry.live_log import BACKWARDS_TO_BELIEVE, LiveLog
from queuetail.types import TelemetrySample

HERE = TelemetrySample(0.0, 36.11, -97.0575, 110.0, 75.0, -55.0, 0.0, 84.0)
DEGREE_M = 111_320.0


def moved(t_s: float, north_m: float = 0.0, **changed: float | None) -> TelemetrySample:
    return replace(HERE, t_s=t_s, lat_deg=36.11 + north_m / DEGREE_M, **changed)  # type: ignore[arg-type]


def hover(seconds: float, rate_hz: float = 10.0) -> LiveLog:
    log = LiveLog()
    for i in range(round(seconds * rate_hz) + 1):
        log.add(moved(i / rate_hz, north_m=i / rate_hz))
    return log


def test_between_two_readings_it_interpolates_the_short_way_round() -> None:
    log = LiveLog()
    log.add(moved(0.0, heading_deg=358.0))
    log.add(moved(1.0, north_m=4.0, heading_deg=4.0))
    middle = log.at(0.5)
    assert middle.heading_deg == pytest.approx(1.0)
    assert middle.lat_deg == pytest.approx(36.11 + 2 / DEGREE_M)
    assert middle.hfov_deg == 84.0
    assert log.at(1.0).heading_deg == 4.0


def test_every_quantity_has_its_own_neighbours() -> None:
    log = LiveLog()
    for i in range(20):
        log.add(TelemetrySample(i / 10, heading_deg=float(i)))
        if i % 10 == 0:
            log.add(TelemetrySample(i / 10 + 0.05, height_agl_m=100.0 + i))
    sample = log.at(0.55)
    assert sample.heading_deg == pytest.approx(5.5)
    assert sample.height_agl_m == pytest.approx(105.0)
    assert sample.lat_deg is None


def test_what_is_old_is_not_known() -> None:
    log = hover(5.0)
    assert log.at(6.4).lat_deg == pytest.approx(36.11 + 5 / DEGREE_M)
    gone = log.at(6.6)
    assert (gone.lat_deg, gone.lon_deg, gone.heading_deg, gone.height_agl_m) == (None,) * 4
    assert gone.hfov_deg == 84.0  # a lens stays as it is
    patient = LiveLog(max_age_s={"position": 5.0})
    patient.add(HERE)
    assert patient.at(4.9).lat_deg == 36.11
    assert patient.at(4.9).heading_deg is None


def test_ages_and_rates() -> None:
    log = hover(10.0)
    log.add(TelemetrySample(9.0, hfov_deg=70.0))
    ages, rates = log.ages(10.25), log.rates(10.0)
    assert ages["position"] == pytest.approx(0.25)
    assert rates["heading"] == pytest.approx(10.0, abs=0.3)
    assert LiveLog().ages(0.0) == LiveLog().rates(0.0) == {}


def test_only_the_last_seconds_are_kept() -> None:
    log = hover(100.0)
    assert log.at(69.0).lat_deg is None or log.at(60.0).lat_deg is None
    assert len(log._series["position"].times) < 320


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"lat_deg": math.nan}, "position is impossible"),
        ({"lat_deg": 91.0}, "position is impossible"),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, "position is impossible"),
        ({"height_agl_m": math.inf}, "height is impossible"),
        ({"heading_deg": math.nan}, "heading is impossible"),
        ({"gimbal_pitch_deg": -120.0}, "gimbal_pitch is impossible"),
        ({"hfov_deg": 0.0}, "hfov is impossible"),
    ],
)
def test_what_is_impossible_is_refused_and_the_rest_kept(
    changed: dict[str, float], reason: str
) -> None:
    log = hover(1.0)
    log.add(replace(moved(1.1, 1.1), **changed))  # type: ignore[arg-type]
    assert log.refused == {reason: 1}
    newest = {name: age for name, age in log.ages(1.1).items() if age < 0.05}
    assert len(newest) == 5


def test_times_that_are_none_or_lie_ahead_are_refused() -> None:
    log = LiveLog()
    log.add(replace(HERE, t_s=math.nan))
    log.add(replace(HERE, t_s=100.0), arrived_s=10.0)
    assert sum(log.refused.values()) == 2
    assert log.at(10.0).lat_deg is None


def test_a_leap_that_nothing_confirms_is_forgotten() -> None:
    log = hover(2.0)
    log.add(moved(2.1, north_m=500.0))
    assert log.at(2.1).lat_deg == pytest.approx(36.11 + 2 / DEGREE_M)
    log.add(moved(2.2, north_m=2.2))
    assert log.at(2.15).lat_deg == pytest.approx(36.11 + 2.15 / DEGREE_M)
    assert log.refused == {"position leapt and came back": 1}


def test_a_leap_that_the_next_reading_confirms_is_taken_and_not_bridged() -> None:
    log = hover(2.0)
    for i in range(3):
        log.add(moved(2.2 + i / 10, north_m=500.0))
    assert log.at(2.35).lat_deg == pytest.approx(36.11 + 500 / DEGREE_M)
    across = log.at(2.09).lat_deg
    assert across is not None
    assert across == pytest.approx(36.11 + 2 / DEGREE_M, abs=1 / DEGREE_M)  # the nearer side
    assert log.refused == {}


def test_after_a_silence_a_new_place_is_no_leap() -> None:
    log = hover(2.0)
    log.add(moved(32.0, north_m=800.0))
    assert log.at(32.0).lat_deg == pytest.approx(36.11 + 800 / DEGREE_M)


def test_a_quick_yaw_is_followed_and_an_impossible_one_held_back() -> None:
    log = LiveLog()
    for i in range(10):
        log.add(TelemetrySample(i / 10, heading_deg=(350 + 18.0 * i) % 360))
    assert log.refused == {}
    log.add(TelemetrySample(1.0, heading_deg=10.0))
    assert log.at(1.0).heading_deg == pytest.approx(152.0)


def test_times_that_run_backwards_are_refused_until_they_go_on() -> None:
    log = hover(10.0)
    log.add(moved(9.95, 10))
    log.add(moved(10.0, 10))
    refused = log.refused
    assert refused["position runs backwards"] == 1
    assert refused["position repeats its time"] == 1
    for i in range(BACKWARDS_TO_BELIEVE + 2):
        log.add(moved(1.0 + i / 10, north_m=3.0))
    assert log.at(1.65).lat_deg == pytest.approx(36.11 + 3 / DEGREE_M)
    assert log.at(10.0).lat_deg is None


def test_constants_fill_only_what_is_never_said() -> None:
    log = LiveLog(constants={"gimbal_roll_deg": 0.0, "hfov_deg": 70.0})
    assert log.at(0.0).hfov_deg == 70.0
    log.add(TelemetrySample(0.0, hfov_deg=84.0))
    assert log.at(5.0).hfov_deg == 84.0
    assert log.at(5.0).gimbal_roll_deg == 0.0


def test_an_unknown_quantity_is_refused() -> None:
    with pytest.raises(ValueError, match="no quantity is called speed"):
        LiveLog(max_age_s={"speed": 1.0})


values = st.none() | st.floats(allow_nan=True, allow_infinity=True)


@given(st.lists(st.tuples(st.floats(-5, 60), values, values, values, values), max_size=60))
def test_whatever_comes_no_answer_is_impossible(rows: list[tuple[float | None, ...]]) -> None:
    log = LiveLog(window_s=10.0)
    for t_s, lat, lon, heading, pitch in rows:
        assert t_s is not None
        log.add(TelemetrySample(t_s, lat, lon, None, heading, pitch))
        for series in log._series.values():
            assert series.times == sorted(series.times)
        for seen in (log.at(t_s), log.at(t_s + 0.7)):
            assert seen.lat_deg is None or -90 <= seen.lat_deg <= 90
            assert seen.heading_deg is None or 0 <= seen.heading_deg < 360
            assert seen.gimbal_pitch_deg is None or -90 <= seen.gimbal_pitch_deg <= 90
            assert (seen.lat_deg is None) == (seen.lon_deg is None)


def test_threads_may_write_and_read_at_once() -> None:
    log = LiveLog(window_s=1.0)
    done = threading.Event()
    faults: list[BaseException] = []

    def read() -> None:
        try:
            while not done.is_set():
                log.at(5.0)
                log.ages(5.0)
                log.rates(5.0)
        except BaseException as error:
            faults.append(error)

    reader = threading.Thread(target=read)
    reader.start()
    for i in range(3000):
        log.add(moved(i / 100))
    done.set()
    reader.join(20)
    assert faults == []
    assert log.at(29.99).lat_deg == 36.11
