"""Steps of brightness beside the lanes, of which one is where the asphalt ends."""

from __future__ import annotations

import numpy as np

from queuetail.traffic.lane_evidence import NO_VEHICLE, WANDER_M, WINDOW_M, LaneEvidence
from queuetail.traffic.road import locate, place
from queuetail.traffic.verges import LEFT, NO_VERGES, RIGHT, Verges
from queuetail.types import Approach, Bools, Floats

INSIDE_M = 3.0  # of the lanes' edges, as far as telemetry may be off
SIDE_M = 1.0  # of what is compared on both sides of a step
MIN_LEVELS, MIN_SHARE = 3.0, 0.35  # of a step, and of the side's clearest
MOST = 4  # of a stretch, the clearest
ALIKE, MOST_ROWS = 0.3, 0.8  # of the mean step, by so many of a stretch's rows


def steps(
    approach: Approach, number: int, station_m: Floats, offset_m: Floats, level: Floats
) -> Verges:
    """Return the steps of a grid of mean brightness (rows, columns) at stations and offsets.

    `number` is the approach's; NaN is what was not seen.  Every `WINDOW_M` of road shows some.
    """
    rows = round(WINDOW_M / float(station_m[1] - station_m[0]))
    stretches = len(station_m) // rows
    if not stretches:
        return NO_VERGES
    width_m = approach.lanes * approach.lane_width_m
    inside_m = min(INSIDE_M, width_m / 2)
    at_m, clear, shown = _steps(level[: stretches * rows], rows, offset_m)
    middles_m = station_m[: stretches * rows].reshape(stretches, rows).mean(axis=1)
    found: list[tuple[float, float, int, int]] = []
    for side, beyond in ((LEFT, at_m > -inside_m), (RIGHT, at_m < inside_m - width_m)):
        for stretch in range(stretches):
            places = _clearest(at_m[beyond], clear[stretch, beyond], shown[stretch, beyond])
            found += [(middles_m[stretch], p, 2 * number + side, stretch) for p in places]
    return _verges(approach, found)


def _steps(level: Floats, rows: int, offset_m: Floats) -> tuple[Floats, Floats, Bools]:
    """Return offsets (m,), mean steps (k, m) there, and which nearly all rows of a stretch show.

    A step is between the means of `SIDE_M` on both sides; of a queue's vehicles only some rows show
    any.
    """
    n = round(SIDE_M / float(offset_m[1] - offset_m[0]))
    known = np.isfinite(level)
    sums = np.pad(np.cumsum(np.where(known, level, 0.0), axis=1), ((0, 0), (1, 0)))
    unseen = np.pad(np.cumsum(~known, axis=1), ((0, 0), (1, 0)))
    step = (sums[:, 2 * n :] - 2 * sums[:, n:-n] + sums[:, : -2 * n]) / n
    told = unseen[:, 2 * n :] == unseen[:, : -2 * n]
    step = np.where(told, step, 0.0).reshape(-1, rows, step.shape[1])
    count = told.reshape(step.shape).sum(axis=1)
    mean = step.sum(axis=1) / np.maximum(count, 1)
    alike = (step * np.sign(mean)[:, None] > ALIKE * np.abs(mean)[:, None]).sum(axis=1)
    shown = (count >= rows / 2) & (alike >= MOST_ROWS * count)
    at_m = (offset_m[n - 1 : -n] + offset_m[n : len(offset_m) - n + 1]) / 2
    return at_m, np.abs(mean), shown


def _clearest(at_m: Floats, clear: Floats, shown: Bools) -> list[float]:
    """Return the offsets of a stretch's clearest steps (m,) on one side."""
    if not len(clear):
        return []
    padded = np.pad(clear, 1)
    peak = shown & (clear >= padded[:-2]) & (clear > padded[2:])
    chosen = np.flatnonzero(peak & (clear >= max(MIN_LEVELS, MIN_SHARE * clear.max())))
    clearest = chosen[np.argsort(-clear[chosen])[:MOST]]
    return [float(m) for m in at_m[clearest]]


def _verges(approach: Approach, found: list[tuple[float, float, int, int]]) -> Verges:
    station, offset, side, stretch = np.array(found).reshape(-1, 4).T
    enu = place(approach, station, offset).reshape(-1, 2)
    seen = LaneEvidence(
        enu,
        locate(approach, enu)[2],
        np.full(len(enu), NO_VEHICLE, np.int64),
        np.full(len(enu), WINDOW_M / WANDER_M),
    )
    return Verges(seen, side.astype(np.int64), stretch.astype(np.int64))
