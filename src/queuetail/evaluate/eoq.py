"""Metrics of the end of the queue: pure functions on arrays, one entry per sample."""

from __future__ import annotations

import numpy as np

from queuetail.evaluate.records import Answer, Answers, AnswerShares, EoqErrors, Truth
from queuetail.types import Bools, Floats, Ints

WINDOW_BEFORE_S = 1.5  # issue: the truth within −1.5 … +0.5 s, a definition's edge is no error
WINDOW_AFTER_S = 0.5
EDGE_S = 1e-6  # times are written in milliseconds: both ends of the window belong to it


def window(t_s: Floats, truth_t_s: Floats) -> tuple[Ints, Ints]:
    """Return for each time the half-open range of truth rows within −1.5 … +0.5 s of it."""
    low = np.searchsorted(truth_t_s, t_s - WINDOW_BEFORE_S - EDGE_S, side="left")
    high = np.searchsorted(truth_t_s, t_s + WINDOW_AFTER_S + EDGE_S, side="right")
    return low, high


def any_within(t_s: Floats, truth_t_s: Floats, holds: Bools) -> Bools:
    """Return for each time whether `holds` (one per truth row) is true anywhere in its window."""
    low, high = window(t_s, truth_t_s)
    count = np.concatenate([[0], np.cumsum(holds)])
    return np.asarray(count[high] > count[low])


def tolerant_errors(
    t_s: Floats, station_m: Floats, truth_t_s: Floats, truth_station_m: Floats
) -> Floats:
    """Return station minus the nearest truth station in the window, (n,); NaN where either lacks.

    `truth_station_m` is NaN in rows that give no position to compare with.
    """
    low, high = window(t_s, truth_t_s)
    errors = np.full(len(t_s), np.nan)
    for i in np.flatnonzero(np.isfinite(station_m)):
        gaps = station_m[i] - truth_station_m[low[i] : high[i]]
        gaps = gaps[np.isfinite(gaps)]
        if len(gaps):
            errors[i] = gaps[np.argmin(np.abs(gaps))]
    return errors


def summarise(errors_m: Floats, sigma_m: Floats) -> EoqErrors:
    """Return the figures of signed errors, (n,) each; NaN errors are no samples.

    The 95th percentile is interpolated linearly between the two nearest samples.
    """
    known = np.isfinite(errors_m)
    errors = errors_m[known]
    if not len(errors):
        return EoqErrors(0, None, None, None, None, None, None)
    size = np.abs(errors)
    return EoqErrors(
        samples=len(errors),
        bias_m=float(np.median(errors)),
        median_m=float(np.median(size)),
        p95_m=float(np.percentile(size, 95)),
        max_m=float(size.max()),
        inside_1_sigma=inside(errors, sigma_m[known], 1.0),
        inside_2_sigma=inside(errors, sigma_m[known], 2.0),
    )


def inside(errors_m: Floats, sigma_m: Floats, times: float) -> float | None:
    """Return the share of errors within `times` sigma, of those that have both."""
    both = np.isfinite(errors_m) & np.isfinite(sigma_m)
    return share(np.abs(errors_m[both]) <= times * sigma_m[both])


def share(holds: Bools) -> float | None:
    """Return the share of true entries, None of nothing."""
    return float(np.mean(holds)) if len(holds) else None


def judge_answers(
    t_s: Floats, answer: Ints, truth: Ints, truth_t_s: Floats, truth_state: Ints
) -> Answers:
    """Return the shares of right and wrong answers.

    `answer` and `truth` are of the same samples, (n,); `truth_t_s` and `truth_state` are all rows
    of the truth, for the window.  Missed: the end of the queue is in view and the run says `clear`,
    `unknown` or nothing; excused where the window holds a time without a visible queue.  False:
    there is no queue and the run says `queued` or `beyond_view`; excused by a queue in the window.
    """
    in_view, free = truth == Truth.IN_VIEW, truth == Truth.FREE
    says_queue = np.isin(answer, (Answer.QUEUED, Answer.BEYOND_VIEW))
    no_visible_queue = np.isin(truth_state, (Truth.FREE, Truth.HIDDEN))
    excuses_miss = any_within(t_s, truth_t_s, no_visible_queue)
    excuses_false = any_within(t_s, truth_t_s, truth_state != Truth.FREE)
    return Answers(
        queue_in_view=answer_shares(answer[in_view]),
        queue_beyond_view=answer_shares(answer[truth == Truth.BEYOND_VIEW]),
        no_queue=answer_shares(answer[free]),
        missed_strict=share(~says_queue[in_view]),
        missed_tolerant=share((~says_queue & ~excuses_miss)[in_view]),
        false_strict=share(says_queue[free]),
        false_tolerant=share((says_queue & ~excuses_false)[free]),
        unknown=share(answer == Answer.UNKNOWN),
        no_answer=share(answer == Answer.NONE),
    )


def answer_shares(answer: Ints) -> AnswerShares:
    """Return how often each answer was given, as shares."""
    return AnswerShares(
        samples=len(answer),
        queued=share(answer == Answer.QUEUED),
        beyond_view=share(answer == Answer.BEYOND_VIEW),
        clear=share(answer == Answer.CLEAR),
        unknown=share(answer == Answer.UNKNOWN),
        no_answer=share(answer == Answer.NONE),
    )
