"""A run on the truth's axis: where its answers and vehicles are, and which approach is meant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.config import ApproachSite
from queuetail.errors import InputError
from queuetail.evaluate.axis import Axis, enu_at, locate_geodetic, nearest_m
from queuetail.evaluate.files import RunData, TruthData
from queuetail.evaluate.records import ApproachChoice
from queuetail.types import Bools, Floats

OTHER_FLIGHT_M = 1000.0
AXIS_KEYS = {"name", "start_station_m", "axis", "axis_enu_m"}  # what stations are counted by
OTHER_ROAD_M = 25.0  # farther aside than any lane of the same carriageway, errors included
MAX_PROBES = 5000  # positions looked at to tell whether it is the same flight


@dataclass(frozen=True, slots=True)
class Placed:
    """Rows of a run located on the truth's axis; NaN where a row has no position."""

    station_m: Floats
    offset_m: Floats
    enu: Floats  # (n, 2)


@dataclass(frozen=True, slots=True)
class PlacedRun:
    """queue.csv and tracks.csv of a run on the truth's axis."""

    queue: Placed
    tracks: Placed
    choice: ApproachChoice


def place_run(run: RunData, truth: TruthData) -> PlacedRun:
    """Locate a run on the truth's axis and choose its approach; raises InputError if it cannot."""
    queue, tracks = run.queue.numbers, run.tracks.numbers
    lat = np.concatenate([queue["eoq_lat"], tracks["lat"]])
    lon = np.concatenate([queue["eoq_lon"], tracks["lon"]])
    known = np.isfinite(lat) & np.isfinite(lon)
    if known.any():
        _require_same_flight(truth.axis, lat[known], lon[known])
        placed = (
            Placed(*locate_geodetic(truth.axis, queue["eoq_lat"], queue["eoq_lon"])),
            Placed(*locate_geodetic(truth.axis, tracks["lat"], tracks["lon"])),
        )
    else:
        placed = _by_station(run, truth)
    return PlacedRun(*placed, _choose(run, truth, *placed))


def site_approach(truth: TruthData) -> ApproachSite | None:
    """Return the approach of the truth's site file that lies on its axis and goes its way."""
    if truth.site is None:
        return None
    approaches = truth.site.approach
    located = [(_aside_m(a, truth.axis), a) for a in approaches if a.axis is not None]
    if not located:
        return approaches[0] if len(approaches) == 1 else None
    aside_m, nearest = min(located, key=lambda pair: pair[0])
    return nearest if aside_m < OTHER_ROAD_M else None


def _aside_m(approach: ApproachSite, axis: Axis) -> float:
    """Return the median distance of an approach's points from the axis, inf where it goes back."""
    lat, lon = np.asarray(approach.axis, float).T
    station, offset, _ = locate_geodetic(axis, lat, lon)
    return float(np.median(np.abs(offset))) if station[-1] > station[0] else np.inf


def _require_same_flight(axis: Axis, lat: Floats, lon: Floats) -> None:
    step = len(lat) // MAX_PROBES + 1
    away_m = nearest_m(axis, lat[::step], lon[::step])
    if away_m > OTHER_FLIGHT_M + float(np.diff(axis.metres).max()):
        raise InputError(
            f"the run's nearest position is {away_m / 1000:.1f} km from the truth's road: "
            "the run and the truth are of different flights"
        )


def _by_station(run: RunData, truth: TruthData) -> tuple[Placed, Placed]:
    """Take the run's own stations, which is right only where its axis is the truth's."""
    queue, tracks = run.queue.numbers, run.tracks.numbers
    stations = np.concatenate([queue["eoq_station_m"], tracks["station_m"]])
    if np.isfinite(stations).any() and not _has_axis_of(run, truth):
        raise InputError(
            "the run has stations but no latitudes and longitudes, and its axis is not known to be "
            "the truth's: run it with the site.toml of the truth, or with telemetry"
        )
    station, zero = queue["eoq_station_m"], np.zeros(len(queue["eoq_station_m"]))
    offset = np.where(np.isfinite(station), zero, np.nan)
    return (
        Placed(station, offset, enu_at(truth.axis, station, offset)),
        Placed(
            tracks["station_m"],
            tracks["offset_m"],
            enu_at(truth.axis, tracks["station_m"], tracks["offset_m"]),
        ),
    )


def _has_axis_of(run: RunData, truth: TruthData) -> bool:
    """Return whether run.json holds the very approach of the truth's site file."""
    site, settings = site_approach(truth), run.about.get("settings")
    if site is None or not isinstance(settings, dict):
        return False
    axis = site.model_dump(mode="json", include=AXIS_KEYS)
    return any(
        {key: approach.get(key) for key in AXIS_KEYS} == axis
        for approach in settings.get("approach", [])
    )


def _choose(run: RunData, truth: TruthData, queue: Placed, tracks: Placed) -> ApproachChoice:
    names = list(dict.fromkeys(name for name in run.queue.texts["approach"] if name))
    site = site_approach(truth)
    if site is not None and site.name in names:
        return _choice(site.name, "it has the name of the truth's approach", names)
    if not names:
        return ApproachChoice("", "the run names no approach", ())
    fits = {name: _aside_of(name, run, queue, tracks) for name in names}
    best = min(names, key=lambda name: np.nan_to_num(fits[name], nan=np.inf))
    if fits[best] <= OTHER_ROAD_M:
        why = f"it goes the truth's way, {fits[best]:.1f} m aside of its axis (median)"
        return _choice(best, why, names)
    silent = [name for name in names if np.isnan(fits[name])]
    if silent == names and len(names) == 1:
        return _choice(names[0], "it is the only one, and it has no positions", names)
    why = "no approach of the run lies on the truth's axis and goes its way"
    return ApproachChoice(None, why, tuple(names))


def _choice(name: str, why: str, names: Sequence[str]) -> ApproachChoice:
    return ApproachChoice(name, why, tuple(other for other in names if other != name))


def _aside_of(name: str, run: RunData, queue: Placed, tracks: Placed) -> float:
    """Return the median distance from the axis, NaN without positions, inf where it goes back."""
    answers, vehicles = (
        _is(run.queue.texts["approach"], name),
        _is(run.tracks.texts["approach"], name),
    )
    offset = np.concatenate([queue.offset_m[answers], tracks.offset_m[vehicles]])
    offset = offset[np.isfinite(offset)]
    if not len(offset):
        return np.nan
    gone_m = _progress_m(run.tracks.texts["track_id"], tracks.station_m, vehicles)
    return float(np.median(np.abs(offset))) if gone_m >= 0 else np.inf


def _progress_m(ids: tuple[str, ...], station_m: Floats, rows: Bools) -> float:
    """Return how far all tracks together went along the axis; rows are in order of time."""
    first: dict[str, float] = {}
    last: dict[str, float] = {}
    for i in np.flatnonzero(rows & np.isfinite(station_m)).tolist():
        first.setdefault(ids[i], station_m[i])
        last[ids[i]] = station_m[i]
    return float(sum(last[key] - first[key] for key in first))


def _is(names: tuple[str, ...], name: str) -> Bools:
    return np.array([n == name for n in names], dtype=np.bool_)
