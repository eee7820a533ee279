"""How far an axis goes: where its traffic and its lines were seen, and a bit onward."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from queuetail.traffic.centreline import onward, shift_aside, stations
from queuetail.traffic.lane_evidence import LineMarks
from queuetail.traffic.paths import Samples
from queuetail.traffic.road import length_m, locate
from queuetail.types import Approach, Floats

AXIS_POINT_M = 15.0
ONWARD_M, LINED_ONWARD_M = 45.0, 75.0  # beyond the traffic that was seen, or beyond its lines
LONGEST_GAP_M = 40.0  # in the lines


def spanned(axis: Floats, members: Samples, lines: LineMarks) -> tuple[Floats, tuple[float, float]]:
    """Cut the axis to, or lengthen it straight to, where two of its vehicles or lines were seen.

    Returns also how far it may be taken to go on at both ends: farther where lines do.
    """
    along = Approach("", axis)
    station, _, _ = locate(along, members.enu)
    at = stations(axis)
    bounds = np.flatnonzero(np.diff(members.owner, prepend=-1))
    # The second: one vehicle that leaves the road would take the axis with it.
    starts, ends = (np.sort(m.reduceat(station, bounds)) for m in (np.minimum, np.maximum))
    first, last = float(starts[min(1, len(starts) - 1)]), float(ends[max(len(ends) - 2, 0)])
    marked = np.sort(locate(along, lines.enu)[0])
    first, last = -_reach(-first, -marked[::-1]), _reach(last, marked)
    onward_m = _onward_m(first, marked), _onward_m(last, marked)
    inner = axis[(at > first + AXIS_POINT_M / 3) & (at < last - AXIS_POINT_M / 3)]
    return np.concatenate([_at(axis, at, first), inner, _at(axis, at, last)]), onward_m


def _onward_m(end_m: float, marked_m: Floats) -> float:
    """Return how far an axis may be taken to go on from its end: farther where it has lines."""
    lined = len(marked_m) > 0 and float(np.abs(marked_m - end_m).min()) < AXIS_POINT_M
    return LINED_ONWARD_M if lined else ONWARD_M


def _reach(end_m: float, marked_m: Floats) -> float:
    """Return how far lines (n,), in order, go on beyond an end without a long gap."""
    for station_m in marked_m[marked_m > end_m].tolist():
        if station_m - end_m > LONGEST_GAP_M:
            break
        end_m = station_m
    return end_m


def lengthened(
    approaches: Sequence[Approach], onward_m: Sequence[tuple[float, float]]
) -> list[Approach]:
    """Let axes go on at both ends, each so far, where no other does.

    A vehicle is followed only where all of it is in the picture, and some time after it came.
    """
    longer = []
    for approach, lengths_m in zip(approaches, onward_m, strict=True):
        others = [a for a in approaches if a is not approach]
        half_m = approach.lanes * approach.lane_width_m / 2
        axis, middle = approach.axis_enu, shift_aside(approach.axis_enu, -half_m)
        ends = []
        for way, end_m in zip((-1, 1), lengths_m, strict=True):
            free = _free(onward(middle[::way], end_m, AXIS_POINT_M), half_m, others)
            ends.append(onward(axis[::way], end_m, AXIS_POINT_M)[:free])
        axis = np.concatenate([ends[0][::-1], axis, ends[1]])
        longer.append(replace(approach, axis_enu=axis))
    return longer


def _free(middle: Floats, half_m: float, others: Sequence[Approach]) -> int:
    """Return how many points of lanes' middle (n, 2) lie before they come upon another's lanes."""
    blocked = np.zeros(len(middle), np.bool_)
    for other in others:
        station, offset, _ = locate(other, middle)
        other_half_m = other.lanes * other.lane_width_m / 2
        beside = np.abs(offset + other_half_m) < half_m + other_half_m
        blocked |= beside & (station > -ONWARD_M) & (station < length_m(other) + ONWARD_M)
    return int(np.argmax(blocked)) if blocked.any() else len(middle)


def _at(axis: Floats, at: Floats, station_m: float) -> Floats:
    leg = int(np.clip(np.searchsorted(at, station_m, side="right") - 1, 0, len(axis) - 2))
    share = (station_m - at[leg]) / (at[leg + 1] - at[leg])
    return np.asarray(axis[leg] + share * (axis[leg + 1] - axis[leg]))[None]
