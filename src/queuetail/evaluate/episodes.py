"""Queues as episodes in time: when each forms and dissolves, in the truth and in the run."""

from __future__ import annotations

import numpy as np

from queuetail.evaluate.eoq import WINDOW_AFTER_S, WINDOW_BEFORE_S
from queuetail.evaluate.records import Answer, Episode, Episodes, Truth
from queuetail.types import Bools, Floats, Ints

JOIN_S = 2.0  # shorter breaks do not end an episode

Interval = tuple[float, float]


def judge_episodes(t_s: Floats, answer: Ints, truth: Ints) -> Episodes:
    """Return how late the run saw each of the truth's queues form and dissolve.

    All arrays are (n,), of the same samples.  A run that says `unknown` or nothing in between goes
    on with the queue it last reported, but its queue ends with the last answer that reports it.
    """
    seen = np.isin(truth, (Truth.IN_VIEW, Truth.BEYOND_VIEW))
    says = np.isin(answer, (Answer.QUEUED, Answer.BEYOND_VIEW))
    silent = np.isin(answer, (Answer.UNKNOWN, Answer.NONE))
    ours = intervals(t_s, seen, truth == Truth.HIDDEN)
    theirs = intervals(t_s, says, silent)
    first, last = (float(t_s[0]), float(t_s[-1])) if len(t_s) else (0.0, 0.0)
    episodes = []
    for i, (start, end) in enumerate(ours):
        after = ours[i - 1][1] if i else first
        before = ours[i + 1][0] if i + 1 < len(ours) else last
        found = [run for run in theirs if overlaps((start, end), run)]
        onset = dissolve = None
        if found:
            onset = max(found[0][0], after) - start
            dissolve = None if end >= last else min(found[-1][1], before) - end
        episodes.append(Episode(start, end, bool(found), onset, dissolve))
    false = sum(not any(overlaps(truth_one, run) for truth_one in ours) for run in theirs)
    onsets = [e.onset_delay_s for e in episodes if e.onset_delay_s is not None]
    dissolves = [e.dissolve_delay_s for e in episodes if e.dissolve_delay_s is not None]
    return Episodes(
        tuple(episodes),
        missed=sum(not e.found for e in episodes),
        false=false,
        onset_median_s=_median(onsets),
        onset_worst_s=max(onsets, key=abs, default=None),
        dissolve_median_s=_median(dissolves),
        dissolve_worst_s=max(dissolves, key=abs, default=None),
    )


def intervals(t_s: Floats, holds: Bools, bridges: Bools) -> list[Interval]:
    """Return first and last times of the stretches where `holds`.

    Stretches are joined over breaks shorter than JOIN_S and over breaks of nothing but `bridges`.
    """
    edges = np.diff(np.concatenate([[0], holds.astype(np.int8), [0]]))
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    joined: list[tuple[int, int]] = []
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if joined:
            previous = joined[-1][1]
            short = t_s[start] - t_s[previous] < JOIN_S
            if short or bridges[previous + 1 : start].all():
                joined[-1] = (joined[-1][0], stop)
                continue
        joined.append((start, stop))
    return [(float(t_s[a]), float(t_s[b])) for a, b in joined]


def overlaps(truth: Interval, run: Interval) -> bool:
    """Return whether the run's interval touches the truth's, as late or early as is excused."""
    return run[0] <= truth[1] + WINDOW_BEFORE_S and run[1] >= truth[0] - WINDOW_AFTER_S


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None
