"""HOTA: higher order tracking accuracy, by its published formulas.

Source: J. Luiten et al., "HOTA: A Higher Order Metric for Evaluating Multi-Object Tracking", IJCV
129 (2021).  motmetrics has no HOTA, and the package of HOTA's authors cannot be installed beside a
headless OpenCV, so the score is computed here on scipy's assignment.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from queuetail.types import Floats, Ints

ALPHAS = np.arange(1, 20) * 0.05  # 0.05 … 0.95, the paper's 19 localisation thresholds
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True, slots=True)
class Similarities:
    """One instant: identities counted from 0, and their similarities 0 … 1, (n, m)."""

    truth: Ints  # (n,)
    run: Ints  # (m,)
    similarity: Floats  # (n, m)


@dataclass(frozen=True, slots=True)
class HotaScores:
    """HOTA and its two factors, detection and association accuracy: means over the thresholds."""

    hota: float
    det_a: float
    ass_a: float


def hota(instants: Sequence[Similarities]) -> HotaScores | None:
    """Return HOTA, DetA and AssA; None where neither side ever has an object."""
    n = 1 + max((int(i.truth.max(initial=-1)) for i in instants), default=-1)
    m = 1 + max((int(i.run.max(initial=-1)) for i in instants), default=-1)
    if n == 0 and m == 0:
        return None
    truth_count, run_count, alignment = _alignment(instants, n, m)
    pairs, similarities = [np.zeros(0, np.int64)], [np.zeros(0)]
    for now in instants:
        score = alignment[np.ix_(now.truth, now.run)] * now.similarity
        rows, cols = linear_sum_assignment(-score)
        pairs.append(now.truth[rows] * m + now.run[cols])
        similarities.append(now.similarity[rows, cols])
    pair, similarity = np.concatenate(pairs), np.concatenate(similarities)
    scores = [
        _at_threshold(pair[similarity >= alpha - EPS], truth_count, run_count) for alpha in ALPHAS
    ]
    det_a, ass_a = np.array(scores).T
    return HotaScores(
        float(np.sqrt(det_a * ass_a).mean()), float(det_a.mean()), float(ass_a.mean())
    )


def _at_threshold(pair: Ints, truth_count: Floats, run_count: Floats) -> tuple[float, float]:
    """Return DetA and AssA of the matches at one threshold; a pair is truth * m + run."""
    tp = len(pair)
    det_a = tp / (truth_count.sum() + run_count.sum() - tp)  # TP / (TP + FN + FP)
    if not tp:
        return det_a, 0.0
    pairs, tpa = np.unique(pair, return_counts=True)
    truth, run = np.divmod(pairs, len(run_count))
    association = tpa / (truth_count[truth] + run_count[run] - tpa)  # TPA / (TPA + FNA + FPA)
    return det_a, float((tpa * association).sum() / tp)


def _alignment(instants: Sequence[Similarities], n: int, m: int) -> tuple[Floats, Floats, Floats]:
    """Return how often each identity occurs, and how well each pair agrees over the whole time.

    A pair's potential matches are weighted by their similarity relative to what else is near, as
    the authors' own code does: the assignment then favours pairs that last.
    """
    truth_count, run_count, potential = np.zeros(n), np.zeros(m), np.zeros((n, m))
    for now in instants:
        s = now.similarity
        either = s.sum(axis=0) + s.sum(axis=1, keepdims=True) - s
        potential[np.ix_(now.truth, now.run)] += np.divide(
            s, either, out=np.zeros_like(s), where=either > EPS
        )
        truth_count[now.truth] += 1
        run_count[now.run] += 1
    either = truth_count[:, None] + run_count - potential
    agreement = np.divide(potential, either, out=np.zeros_like(potential), where=either > 0)
    return truth_count, run_count, agreement
