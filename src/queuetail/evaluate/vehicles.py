"""Vehicles of the run against vehicles of the truth: instants, pairs to judge, figures."""

from __future__ import annotations

from dataclasses import dataclass

import motmetrics
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from queuetail.evaluate.hota import Similarities, hota
from queuetail.evaluate.records import VehicleFigures
from queuetail.types import Bools, Floats, Ints

EDGE_SHARE = 0.02  # of the frame: nearer to its edge a vehicle may be found but need not be
MAX_GAP_S = 0.35  # a truth vehicle is interpolated over no longer break than this
FAR = 1e6


@dataclass(frozen=True, slots=True)
class Seen:
    """Vehicles at instants, one row per vehicle and instant, in order of the instants."""

    instant: Ints  # (n,)
    vehicle: Ints  # (n,) identities counted from 0
    enu: Floats  # (n, 2)
    road: Floats  # (n, 2) station and offset on the truth's axis
    speed_mps: Floats  # (n,) NaN where it is not known
    optional: Bools  # (n,) may be paired, but is no error where it is not


@dataclass(frozen=True, slots=True)
class Pairing:
    """What is judged at one instant: rows of the truth and of the run, and their distances."""

    truth: Ints
    run: Ints
    distance_m: Floats  # (len(truth), len(run))


def interpolate(
    t_s: Floats, vehicle: Ints, values: Floats, at_s: Floats
) -> tuple[Ints, Ints, Floats]:
    """Return each vehicle's values at the instants at which it exists.

    `t_s` and `vehicle` (n,), `values` (n, k), `at_s` (m,) -> index of the instant (p,),
    vehicle (p,), values (p, k), in order of the instants.  A vehicle exists at its own times and
    between two of them that are no farther apart than MAX_GAP_S.
    """
    order = np.lexsort((t_s, vehicle))
    t_s, vehicle, values = t_s[order], vehicle[order], values[order]
    starts = np.flatnonzero(np.diff(vehicle, prepend=-1))
    found = []
    for start, stop in zip(starts, [*starts, len(vehicle)][1:], strict=True):
        times = t_s[start:stop]
        low = np.searchsorted(times, at_s + 1e-6, side="right") - 1
        high = np.minimum(low + 1, len(times) - 1)
        exact = (low >= 0) & (np.abs(times[low] - at_s) < 1e-3)
        between = (low >= 0) & (high > low) & (times[high] - times[low] <= MAX_GAP_S)
        now = np.flatnonzero(exact | between)
        a, b = start + low[now], start + high[now]
        step = np.maximum(t_s[b] - t_s[a], 1e-9)
        share = np.where(exact[now], 0.0, (at_s[now] - t_s[a]) / step)[:, None]
        found.append(
            (now, np.full(len(now), vehicle[start]), values[a] + share * (values[b] - values[a]))
        )
    if not found:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), values[:0]
    instant, who, what = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.argsort(instant, kind="stable")
    return instant[order], who[order], what[order]


def near_edge(px: Floats, size: tuple[int, int] | None) -> Bools:
    """Return which pixels (n, 2) are outside the frame or near its edge; none without a size."""
    if size is None:
        return np.zeros(len(px), np.bool_)
    margin = EDGE_SHARE * max(size)
    known = np.isfinite(px).all(axis=1)
    inside = ((px >= margin) & (px <= np.asarray(size) - margin)).all(axis=1)
    return np.asarray(known & ~inside)


def pair_up(truth: Seen, run: Seen, instants: int, gate_m: float) -> list[Pairing]:
    """Return what is judged at each instant.

    First all are paired by least total distance within the gate; then those that only may be found
    go where they are not paired: truth with its run vehicle, run vehicles alone.
    """
    pairings = []
    truth_at = np.searchsorted(truth.instant, np.arange(instants + 1))
    run_at = np.searchsorted(run.instant, np.arange(instants + 1))
    for i in range(instants):
        ours = np.arange(truth_at[i], truth_at[i + 1])
        theirs = np.arange(run_at[i], run_at[i + 1])
        distance = cdist(truth.enu[ours], run.enu[theirs])
        keep_ours, keep_theirs = ~truth.optional[ours], ~run.optional[theirs]
        rows, cols = linear_sum_assignment(np.where(distance <= gate_m, distance, FAR))
        near = distance[rows, cols] <= gate_m
        keep_theirs[cols[near]] = keep_ours[rows[near]]
        pairings.append(
            Pairing(ours[keep_ours], theirs[keep_theirs], distance[np.ix_(keep_ours, keep_theirs)])
        )
    return pairings


def judge_vehicles(
    truth: Seen, run: Seen, pairings: list[Pairing], gate_m: float
) -> VehicleFigures:
    """Return recall, precision, IDF1 and MOTA (motmetrics), HOTA, place and speed of the pairs.

    The similarity for HOTA is 1 − distance / gate, 0 beyond the gate.
    """
    accumulator = motmetrics.MOTAccumulator()
    for i, pairing in enumerate(pairings):
        gated = np.where(pairing.distance_m <= gate_m, pairing.distance_m, np.nan)
        accumulator.update(truth.vehicle[pairing.truth], run.vehicle[pairing.run], gated, frameid=i)
    kept_truth = np.concatenate([np.zeros(0, np.int64), *(p.truth for p in pairings)])
    kept_run = np.concatenate([np.zeros(0, np.int64), *(p.run for p in pairings)])
    names = ["recall", "precision", "idf1", "mota", "num_switches"]
    scores = motmetrics.metrics.create().compute(accumulator, metrics=names, return_dataframe=False)
    ours, theirs = _matched_rows(accumulator, truth, run)
    away = np.linalg.norm(run.enu[theirs] - truth.enu[ours], axis=1)
    aside = run.road[theirs] - truth.road[ours]
    speed = run.speed_mps[theirs] - truth.speed_mps[ours]
    speed = speed[np.isfinite(speed)]
    tracking = hota([_similarities(truth, run, p, gate_m) for p in pairings])
    any_truth, any_run = len(kept_truth) > 0, len(kept_run) > 0
    return VehicleFigures(
        gate_m=gate_m,
        instants=len(pairings),
        truth_vehicles=len(np.unique(truth.vehicle[kept_truth])),
        run_tracks=len(np.unique(run.vehicle[kept_run])),
        pairs=len(ours),
        recall=float(scores["recall"]) if any_truth else None,
        precision=float(scores["precision"]) if any_run else None,
        hota=tracking.hota if tracking else None,
        det_a=tracking.det_a if tracking else None,
        ass_a=tracking.ass_a if tracking else None,
        idf1=float(scores["idf1"]) if any_truth or any_run else None,
        mota=float(scores["mota"]) if any_truth else None,
        id_switches=int(scores["num_switches"]),
        geolocation_median_m=float(np.median(away)) if len(away) else None,
        geolocation_p95_m=float(np.percentile(away, 95)) if len(away) else None,
        speed_rmse_mps=float(np.sqrt(np.mean(speed**2))) if len(speed) else None,
        speed_bias_mps=float(np.mean(speed)) if len(speed) else None,
        along_bias_m=float(np.median(aside[:, 0])) if len(aside) else None,
        left_bias_m=float(np.median(aside[:, 1])) if len(aside) else None,
    )


def _matched_rows(
    accumulator: motmetrics.MOTAccumulator, truth: Seen, run: Seen
) -> tuple[Ints, Ints]:
    """Return the rows of the truth and of the run that the library paired."""
    events = accumulator.mot_events
    events = events[events.Type.isin(["MATCH", "SWITCH"])]
    instant = events.index.get_level_values("FrameId").to_numpy(dtype=np.int64)
    ours = _rows_of(truth, instant, events.OId.to_numpy(dtype=np.int64))
    return ours, _rows_of(run, instant, events.HId.to_numpy(dtype=np.int64))


def _rows_of(seen: Seen, instant: Ints, vehicle: Ints) -> Ints:
    names = int(seen.vehicle.max(initial=0)) + 1
    key = seen.instant * names + seen.vehicle
    order = np.argsort(key)
    return np.asarray(order[np.searchsorted(key, instant * names + vehicle, sorter=order)])


def _similarities(truth: Seen, run: Seen, pairing: Pairing, gate_m: float) -> Similarities:
    similarity = np.clip(1 - pairing.distance_m / gate_m, 0.0, 1.0)
    return Similarities(truth.vehicle[pairing.truth], run.vehicle[pairing.run], similarity)
