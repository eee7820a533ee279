"""The flight log as a function of time: neighbours, gaps, ends, wrap-around, order."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.errors import InputError
from queuetail.telemetry.clean import FIELDS, clean
from queuetail.telemetry.flightlog import FlightLog
from queuetail.types import TelemetrySample

TIMES = st.floats(0, 100, allow_nan=False)
ANGLES = st.floats(0, 360, exclude_max=True)


def log(*samples: TelemetrySample) -> FlightLog:
    return FlightLog(samples, "test")


def at(t_s: float, **fields: float) -> TelemetrySample:
    return TelemetrySample(t_s, **fields)


def test_a_value_lies_on_the_line_between_its_neighbours() -> None:
    flight = log(at(0, height_agl_m=100), at(1, height_agl_m=110))
    assert flight.at(0.25).height_agl_m == pytest.approx(102.5)
    assert flight.at(0.25).t_s == 0.25


def test_each_field_has_its_own_neighbours() -> None:
    flight = log(
        at(0, height_agl_m=100, lat_deg=1, lon_deg=1), at(0.5, lat_deg=2), at(1, height_agl_m=110)
    )
    assert flight.at(0.5).height_agl_m == pytest.approx(105)
    assert flight.at(0.25).lat_deg == pytest.approx(1.5)


@pytest.mark.parametrize(("gap_s", "known"), [(1.9, True), (2.0, True), (2.01, False)])
def test_over_two_seconds_between_neighbours_is_unknown(gap_s: float, known: bool) -> None:
    flight = log(at(0, height_agl_m=100), at(gap_s, height_agl_m=100))
    assert (flight.at(gap_s / 2).height_agl_m is not None) is known
    assert flight.at(0).height_agl_m == 100  # the samples themselves are always known
    assert flight.at(gap_s).height_agl_m == 100


@pytest.mark.parametrize(
    ("t_s", "height"), [(-1.0, 100), (-1.1, None), (5.9, 100), (6.1, None), (math.nan, None)]
)
def test_the_ends_hold_for_one_second(t_s: float, height: float | None) -> None:
    flight = log(*[at(i, height_agl_m=100) for i in range(6)])
    assert flight.at(t_s).height_agl_m == height


def test_the_lens_holds_until_the_next_one() -> None:
    flight = log(at(0, hfov_deg=84), at(50, hfov_deg=20))
    assert [flight.at(t).hfov_deg for t in (-9, 0, 49.9, 50, 1e6)] == [84, 84, 84, 20, 20]


@pytest.mark.parametrize(
    ("field", "first", "second", "middle"),
    [
        ("heading_deg", 350.0, 10.0, 0.0),
        ("heading_deg", -10.0, 30.0, 10.0),
        ("gimbal_roll_deg", 179.0, -177.0, -179.0),
        ("lon_deg", 179.99, -179.97, -179.99),
    ],
)
def test_angles_turn_the_short_way(field: str, first: float, second: float, middle: float) -> None:
    flight = log(at(0, **{field: first}), at(1, **{field: second}))
    assert getattr(flight.at(0.5), field) == pytest.approx(middle, abs=1e-9)


@settings(deadline=None)
@given(ANGLES, ANGLES, st.floats(0, 1))
def test_heading_stays_within_the_short_arc(first: float, second: float, share: float) -> None:
    heading = log(at(0, heading_deg=first), at(1, heading_deg=second)).at(share).heading_deg
    assert heading is not None
    assert 0 <= heading < 360
    arc = abs((second - first + 180) % 360 - 180)
    assert abs((heading - first + 180) % 360 - 180) <= arc + 1e-9


@settings(deadline=None)
@given(st.lists(st.tuples(TIMES, st.floats(-50, 500)), min_size=2, max_size=20), TIMES)
def test_a_value_never_leaves_the_range_of_its_log(
    pairs: list[tuple[float, float]], t_s: float
) -> None:
    value = log(*[at(t, height_agl_m=h) for t, h in pairs]).at(t_s).height_agl_m
    heights = [h for _, h in pairs]
    assert value is None or min(heights) - 1e-9 <= value <= max(heights) + 1e-9


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(TIMES, st.floats(-50, 500)), min_size=1, max_size=20, unique_by=lambda p: p[0]
    ),
    TIMES,
    st.randoms(),
)
def test_the_order_of_samples_does_not_matter(
    pairs: list[tuple[float, float]], t_s: float, shuffler: random.Random
) -> None:
    samples = [at(t, height_agl_m=h) for t, h in pairs]
    mixed = samples[:]
    shuffler.shuffle(mixed)
    assert log(*samples).at(t_s) == log(*mixed).at(t_s)


def test_repeated_times_merge_and_the_last_value_wins() -> None:
    flight = log(
        at(1, height_agl_m=100, heading_deg=5), at(1, height_agl_m=120), at(0, height_agl_m=120)
    )
    assert len(flight.samples) == 2
    assert flight.at(1) == at(1, height_agl_m=120, heading_deg=5)


def test_shifted_moves_every_time() -> None:
    flight = log(at(0, height_agl_m=100), at(1, height_agl_m=110)).shifted(10)
    assert flight.span_s == (10, 11)
    assert flight.at(10.5).height_agl_m == pytest.approx(105)


def test_filled_adds_only_what_the_log_never_has() -> None:
    flight = log(at(0, height_agl_m=100)).filled(
        height_agl_m=50.0, gimbal_pitch_deg=-90.0, gimbal_roll_deg=0.0, heading_deg=None
    )
    sample = flight.shifted(1).at(1e4)
    assert (sample.gimbal_pitch_deg, sample.gimbal_roll_deg) == (-90, 0)
    assert flight.at(0).height_agl_m == 100
    assert flight.fields == {"height_agl_m", "gimbal_pitch_deg", "gimbal_roll_deg"}
    with pytest.raises(ValueError, match="no telemetry field is called speed"):
        flight.filled(speed=1.0)


def test_an_empty_log_is_refused() -> None:
    with pytest.raises(InputError, match="no telemetry"):
        log()


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        ({"lat_deg": 361.0, "lon_deg": 0.5}, r"latitude dropped \(outside"),
        ({"lat_deg": 1.0, "lon_deg": -180.5}, r"longitude dropped \(outside"),
        ({"lat_deg": math.nan, "lon_deg": 0.5}, "lat_deg dropped"),
        ({"lat_deg": 0.0, "lon_deg": 0.0}, "no satellite fix"),
        ({"height_agl_m": -5000.0}, "height dropped"),
        ({"height_agl_m": math.inf}, "height_agl_m dropped"),
        ({"gimbal_pitch_deg": -120.0}, "gimbal pitch dropped"),
        ({"heading_deg": 4000.0}, "heading dropped"),
        ({"hfov_deg": 0.0}, "field of view dropped"),
    ],
)
def test_impossible_values_are_dropped_and_counted(bad: dict[str, float], reason: str) -> None:
    good = at(1, lat_deg=10, lon_deg=10, height_agl_m=10, heading_deg=10, gimbal_pitch_deg=-60)
    samples, notes = clean([at(0, **bad), good], "x.csv")
    assert samples == (good,)
    assert len(notes) == 1
    assert notes[0].startswith("1 of 2 samples")
    with pytest.raises(InputError, match=reason):
        clean([at(0, **bad)], "x.csv")


def test_a_bad_value_costs_its_field_only() -> None:
    samples, _ = clean([at(0, lat_deg=361, lon_deg=5, height_agl_m=80)], "x.csv")
    assert samples == (at(0, height_agl_m=80),)
    samples, notes = clean([at(math.nan, height_agl_m=80), at(1, height_agl_m=80)], "x.csv")
    assert len(samples) == len(notes) == 1


@pytest.mark.parametrize(("given_deg", "kept"), [(-90.1, -90), (-91, -90), (12.5, 12.5)])
def test_pitch_a_little_beyond_straight_down_is_clamped(given_deg: float, kept: float) -> None:
    samples, notes = clean([at(0, gimbal_pitch_deg=given_deg)], "x.csv")
    assert samples[0].gimbal_pitch_deg == kept
    assert not notes


def test_all_fields_are_known_to_the_record() -> None:
    assert {"t_s", *FIELDS} == set(TelemetrySample.__slots__)
