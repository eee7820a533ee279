"""What is drawn over a picture in the browser, as numbers in the picture's own pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from queuetail.geo.ground import enu_to_px
from queuetail.live.records import Published
from queuetail.sinks.overlay import SHOULDER_M, axis_stations, road_edges_m
from queuetail.traffic.road import place
from queuetail.types import (
    Approach,
    EndOfQueue,
    Floats,
    GroundMapping,
    Observation,
    QueueState,
    QueueStatus,
    TrackState,
)

LINE_STEP_M = 5.0
TICK_STEPS = (10.0, 25.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)  # metres or feet
M_PER_FT = 0.3048
TICKS = 16  # about so many in view
REACH = 1.0  # how many picture widths beyond its edge a line is worth sending


def drawing(published: Published) -> dict[str, Any]:
    """Return boxes, lanes, stations and ends of queue of one answer."""
    observation = published.observation
    size = published.frame.size if published.frame is not None else None
    found: dict[str, Any] = {
        "size": size,
        "boxes": _boxes(observation),
        "lanes": [],
        "ticks": [],
        "ticks_ft": [],
        "ends": [],
        "H_ref": np.round(observation.registration.H_ref_frame, 9).ravel().tolist(),
        "epoch": observation.registration.epoch,
    }
    mapping = observation.mapping
    if size is None or not isinstance(mapping, GroundMapping):
        return found
    by_name = {a.name: a for a in observation.approaches}
    for approach in observation.approaches:
        found["lanes"] += _lanes(approach, mapping, size)
        found["ticks"] += _ticks(approach, mapping, size, 1.0)
        found["ticks_ft"] += _ticks(approach, mapping, size, M_PER_FT)
    for state in observation.states:
        if state.eoq is not None and state.approach in by_name:
            found["ends"].append(_end(state, state.eoq, by_name[state.approach], mapping))
    return found


def _boxes(observation: Observation) -> list[list[Any]]:
    """Return [id, kind, x, y, width, height, speed, u, v] of each vehicle that is believed."""
    vehicles, tracks = observation.vehicles, observation.vehicles.tracks
    last = {s.eoq.track_id for s in observation.states if s.eoq is not None}
    found = []
    for i in range(len(tracks)):
        if tracks.states[i] is TrackState.TENTATIVE:
            continue
        queued = bool(vehicles.queued[i])
        kind = "end" if queued and int(tracks.ids[i]) in last else "queued" if queued else "moving"
        numbers = [*tracks.boxes_px[i], vehicles.speed_mps[i], *tracks.px[i]]
        coasting = tracks.states[i] is TrackState.COASTING
        found.append([int(tracks.ids[i]), kind, coasting, *_rounded(numbers)])
    return found


def _lanes(
    approach: Approach, mapping: GroundMapping, size: tuple[int, int]
) -> list[dict[str, Any]]:
    stations = axis_stations(approach, LINE_STEP_M)
    edges = road_edges_m(approach)
    found = []
    for i, offset_m in enumerate(edges):
        px = enu_to_px(mapping, place(approach, stations, np.full(len(stations), offset_m)))
        inner = 0 < i < len(edges) - 1
        found += [{"dashed": inner, "px": line} for line in _visible(px, size)]
    return found


def _visible(px: Floats, size: tuple[int, int]) -> list[list[list[float]]]:
    """Return the parts of a line that are in or near the picture."""
    near = _near(px, size)
    near[1:] |= near[:-1].copy()  # a part goes on to the first point outside
    near &= np.isfinite(px).all(axis=1)
    parts, begin = [], None
    for i, is_in in enumerate([*near.tolist(), False]):
        if is_in and begin is None:
            begin = i
        elif not is_in and begin is not None:
            if i - begin > 1:
                parts.append(np.round(px[begin:i], 1).tolist())
            begin = None
    return parts


def _near(px: Floats, size: tuple[int, int]) -> Any:
    width, height = size
    reach = REACH * width
    with np.errstate(invalid="ignore"):
        return (
            (px[:, 0] > -reach)
            & (px[:, 0] < width + reach)
            & (px[:, 1] > -reach)
            & (px[:, 1] < height + reach)
        )


def _ticks(
    approach: Approach, mapping: GroundMapping, size: tuple[int, int], unit_m: float
) -> list[dict[str, Any]]:
    """Return stations at round numbers of a unit across the road: [[u, v], [u, v]] and text."""
    stations = axis_stations(approach, LINE_STEP_M)
    px = enu_to_px(mapping, place(approach, stations, np.zeros(len(stations))))
    with np.errstate(invalid="ignore"):
        inside = ((px >= 0) & (px <= np.array(size))).all(axis=1)
    if not inside.any():
        return []
    low, high = float(stations[inside].min()) / unit_m, float(stations[inside].max()) / unit_m
    step = next((s for s in TICK_STEPS if (high - low) / s <= TICKS), TICK_STEPS[-1])
    rounds = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    at_m = rounds * unit_m
    right = float(road_edges_m(approach)[-1])
    ends = [
        enu_to_px(mapping, place(approach, at_m, np.full(len(at_m), offset)))
        for offset in (right, right - 2 * SHOULDER_M)
    ]
    return [
        {"text": f"{s:.0f}", "px": np.round([ends[0][i], ends[1][i]], 1).tolist()}
        for i, s in enumerate(rounds.tolist())
        if np.isfinite([ends[0][i], ends[1][i]]).all()
    ]


def _end(
    state: QueueState, eoq: EndOfQueue, approach: Approach, mapping: GroundMapping
) -> dict[str, Any]:
    """Return the bar across all lanes, and those one sigma to either side."""
    sides = np.array([SHOULDER_M, road_edges_m(approach)[-1] - SHOULDER_M])
    bars = []
    for shift_m in (0.0, -eoq.sigma_m, eoq.sigma_m):
        at = np.full(2, eoq.station_m + shift_m)
        px = enu_to_px(mapping, place(approach, at, sides))
        bars.append(np.round(px, 1).tolist() if np.isfinite(px).all() else None)
    return {
        "approach": state.approach,
        "beyond": state.status is QueueStatus.BEYOND_VIEW,
        "station_m": round(eoq.station_m, 2),
        "sigma_m": round(eoq.sigma_m, 2),
        "bar": bars[0],
        "sigma": [b for b in bars[1:] if b is not None],
    }


def _rounded(numbers: list[float]) -> list[float | None]:
    return [round(float(v), 2) if np.isfinite(v) else None for v in numbers]
