"""Time in a live stream: the network's jitter is no speed, and a camera's clock may jump."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from queuetail.video.stream_clock import Stamp, StreamClock


def stamps(
    clock: StreamClock, pts_s: list[float], arrived_s: list[float], waited: bool = True
) -> list[Stamp | None]:
    found = []
    for pts, arrived in zip(pts_s, arrived_s, strict=True):
        clock.packet(pts, pts, arrived, waited)
        found.append(clock.picture(pts, arrived))
    return found


def known(found: list[Stamp | None]) -> list[Stamp]:
    assert None not in found
    return [s for s in found if s is not None]


def test_jitter_changes_no_interval_and_the_quickest_packets_tell_when() -> None:
    jitter = np.random.default_rng(0).exponential(0.05, 600)
    pts = [5000.0 + k / 30 for k in range(600)]
    arrived = sorted(100.0 + k / 30 + 0.020 + float(jitter[k]) for k in range(600))
    found = known(stamps(StreamClock(), pts, arrived))
    assert found[0].t_s == 0
    steps = [b.t_s - a.t_s for a, b in pairwise(found)]
    assert steps == pytest.approx([1 / 30] * 599, abs=1e-9)
    # 20 ms is the network's least delay; the sorting of arrivals only adds to it.
    late = [s.captured_s - (100.0 + k / 30) for k, s in enumerate(found)][60:]
    assert min(late) > 0.015
    assert max(late) < 0.030


def test_a_drifting_camera_clock_is_followed() -> None:
    """100 ppm over ten minutes is 60 ms; the window sees 3 ms of it."""
    times = [k / 10 for k in range(6000)]
    found = known(stamps(StreamClock(), [t * 1.0001 for t in times], [t + 0.02 for t in times]))
    assert found[-1].captured_s - times[-1] == pytest.approx(0.02, abs=0.004)


def test_a_clock_that_jumps_does_not_take_time_along() -> None:
    clock = StreamClock()
    times = [k / 30 for k in range(90)]
    pts = [t if t < 1 else t - 700.0 if t < 2 else t + 4000.0 for t in times]
    found = known(stamps(clock, pts, times))
    assert [s.t_s for s in found] == pytest.approx(times, abs=0.002)
    assert [s.captured_s for s in found] == pytest.approx(times, abs=0.002)


def test_a_camera_that_paused_with_its_clock_is_in_real_time_again_after_a_second() -> None:
    times = [k / 30 for k in range(30)]
    arrived = [*times, *(t + 8 for t in times), *(t + 9 for t in times), *(t + 10 for t in times)]
    found = known(stamps(StreamClock(), [k / 30 for k in range(120)], arrived))
    assert [s.t_s for s in found[70:]] == pytest.approx(arrived[70:], abs=0.05)
    assert found[-1].captured_s == pytest.approx(arrived[-1], abs=0.05)


def test_a_network_that_paused_takes_no_time_away() -> None:
    """Two seconds of pictures come at once after two seconds of nothing."""
    times = [k / 30 for k in range(150)]
    arrived = [t if t < 1 else max(t, 3.0) for t in times]
    found = known(stamps(StreamClock(), times, arrived))
    assert [s.t_s for s in found] == pytest.approx(times, abs=1e-9)


def test_a_network_that_was_late_for_seconds_takes_no_time_along() -> None:
    """Late packets that keep coming look like a paused camera's, until they catch up."""
    times = [k / 30 for k in range(300)]
    arrived = [t + (1.5 if 2 < t < 5 else 0) for t in times]
    found = stamps(StreamClock(), times, np.maximum.accumulate(arrived).tolist())
    later = known(found[210:])
    assert [s.t_s for s in later] == pytest.approx(times[210:], abs=0.01)
    assert later[-1].captured_s == pytest.approx(times[-1], abs=0.01)
    given = [s.t_s for s in found if s is not None]
    assert all(b > a for a, b in pairwise(given))


def test_a_new_connection_goes_on_where_the_old_one_was_by_arrival() -> None:
    clock = StreamClock()
    times = [k / 30 for k in range(30)]
    stamps(clock, times, times)
    clock.begin()
    found = known(stamps(clock, [t + 77 for t in times], [t + 5 for t in times]))
    assert [s.t_s for s in found] == pytest.approx([t + 5 for t in times], abs=0.002)


def test_repeated_and_earlier_times_are_left_out() -> None:
    found = stamps(StreamClock(), [0.0, 0.1, 0.1, 0.05, 0.2], [0.0, 0.1, 0.11, 0.12, 0.2])
    assert [s is None for s in found] == [False, False, True, True, False]


def test_lag_is_what_lies_ready_not_what_comes_late() -> None:
    clock = StreamClock()
    stamps(clock, [k / 30 for k in range(60)], [k / 30 for k in range(60)])
    stamps(clock, [2.0], [4.0], waited=True)  # nothing came for two seconds
    assert clock.lag_s(4.0) == 0
    stamps(clock, [2.0 + k / 30 for k in range(1, 20)], [4.4 + k / 100 for k in range(19)], False)
    assert clock.lag_s(4.6) > 1
