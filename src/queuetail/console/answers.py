"""From what a run publishes to what the API answers."""

from __future__ import annotations

import math
from datetime import UTC, datetime

import numpy as np

from queuetail.config import Site
from queuetail.console.records import (
    ApproachState,
    EndOfQueueRecord,
    HealthRecord,
    HistoryRow,
    Outlet,
    SignDistance,
    State,
    Track,
    Tracks,
)
from queuetail.console.source import ConsoleSource, PastState
from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.live.health import unwell
from queuetail.live.records import Published
from queuetail.signs.settings import SignSite
from queuetail.traffic.road import locate
from queuetail.types import (
    Approach,
    EndOfQueue,
    GroundMapping,
    Observation,
    Origin,
    QueueState,
)

LEAST_GROWTH_MPS = 0.05  # slower than this, no time is told at which the queue reaches a sign


def state_record(published: Published | None, source: ConsoleSource) -> State:
    """Return the answer with its distances; no approaches before the first answer."""
    about = source.about
    if published is None:
        return State(number=0, utc=None, t_s=None, age_s=None, live=about.is_live, approaches=[])
    observation = published.observation
    age_s = (datetime.now(UTC) - published.utc).total_seconds() if about.is_live else None
    return State(
        number=published.number,
        utc=published.utc,
        t_s=observation.t_s,
        age_s=None if age_s is None else max(age_s, 0.0),
        live=about.is_live,
        approaches=[approach_state(s, observation, about.site) for s in observation.states],
    )


def approach_state(state: QueueState, observation: Observation, site: Site) -> ApproachState:
    """Return one approach's answer and how far the end of its queue is from what matters."""
    approach = next((a for a in observation.approaches if a.name == state.approach), None)
    origin = origin_of(observation)
    signs = []
    for sign in site.sign:
        if sign.approach not in (None, state.approach) or approach is None:
            continue
        station_m = sign_station_m(sign, approach, origin)
        if station_m is not None:
            signs.append(sign_distance(sign.name, station_m, state.eoq))
    return ApproachState(
        approach=state.approach,
        status=state.status,
        reasons=list(state.reasons),
        eoq=eoq_record(state.eoq) if state.eoq is not None else None,
        signs=signs,
        taper_distance_m=taper_distance_m(state, site),
    )


def taper_distance_m(state: QueueState, site: Site) -> float | None:
    """Return how far the taper lies downstream of the end of the queue, if both are known."""
    tapers = (a.taper_station_m for a in site.approach if a.name == state.approach)
    taper_m = next(tapers, None)
    return None if state.eoq is None or taper_m is None else taper_m - state.eoq.station_m


def sign_distance(name: str, station_m: float, eoq: EndOfQueue | None) -> SignDistance:
    """Return how far the queue's end is from a sign, and when it gets there at its growth."""
    if eoq is None:
        return SignDistance(name=name, station_m=station_m, distance_m=None, reached_in_s=None)
    distance_m = eoq.station_m - station_m
    growth = eoq.growth_mps
    grows = growth is not None and growth > LEAST_GROWTH_MPS and distance_m > 0
    return SignDistance(
        name=name,
        station_m=station_m,
        distance_m=distance_m,
        reached_in_s=distance_m / growth if grows and growth is not None else None,
    )


def sign_station_m(sign: SignSite, approach: Approach, origin: Origin | None) -> float | None:
    """Return a sign's station; None where its place cannot be put on the road."""
    if sign.station_m is not None:
        return sign.station_m
    if sign.at is None or origin is None:
        return None
    enu = enu_from_geodetic(np.array([sign.at[0]]), np.array([sign.at[1]]), origin)
    return float(locate(approach, enu)[0][0])


def eoq_record(eoq: EndOfQueue) -> EndOfQueueRecord:
    """Return an end of queue for JSON."""
    return EndOfQueueRecord(
        station_m=eoq.station_m,
        sigma_m=eoq.sigma_m,
        lat_deg=eoq.lat_deg,
        lon_deg=eoq.lon_deg,
        u_px=known(eoq.px[0]),
        v_px=known(eoq.px[1]),
        length_m=eoq.length_m,
        vehicles=eoq.vehicles,
        growth_mps=known(eoq.growth_mps),
    )


def tracks_record(published: Published | None) -> Tracks:
    """Return every vehicle of an answer."""
    if published is None:
        return Tracks(number=0, utc=None, t_s=None, tracks=[])
    observation = published.observation
    vehicles, tracks = observation.vehicles, observation.vehicles.tracks
    origin = origin_of(observation)
    places = np.full((len(tracks), 2), np.nan)
    if origin is not None and len(tracks):
        places = np.column_stack(geodetic_from_enu(tracks.enu, origin))
    found = []
    for i in range(len(tracks)):
        index = int(vehicles.approach[i])
        box = [round(float(v), 1) for v in tracks.boxes_px[i]]
        found.append(
            Track(
                track_id=int(tracks.ids[i]),
                state=tracks.states[i].value,
                approach=observation.approaches[index].name if index >= 0 else "",
                lane=int(vehicles.lane[i]) or None,
                lat_deg=known(places[i, 0], 7),
                lon_deg=known(places[i, 1], 7),
                station_m=known(vehicles.station_m[i], 2),
                offset_m=known(vehicles.offset_m[i], 2),
                speed_mps=known(vehicles.speed_mps[i], 2),
                length_m=known(tracks.length_m[i], 2),
                queued=bool(vehicles.queued[i]),
                u_px=known(tracks.px[i, 0], 1),
                v_px=known(tracks.px[i, 1], 1),
                box_px=box if all(map(math.isfinite, box)) else None,
            )
        )
    return Tracks(number=published.number, utc=published.utc, t_s=observation.t_s, tracks=found)


def history_row(past: PastState) -> HistoryRow:
    """Return one past answer."""
    state, eoq = past.state, past.state.eoq
    return HistoryRow(
        number=past.number,
        utc=past.utc,
        t_s=past.t_s,
        approach=state.approach,
        status=state.status,
        reasons=list(state.reasons),
        station_m=eoq.station_m if eoq else None,
        sigma_m=eoq.sigma_m if eoq else None,
        lat_deg=eoq.lat_deg if eoq else None,
        lon_deg=eoq.lon_deg if eoq else None,
        length_m=eoq.length_m if eoq else None,
        growth_mps=known(eoq.growth_mps) if eoq else None,
    )


def health_of(source: ConsoleSource) -> HealthRecord:
    """Return how the run is; a finished one is well."""
    health, newest, about = source.health(), source.newest(), source.about
    problems = unwell(newest, health) if about.is_live else ()
    return HealthRecord(
        ok=not problems,
        problems=list(problems),
        live=about.is_live,
        video=about.video,
        preset=about.preset,
        frame_age_s=health.frame_age_s,
        telemetry_age_s=health.telemetry_age_s,
        telemetry_rate_hz=health.telemetry_rate_hz,
        registration=health.registration,
        frames_captured=health.frames_captured,
        frames_processed=health.frames_processed,
        frames_dropped=health.frames_dropped,
        reconnects=health.reconnects,
        frame_rate_hz=health.frame_rate_hz,
        latency_p50_ms=health.latency_p50_ms,
        latency_p99_ms=health.latency_p99_ms,
        memory_mb=health.memory_mb,
        disk_free_mb=health.disk_free_mb,
        outlets=[
            Outlet(
                name=o.name,
                state=o.state.value,
                delivered=o.delivered,
                dropped=o.dropped,
                waiting=o.waiting,
                last_error=o.last_error,
                delivery_age_s=o.delivery_age_s,
            )
            for o in health.outlets
        ],
        warnings=list(health.warnings),
    )


def origin_of(observation: Observation) -> Origin | None:
    """Return the geodetic place that the observation's metres are counted from, if known."""
    mapping = observation.mapping
    return mapping.origin if isinstance(mapping, GroundMapping) else None


def known(value: float | None, digits: int = 6) -> float | None:
    """Return a number that JSON can hold: None for what is missing or not finite."""
    if value is None or not math.isfinite(value):
        return None
    return round(float(value), digits)
