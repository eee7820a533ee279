"""HOTA on cases worked by hand, and against its authors' own code where that is installed."""

from __future__ import annotations

import numpy as np
import pytest

from queuetail.evaluate.hota import ALPHAS, Similarities, hota


def instant(truth: list[int], run: list[int], similarity: list[list[float]]) -> Similarities:
    scores = np.array(similarity, float).reshape(len(truth), len(run))
    return Similarities(np.array(truth, np.int64), np.array(run, np.int64), scores)


def test_perfect() -> None:
    scores = hota([instant([0, 1], [0, 1], [[1, 0], [0, 1]])] * 5)
    assert scores is not None
    assert (scores.hota, scores.det_a, scores.ass_a) == (1.0, 1.0, 1.0)


def test_nothing_at_all_and_nothing_found() -> None:
    assert hota([]) is None
    assert hota([instant([], [], [])]) is None
    missed = hota([instant([0], [], [])])
    assert missed is not None
    assert missed.hota == 0.0


def test_identity_switch_by_hand() -> None:
    # one vehicle, 4 instants, always found, half the time as track 0 and half as track 1
    scores = hota([instant([0], [0], [[1]])] * 2 + [instant([0], [1], [[1]])] * 2)
    assert scores is not None
    assert scores.det_a == pytest.approx(1.0)
    assert scores.ass_a == pytest.approx(0.5)  # TPA 2, FNA 2, FPA 0 for every match
    assert scores.hota == pytest.approx(np.sqrt(0.5))


def test_misses_and_false_by_hand() -> None:
    # 4 instants: found in 3; in the fourth missed, with a false track elsewhere
    scores = hota([instant([0], [0], [[1]])] * 3 + [instant([0], [1], [[0]])])
    assert scores is not None
    assert scores.det_a == pytest.approx(3 / 5)  # TP 3, FN 1, FP 1
    assert scores.ass_a == pytest.approx(3 / 4)  # TPA 3, FNA 1, FPA 0
    assert scores.hota == pytest.approx(np.sqrt(9 / 20))


def test_half_similar_counts_for_half_the_thresholds() -> None:
    scores = hota([instant([0], [0], [[0.5]])])
    assert scores is not None
    assert scores.hota == pytest.approx(10 / 19)  # 0.05 … 0.50 of 0.05 … 0.95
    assert len(ALPHAS) == 19


def test_agrees_with_the_authors_code() -> None:
    trackeval = pytest.importorskip("trackeval", reason="the authors' package is not installed")
    rng = np.random.default_rng(7)
    instants = []
    for _ in range(60):
        truth = np.flatnonzero(rng.random(6) < 0.8)
        run = np.flatnonzero(rng.random(9) < 0.6)
        near = rng.random((6, 9)) * (rng.random((6, 9)) < 0.5) + 0.9 * np.eye(6, 9)
        instants.append(Similarities(truth, run, np.clip(near[np.ix_(truth, run)], 0, 1)))
    data = {
        "num_gt_ids": 6,
        "num_tracker_ids": 9,
        "num_gt_dets": sum(len(i.truth) for i in instants),
        "num_tracker_dets": sum(len(i.run) for i in instants),
        "gt_ids": [i.truth for i in instants],
        "tracker_ids": [i.run for i in instants],
        "similarity_scores": [i.similarity for i in instants],
    }
    theirs = trackeval.metrics.HOTA().eval_sequence(data)
    ours = hota(instants)
    assert ours is not None
    assert ours.hota == pytest.approx(theirs["HOTA"].mean())
    assert ours.det_a == pytest.approx(theirs["DetA"].mean())
    assert ours.ass_a == pytest.approx(theirs["AssA"].mean())
