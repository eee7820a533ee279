"""evaluate: a run's files against the truth's files, put together from the metrics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from queuetail.errors import InputError
from queuetail.evaluate.approach import PlacedRun, place_run, site_approach
from queuetail.evaluate.eoq import judge_answers, summarise, tolerant_errors
from queuetail.evaluate.episodes import judge_episodes
from queuetail.evaluate.files import RunData, TruthData, frame_size, read_run, read_truth
from queuetail.evaluate.records import Answer, Evaluation, Span, Timeline, Truth, VehicleFigures
from queuetail.evaluate.vehicles import Seen, interpolate, judge_vehicles, near_edge, pair_up
from queuetail.geo.earth import enu_from_geodetic
from queuetail.types import Bools, Floats, Ints

GATE_M = 3.0
NO_ANSWER_AFTER_S = 0.25  # a time farther than this from every row of the run has no answer
SHOULDER_M = 2.0
REACH_WITHOUT_SITE_M = 15.0


def evaluate(run_dir: Path, truth_dir: Path, gate_m: float = GATE_M) -> Evaluation:
    """Measure a run against the truth of its flight; docs/evaluation.md defines every figure.

    `gate_m` is the distance within which a vehicle of the run may be one of the truth's.  Raises
    InputError where files are missing or garbled, or the two are not of the same flight.
    """
    run, truth = read_run(run_dir), read_truth(truth_dir)
    size = frame_size(run, truth_dir)
    placed = place_run(run, truth)
    span = _common_span(run, truth)
    state = truth_states(truth, size)
    timeline = _timeline(run, truth, placed, state, span)
    return Evaluation(
        run=run_dir.resolve().name,
        truth=truth_dir.resolve().name,
        approach=placed.choice,
        span=span,
        strict=summarise(timeline.strict_m, timeline.run_sigma_m),
        tolerant=summarise(timeline.tolerant_m, timeline.run_sigma_m),
        eoq_left_bias_m=_median_offset(timeline),
        answers=judge_answers(
            timeline.t_s, timeline.answer, timeline.truth, truth.eoq.numbers["t_s"], state
        ),
        episodes=judge_episodes(timeline.t_s, timeline.answer, timeline.truth),
        vehicles=_vehicles(run, truth, placed, span, size, gate_m),
        timeline=timeline,
    )


def truth_states(truth: TruthData, size: tuple[int, int] | None) -> Ints:
    """Return a Truth code for each row of truth.csv.

    There is a queue where the row gives its end.  An end out of view is beyond it where the picture
    shows a vehicle farther downstream, and hidden where it does not, or where it is in the picture
    all the same (behind a bridge).
    """
    eoq, vehicles = truth.eoq.numbers, truth.vehicles.numbers
    queue = np.isfinite(eoq["eoq_station_m"])
    in_view = queue & (eoq["in_view"] == 1)
    px = np.column_stack([eoq["eoq_u_px"], eoq["eoq_v_px"]])
    frame = size if size is not None else (0, 0)
    obscured = np.asarray(((px >= 0) & (px < frame)).all(axis=1))
    outside = near_edge(np.column_stack([vehicles["u_px"], vehicles["v_px"]]), size)
    ticks, index = np.unique(vehicles["t_s"][~outside], return_inverse=True)
    front = np.full(len(ticks), -np.inf)
    np.maximum.at(front, index, vehicles["station_m"][~outside])
    nearest = nearest_rows(ticks, eoq["t_s"], NO_ANSWER_AFTER_S)
    front = np.where(nearest >= 0, np.append(front, -np.inf)[nearest], -np.inf)
    beyond = queue & ~in_view & ~obscured & (front > eoq["eoq_station_m"])
    return np.select(
        [in_view, beyond, queue], [Truth.IN_VIEW, Truth.BEYOND_VIEW, Truth.HIDDEN], Truth.FREE
    ).astype(np.int64)


def nearest_rows(t_s: Floats, at_s: Floats, within_s: float) -> Ints:
    """Return for each time the row of increasing `t_s` nearest to it, −1 where none is near."""
    if not len(t_s):
        return np.full(len(at_s), -1)
    after = np.clip(np.searchsorted(t_s, at_s), 1, max(len(t_s) - 1, 1))
    after = np.minimum(after, len(t_s) - 1)
    before = np.maximum(after - 1, 0)
    row = np.where(at_s - t_s[before] <= t_s[after] - at_s, before, after)
    return np.where(np.abs(t_s[row] - at_s) <= within_s + 1e-6, row, -1)


def _common_span(run: RunData, truth: TruthData) -> Span:
    run_t_s, truth_t_s = run.queue.numbers["t_s"], truth.eoq.numbers["t_s"]
    start = max(run_t_s.min(), truth_t_s[0])
    end = min(run_t_s.max(), truth_t_s[-1])
    inside = _inside(truth_t_s, start, end)
    if not inside.any():
        raise InputError(
            f"the run ({run_t_s.min():g}–{run_t_s.max():g} s) and the truth ({truth_t_s[0]:g}–"
            f"{truth_t_s[-1]:g} s) have no time in common: are they of the same flight?"
        )
    return Span(float(start), float(end), float(inside.mean()))


def _inside(t_s: Floats, start_s: float, end_s: float) -> Bools:
    return np.asarray((t_s >= start_s - 0.01) & (t_s <= end_s + 0.01))


def _timeline(
    run: RunData, truth: TruthData, placed: PlacedRun, state: Ints, span: Span
) -> Timeline:
    truth_t_s, station = truth.eoq.numbers["t_s"], truth.eoq.numbers["eoq_station_m"]
    rows = np.flatnonzero(_chosen(run.queue.texts["approach"], placed.choice.name))
    rows = rows[np.argsort(run.queue.numbers["t_s"][rows], kind="stable")]
    run_t_s = run.queue.numbers["t_s"][rows]
    inside = _inside(truth_t_s, span.start_s, span.end_s)
    t_s = truth_t_s[inside]
    nearest = nearest_rows(run_t_s, t_s, _patience_s(run_t_s))

    def of_run(values: Floats, nothing: float) -> Floats:
        return np.where(nearest >= 0, np.append(values[rows], nothing)[nearest], nothing)

    answer = of_run(run.answer.astype(float), Answer.NONE).astype(np.int64)
    queued = answer == Answer.QUEUED
    run_station = np.where(queued, of_run(placed.queue.station_m, np.nan), np.nan)
    run_offset = np.where(queued, of_run(placed.queue.offset_m, np.nan), np.nan)
    visible = np.where(state == Truth.IN_VIEW, station, np.nan)
    strict = run_station - visible[inside]
    tolerant = tolerant_errors(t_s, run_station, truth_t_s, visible)
    return Timeline(
        t_s=t_s,
        truth=state[inside],
        truth_station_m=station[inside],
        answer=answer,
        run_station_m=run_station,
        run_offset_m=run_offset,
        run_sigma_m=of_run(run.queue.numbers["eoq_sigma_m"], np.nan),
        strict_m=strict,
        tolerant_m=np.where(np.isfinite(strict), tolerant, np.nan),  # the same samples
    )


def _patience_s(run_t_s: Floats) -> float:
    """Return how far from a row of the run its answer holds: more for runs with few frames."""
    if len(run_t_s) < 2:
        return NO_ANSWER_AFTER_S
    return max(NO_ANSWER_AFTER_S, 0.6 * float(np.median(np.diff(run_t_s))))


def _chosen(names: tuple[str, ...], name: str | None) -> Bools:
    return np.array([name is not None and n == name for n in names], dtype=np.bool_)


def _median_offset(timeline: Timeline) -> float | None:
    offset = timeline.run_offset_m[np.isfinite(timeline.run_offset_m)]
    return float(np.median(offset)) if len(offset) else None


def _vehicles(
    run: RunData,
    truth: TruthData,
    placed: PlacedRun,
    span: Span,
    size: tuple[int, int] | None,
    gate_m: float,
) -> VehicleFigures:
    frames = np.unique(np.concatenate([run.queue.numbers["t_s"], run.tracks.numbers["t_s"]]))
    ticks = np.unique(truth.vehicles.numbers["t_s"])
    ticks = ticks[_inside(ticks, span.start_s, span.end_s)]
    frame = nearest_rows(frames, ticks, _patience_s(frames))
    at_s = np.unique(np.where(frame >= 0, frames[frame], ticks))
    ours = _truth_seen(truth, at_s, size)
    theirs = _run_seen(run, truth, placed, at_s, size)
    return judge_vehicles(ours, theirs, pair_up(ours, theirs, len(at_s), gate_m), gate_m)


def _truth_seen(truth: TruthData, at_s: Floats, size: tuple[int, int] | None) -> Seen:
    rows = truth.vehicles.numbers
    _, vehicle = np.unique(np.array(truth.vehicles.texts["vehicle_id"], str), return_inverse=True)
    east_north = enu_from_geodetic(rows["lat"], rows["lon"], truth.axis.origin)
    names = ("station_m", "offset_m", "speed_mps", "u_px", "v_px")
    values = np.column_stack([east_north, *(rows[name] for name in names)])
    instant, who, found = interpolate(rows["t_s"], vehicle.astype(np.int64), values, at_s)
    right, left = _lanes_m(truth)  # what stands beside them may be found, but is no traffic
    beside = (found[:, 3] > left) | (found[:, 3] < right)
    optional = beside | near_edge(found[:, 5:7], size)
    return Seen(instant, who, found[:, :2], found[:, 2:4], found[:, 4], optional)


def _run_seen(
    run: RunData, truth: TruthData, placed: PlacedRun, at_s: Floats, size: tuple[int, int] | None
) -> Seen:
    rows = run.tracks.numbers
    instant = nearest_rows(at_s, rows["t_s"], 1e-3)
    keep = np.flatnonzero((instant >= 0) & np.isfinite(placed.tracks.enu).all(axis=1))
    keep = keep[np.argsort(instant[keep], kind="stable")]
    _, vehicle = np.unique(np.array(run.tracks.texts["track_id"], str), return_inverse=True)
    _require_one_place_each(run, instant[keep], vehicle[keep], keep)
    offset = placed.tracks.offset_m[keep]
    right, left = _lanes_m(truth)
    aside = (offset > left + SHOULDER_M) | (offset < right - SHOULDER_M)
    px = np.column_stack([rows["u_px"], rows["v_px"]])[keep]
    others = np.isin(np.array(run.tracks.texts["approach"], str)[keep], list(placed.choice.others))
    return Seen(
        instant[keep],
        vehicle[keep].astype(np.int64),
        placed.tracks.enu[keep],
        np.column_stack([placed.tracks.station_m[keep], offset]),
        rows["speed_mps"][keep],
        aside | others | near_edge(px, size),
    )


def _require_one_place_each(run: RunData, instant: Ints, vehicle: Ints, rows: Ints) -> None:
    key = instant * (int(vehicle.max(initial=0)) + 1) + vehicle
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    if (count > 1).any():
        row = rows[first[np.argmax(count > 1)]]
        raise InputError(
            f"tracks.csv: track {run.tracks.texts['track_id'][row]} is in two places at "
            f"{run.tracks.numbers['t_s'][row]:g} s"
        )


def _lanes_m(truth: TruthData) -> tuple[float, float]:
    """Return the offsets of the right and left edges of the truth's lanes, or wide guesses."""
    site = site_approach(truth)
    if site is None:
        return -REACH_WITHOUT_SITE_M, REACH_WITHOUT_SITE_M
    return -site.lanes * site.lane_width_m, 0.0
