"""Metrics of the end of the queue, on cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.evaluate.eoq import any_within, judge_answers, summarise, tolerant_errors
from queuetail.evaluate.episodes import intervals, judge_episodes
from queuetail.evaluate.records import Answer, Truth

NAN = float("nan")
CLEAR, QUEUED, BEYOND, UNKNOWN, NONE = (
    Answer.CLEAR,
    Answer.QUEUED,
    Answer.BEYOND_VIEW,
    Answer.UNKNOWN,
    Answer.NONE,
)
FREE, IN_VIEW, OUT, HIDDEN = Truth.FREE, Truth.IN_VIEW, Truth.BEYOND_VIEW, Truth.HIDDEN


def test_summary_by_hand() -> None:
    errors = np.array([1.0, -2.0, NAN, 3.0, -10.0])
    figures = summarise(errors, np.array([1.0, 1.0, 1.0, NAN, 6.0]))
    assert figures.samples == 4
    assert figures.median_m == 2.5  # of 1, 2, 3, 10
    assert figures.p95_m == pytest.approx(3 + 0.85 * 7)
    assert figures.max_m == 10.0
    assert figures.bias_m == -0.5  # of -10, -2, 1, 3
    assert figures.inside_1_sigma == pytest.approx(1 / 3)  # 1/1 in, 2/1 out, 10/6 out
    assert figures.inside_2_sigma == 1.0


def test_summary_of_nothing() -> None:
    figures = summarise(np.array([NAN]), np.array([1.0]))
    assert figures.samples == 0
    assert figures.median_m is None


def test_tolerant_error_takes_the_nearest_truth_of_the_window() -> None:
    truth_t = np.arange(0, 6, 0.5)
    truth = np.where(truth_t < 3, 100.0, 80.0)  # the end jumps upstream at 3 s
    errors = tolerant_errors(np.array([2.0, 2.5, 4.5, 5.0]), np.array([81.0] * 4), truth_t, truth)
    # 2.0 sees 0.5 … 2.5: all 100; 2.5 sees 3.0; 4.5 sees 3.0 … 5.0; so does 5.0 from 3.5 on
    np.testing.assert_allclose(errors, [-19.0, 1.0, 1.0, 1.0])
    late = tolerant_errors(np.array([4.0, 4.5]), np.array([100.0, 100.0]), truth_t, truth)
    np.testing.assert_allclose(late, [0.0, 20.0])  # 4.0 still sees 2.5


@given(
    st.lists(st.floats(-50, 50), min_size=1, max_size=30),
    st.lists(st.floats(-50, 50), min_size=1, max_size=30),
)
def test_tolerant_never_exceeds_strict(ours: list[float], theirs: list[float]) -> None:
    n = min(len(ours), len(theirs))
    t = np.arange(n) * 0.4
    run, truth = np.array(ours[:n]), np.array(theirs[:n])
    tolerant = tolerant_errors(t, run, t, truth)
    assert (np.abs(tolerant) <= np.abs(run - truth) + 1e-12).all()
    brute = [
        min(abs(run[i] - truth[j]) for j in range(n) if -1.5 <= t[j] - t[i] + 1e-7 <= 0.5 + 2e-7)
        for i in range(n)
    ]
    np.testing.assert_allclose(np.abs(tolerant), brute)


def test_window_includes_both_its_ends() -> None:
    truth_t = np.array([0.0, 1.0, 2.0, 3.0])
    holds = np.array([True, False, False, False])
    inside = any_within(np.array([-0.6, -0.5, 0.0, 1.5, 1.6]), truth_t, holds)
    assert inside.tolist() == [False, True, True, True, False]


def test_answers_by_hand() -> None:
    t = np.arange(8.0)
    truth = np.array([FREE, FREE, FREE, IN_VIEW, IN_VIEW, IN_VIEW, IN_VIEW, OUT])
    answer = np.array([QUEUED, CLEAR, UNKNOWN, CLEAR, UNKNOWN, NONE, QUEUED, BEYOND])
    judged = judge_answers(t, answer, truth, t, truth)
    assert judged.missed_strict == 3 / 4
    # 3 s (sees 2 s) is excused; 4 s sees 3 and 4 s, and 5 s sees 4 and 5 s: not
    assert judged.missed_tolerant == 2 / 4
    assert judged.false_strict == 1 / 3
    assert judged.false_tolerant == 1 / 3  # 0 s sees no queue up to 0.5 s
    assert judged.unknown == 2 / 8
    assert judged.no_answer == 1 / 8
    assert judged.queue_in_view.clear == 1 / 4
    assert judged.queue_beyond_view.beyond_view == 1.0
    assert judged.no_queue.unknown == 1 / 3


def test_a_false_answer_just_after_the_queue_is_excused() -> None:
    t = np.arange(0, 4, 0.5)
    truth = np.where(t < 1, IN_VIEW, FREE)
    answer = np.where(t < 3, QUEUED, CLEAR)
    judged = judge_answers(t, answer, truth, t, truth)
    assert judged.false_strict == 4 / 6  # 1.0, 1.5, 2.0, 2.5
    assert judged.false_tolerant == 1 / 6  # 2.5 is the first that sees no queue, from 1.0 on


def test_nothing_hidden_is_judged() -> None:
    t = np.arange(4.0)
    hidden = np.full(4, HIDDEN)
    judged = judge_answers(t, np.array([CLEAR, QUEUED, UNKNOWN, BEYOND]), hidden, t, hidden)
    assert judged.missed_strict is None
    assert judged.false_strict is None
    assert judged.unknown == 1 / 4


def test_episode_delays_by_hand() -> None:
    t = np.arange(0, 60, 0.5)
    truth = np.where((t >= 10) & (t <= 20) | (t >= 40) & (t <= 50), IN_VIEW, FREE)
    run = np.where((t >= 12) & (t <= 23) | (t >= 39) & (t <= 50.5), QUEUED, CLEAR)
    queues = judge_episodes(t, run, truth)
    assert [e.onset_delay_s for e in queues.episodes] == [2.0, -1.0]
    assert [e.dissolve_delay_s for e in queues.episodes] == [3.0, 0.5]
    assert (queues.onset_median_s, queues.onset_worst_s) == (0.5, 2.0)
    assert (queues.dissolve_median_s, queues.dissolve_worst_s) == (1.75, 3.0)
    assert (queues.missed, queues.false) == (0, 0)


def test_missed_and_false_episodes() -> None:
    t = np.arange(0, 60, 0.5)
    truth = np.where((t >= 10) & (t <= 20), IN_VIEW, FREE)
    run = np.where((t >= 30) & (t <= 40), BEYOND, CLEAR)
    queues = judge_episodes(t, run, truth)
    assert (queues.missed, queues.false) == (1, 1)
    assert queues.onset_median_s is None
    assert queues.episodes[0].onset_delay_s is None


def test_one_queue_of_the_run_over_two_of_the_truth() -> None:
    t = np.arange(0, 60, 0.5)
    truth = np.where((t >= 10) & (t <= 20) | (t >= 40) & (t <= 50), IN_VIEW, FREE)
    queues = judge_episodes(t, np.where((t >= 10) & (t <= 50), QUEUED, CLEAR), truth)
    # never said clear in between: late by the whole break once, early by it once
    assert [e.dissolve_delay_s for e in queues.episodes] == [20.0, 0.0]
    assert [e.onset_delay_s for e in queues.episodes] == [0.0, -20.0]


def test_a_queue_that_still_stands_at_the_end_has_no_dissolve_delay() -> None:
    t = np.arange(0, 20, 0.5)
    queues = judge_episodes(t, np.where(t >= 6, QUEUED, UNKNOWN), np.where(t >= 5, OUT, FREE))
    assert queues.episodes[0].onset_delay_s == 1.0
    assert queues.episodes[0].dissolve_delay_s is None


def test_intervals_bridge_short_breaks_and_silence() -> None:
    t = np.arange(12.0)
    holds = np.isin(t, [0, 1, 4, 8])
    silent = np.isin(t, [2, 3])
    assert intervals(t, holds, silent) == [(0.0, 4.0), (8.0, 8.0)]
    assert intervals(t / 3, holds, ~holds & False) == [(0.0, 8 / 3)]
    assert intervals(t, holds & False, silent) == []
