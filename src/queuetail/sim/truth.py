"""Exact ground truth of a simulated flight, in the files that `queuetail evaluate` reads."""

from __future__ import annotations

import csv
import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from queuetail.geo.earth import geodetic_from_enu
from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.cars import place
from queuetail.sim.flight import TruePath, View
from queuetail.sim.occluder import Occluder
from queuetail.sim.scenario import Scenario
from queuetail.sim.traffic import Traffic
from queuetail.types import Bools, Floats, Origin

HOLD_S = 1.0  # below the queue speed this long: queued; above the release speed this long: free
RELEASE_FACTOR = 1.25
COMPANION_M = 60.0  # a queued vehicle has another one within this distance downstream
ROAD_FROM_M, ROAD_TO_M, ROAD_STEP_M = VIEW_STATION_M - 500, VIEW_STATION_M + 500, 10.0
VEHICLES_HZ = 10.0
TRUTH_COLUMNS = (
    *("t_s", "queued", "eoq_station_m", "eoq_lat", "eoq_lon"),
    *("eoq_u_px", "eoq_v_px", "in_view"),
)
VEHICLE_COLUMNS = (
    *("t_s", "vehicle_id", "station_m", "offset_m", "speed_mps", "length_m"),
    *("lat", "lon", "u_px", "v_px"),
)


@dataclass(frozen=True, slots=True)
class QueueTruth:
    """Who is queued at each tick: the definition of design.md, applied to true speeds."""

    tick_s: Floats  # (k,)
    queued: Bools  # (k, n)

    def at(self, t_s: float) -> Bools:
        """Return who is queued at a time, (n,)."""
        k = np.searchsorted(self.tick_s, t_s + 1e-9, "right") - 1
        return np.asarray(self.queued[int(np.clip(k, 0, len(self.tick_s) - 1))])


def queue_truth(traffic: Traffic, queue_speed_mps: float) -> QueueTruth:
    """Apply the rule of time and speed to every vehicle on the approach."""
    ours = ~traffic.opposite & ~traffic.parked
    shape = traffic.speed_mps.shape
    queued = np.zeros(shape, bool)
    slow_since, fast_since = np.full(shape[1], np.nan), np.full(shape[1], np.nan)
    state = np.zeros(shape[1], bool)
    for k, t_s in enumerate(traffic.tick_s):
        speed = traffic.speed_mps[k]
        slow, fast = speed < queue_speed_mps, speed > RELEASE_FACTOR * queue_speed_mps
        slow_since = np.where(slow, np.where(np.isnan(slow_since), t_s, slow_since), np.nan)
        fast_since = np.where(fast, np.where(np.isnan(fast_since), t_s, fast_since), np.nan)
        state = state | (t_s - slow_since >= HOLD_S - 1e-6)
        state = state & ~(t_s - fast_since >= HOLD_S - 1e-6) & ~np.isnan(speed) & ours
        queued[k] = state
    return QueueTruth(traffic.tick_s, queued)


def end_of_queue(rear_m: Floats, queued: Bools) -> int | None:
    """Return the index of the most upstream queued vehicle with a queued one just downstream."""
    who = np.flatnonzero(queued)
    who = who[np.argsort(rear_m[who], kind="stable")]
    for first, following in itertools.pairwise(who):
        if rear_m[following] - rear_m[first] <= COMPANION_M:
            return int(first)
    return None


def write_truth(
    scenario: Scenario, traffic: Traffic, path: TruePath, times_s: Floats, out: Path
) -> None:
    """Write truth.csv, vehicles.csv and road.csv."""
    axis, origin = Axis.of(scenario.road), Origin(*scenario.scenario.origin)
    rule = queue_truth(traffic, scenario.traffic.queue_speed_mps)
    occluder = Occluder.of(scenario)
    with (out / "truth.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(TRUTH_COLUMNS)
        for t_s in times_s:
            writer.writerow(_truth_row(traffic, axis, origin, rule, path, occluder, float(t_s)))
    _write_vehicles(scenario, traffic, axis, origin, path, out / "vehicles.csv")
    _write_road(axis, origin, out / "road.csv")


def _truth_row(
    traffic: Traffic,
    axis: Axis,
    origin: Origin,
    rule: QueueTruth,
    path: TruePath,
    occluder: Occluder | None,
    t_s: float,
) -> list[object]:
    standing = place(traffic, axis, t_s)
    queued = rule.at(t_s)[standing.index]
    rear_m, _ = axis.locate(standing.rear_enu)
    last = end_of_queue(rear_m, queued)
    if last is None:
        return [f"{t_s:.3f}", int(queued.sum()), *[""] * 6]
    rear = standing.rear_enu[last : last + 1]
    lat, lon = geodetic_from_enu(rear, origin)
    view = path.view(t_s)
    px = view.ground_px(rear)
    return [
        f"{t_s:.3f}",
        int(queued.sum()),
        f"{rear_m[last]:.2f}",
        f"{lat[0]:.8f}",
        f"{lon[0]:.8f}",
        *_px_text(px[0]),
        int(_is_seen(view, px, occluder)),
    ]


def _px_text(px: Floats) -> list[str]:
    return [f"{c:.1f}" if np.isfinite(c) else "" for c in px]


def _is_seen(view: View, px: Floats, occluder: Occluder | None) -> bool:
    lens = view.pose.intrinsics
    inside = bool(((px >= 0) & (px < [lens.width_px, lens.height_px])).all())
    return inside and not (occluder is not None and bool(occluder.hides(view, px)[0]))


def _write_vehicles(
    scenario: Scenario, traffic: Traffic, axis: Axis, origin: Origin, path: TruePath, out: Path
) -> None:
    with out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(VEHICLE_COLUMNS)
        for k in range(int(scenario.scenario.duration_s * VEHICLES_HZ)):
            t_s = k / VEHICLES_HZ
            standing = place(traffic, axis, t_s)
            station, offset = axis.locate(standing.centre_enu)
            lat, lon = geodetic_from_enu(standing.centre_enu, origin)
            view = path.view(t_s)
            px = view.ground_px(standing.centre_enu)
            lens = view.pose.intrinsics
            ours = ~traffic.opposite[standing.index]
            seen = ((px >= 0) & (px < [lens.width_px, lens.height_px])).all(axis=1)
            for i in np.flatnonzero(ours & seen):
                column = standing.index[i]
                writer.writerow(
                    [
                        f"{t_s:.3f}",
                        traffic.ids[column],
                        f"{station[i]:.2f}",
                        f"{offset[i]:.2f}",
                        f"{standing.speed_mps[i]:.2f}",
                        f"{traffic.length_m[column]:g}",
                        f"{lat[i]:.8f}",
                        f"{lon[i]:.8f}",
                        *_px_text(px[i]),
                    ]
                )


def _write_road(axis: Axis, origin: Origin, out: Path) -> None:
    station, lat, lon = axis_points(axis, origin)
    lines = [f"{s:.1f},{a:.8f},{b:.8f}\n" for s, a, b in zip(station, lat, lon, strict=True)]
    out.write_text("station_m,lat,lon\n" + "".join(lines), encoding="utf-8")


def axis_points(axis: Axis, origin: Origin) -> tuple[Floats, Floats, Floats]:
    """Return station, latitude and longitude along the watched part of the axis."""
    station = np.arange(ROAD_FROM_M, ROAD_TO_M + 0.1, ROAD_STEP_M)
    lat, lon = geodetic_from_enu(axis.enu(station, np.zeros_like(station)), origin)
    return station, lat, lon
