"""Linear referencing: ENU metres ↔ station, offset and lane of an approach."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from queuetail.types import (
    Approach,
    Bools,
    Floats,
    Frame,
    GroundMapping,
    Ints,
    Registration,
    RoadVehicles,
    Tracks,
)

EDGE_MARGIN_M = 1.75  # half a lane: a wheel over the edge line is still on the approach
END_MARGIN_M = 20.0  # a drawn axis ends about where its author looked, not to the metre


def locate(approach: Approach, enu: Floats) -> tuple[Floats, Floats, Floats]:
    """Return station, offset (metres to the left) and course (unit vectors) at points (n, 2).

    Beyond its ends the axis goes on straight.
    """
    axis = approach.axis_enu
    starts, lengths, units = _legs(approach)
    starts = approach.start_station_m + starts
    east, north = (enu[:, i, None] - axis[:-1, i] for i in (0, 1))  # (n, legs)
    along = east * units[:, 0] + north * units[:, 1]
    aside = north * units[:, 0] - east * units[:, 1]
    lower, upper = np.zeros(len(lengths)), lengths.copy()
    lower[0], upper[-1] = -np.inf, np.inf
    clipped = np.clip(along, lower, upper)
    nearest = np.argmin(aside**2 + (along - clipped) ** 2, axis=1)
    rows = np.arange(len(enu))
    return starts[nearest] + clipped[rows, nearest], aside[rows, nearest], units[nearest]


def length_m(approach: Approach) -> float:
    """Return how long the axis is, in metres."""
    starts, lengths, _ = _legs(approach)
    return float(starts[-1] + lengths[-1])


def place(approach: Approach, station_m: Floats, offset_m: Floats) -> Floats:
    """Return the ENU points at stations and offsets, (n,), (n,) -> (n, 2); inverse of `locate`."""
    axis = approach.axis_enu
    starts, _, units = _legs(approach)
    along = np.asarray(station_m) - approach.start_station_m
    leg = np.maximum(np.searchsorted(starts, along, side="right") - 1, 0)
    unit = units[leg]
    left = np.column_stack([-unit[:, 1], unit[:, 0]])
    return np.asarray(
        axis[leg] + (along - starts[leg])[:, None] * unit + np.asarray(offset_m)[:, None] * left
    )


def assign(tracks: Tracks, approaches: Sequence[Approach]) -> RoadVehicles:
    """Put every track on the approach and lane that it is on, if any.

    What lies more than END_MARGIN_M beyond either end of an axis is not on its approach.
    """
    n = len(tracks)
    chosen: Ints = np.full(n, -1)
    lane: Ints = np.zeros(n, np.int64)
    station, offset, speed = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    excess = np.full(n, np.inf)
    for index, approach in enumerate(approaches):
        s, d, course = locate(approach, tracks.enu)
        along = (tracks.velocity_mps * course).sum(axis=1)
        width = approach.lanes * approach.lane_width_m
        outside = np.maximum(np.maximum(d, -width - d), 0.0)
        # A vehicle that drives the other way fits its own carriageway better, if there is one.
        wrong_way = along < -1.0
        on_it = (outside <= EDGE_MARGIN_M) & _between_ends(approach, s)
        better = on_it & (outside + 10.0 * wrong_way < excess)
        chosen[better], excess[better] = index, (outside + 10.0 * wrong_way)[better]
        station[better], offset[better], speed[better] = s[better], d[better], along[better]
        lane[better] = _lane(d[better], approach)
    return RoadVehicles(
        tracks=tracks,
        approach=chosen,
        lane=lane,
        station_m=station,
        offset_m=offset,
        speed_mps=speed,
        rear_station_m=station - tracks.length_m / 2,
        queued=np.zeros(n, np.bool_),
    )


class KnownRoad:
    """A road whose approaches are given, as by a site file."""

    def __init__(self, approaches: tuple[Approach, ...]) -> None:
        self.approaches = approaches

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing that a user should know."""
        return ()

    def look(self, frame: Frame, mapping: GroundMapping, registration: Registration) -> None:
        """Learn nothing: the road is known."""

    def locate(self, tracks: Tracks) -> RoadVehicles:
        """Return the tracks on the approaches."""
        return assign(tracks, self.approaches)


def is_on(vehicles: RoadVehicles, approach_index: int) -> Bools:
    """Return which vehicles are on one approach."""
    return np.asarray(vehicles.approach == approach_index)


@lru_cache(maxsize=64)
def _legs(approach: Approach) -> tuple[Floats, Floats, Floats]:
    """Return where each leg of the axis starts, how long it is, and its unit vector (k − 1, 2)."""
    legs = np.diff(approach.axis_enu, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    return np.concatenate([[0.0], np.cumsum(lengths)[:-1]]), lengths, legs / lengths[:, None]


def _between_ends(approach: Approach, station_m: Floats) -> Bools:
    along_m = station_m - approach.start_station_m
    end_m = length_m(approach) + END_MARGIN_M
    return np.asarray((along_m >= -END_MARGIN_M) & (along_m <= end_m))


def _lane(offset_m: Floats, approach: Approach) -> Ints:
    lane = np.floor(-offset_m / approach.lane_width_m).astype(np.int64) + 1
    return np.clip(lane, 1, approach.lanes)
