"""`queuetail history import`: the files of a run into the store."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from queuetail.errors import InputError
from queuetail.sinks.folder import QueueTable, read_events, read_queue, read_run
from queuetail.store.database import Store
from queuetail.store.records import HISTORY_EVERY_S, Batch, Flight, HistoryPoint, StoredEvent, known


def import_run(store: Store, run_dir: Path, started_utc: datetime | None = None) -> Flight:
    """Put a run's history and events into the store; a run imported again replaces itself.

    The start is the one given, else the video's own.  Raises InputError where neither is known.
    """
    about = read_run(run_dir)
    tables = read_queue(run_dir)
    started = started_utc or _start_of(about)
    if started is None:
        raise InputError(
            f"{run_dir}: the video does not say when it was taken; give --start, as in "
            "--start 2026-05-14T15:30:00Z"
        )
    video = about.get("video") or {}
    preset = str(about.get("preset") or "")
    seed = f"{video.get('sha256') or video.get('name') or run_dir.resolve()} {preset}"
    name = f"{started:%Y%m%dT%H%M%SZ}-{hashlib.sha256(seed.encode()).hexdigest()[:6]}"
    site = about.get("site")
    flight = Flight(
        id=name,
        site=str(site.get("name") if isinstance(site, dict) else site or ""),
        source=str(video.get("name") or run_dir.name),
        preset=preset,
        version=str(about.get("queuetail_version") or ""),
        started_utc=started,
        is_finished=not about.get("interrupted", False),
    )
    history = tuple(p for table in tables for p in _points(flight, table))
    events = tuple(_event(flight, record) for record in read_events(run_dir))
    store.delete_flight(name)
    store.put_flight(flight)
    store.add(Batch(history, events))
    return flight


def _start_of(about: dict[str, Any]) -> datetime | None:
    text = (about.get("video") or {}).get("start_utc")
    try:
        moment = datetime.fromisoformat(text) if isinstance(text, str) else None
    except ValueError:
        return None
    return moment.replace(tzinfo=UTC) if moment is not None and moment.tzinfo is None else moment


def _points(flight: Flight, table: QueueTable) -> list[HistoryPoint]:
    """Thin a run's rows as a live run does."""
    points: list[HistoryPoint] = []
    for i in range(len(table)):
        t_s, status = float(table.t_s[i]), table.status[i].value
        last = points[-1] if points else None
        if last is not None and last.status == status and t_s - last.t_s < HISTORY_EVERY_S:
            continue
        vehicles = known(float(table.vehicles[i]))
        points.append(
            HistoryPoint(
                flight=flight.id,
                utc=flight.started_utc + timedelta(seconds=t_s),
                t_s=t_s,
                approach=table.approach,
                status=status,
                lat_deg=known(float(table.lat[i])),
                lon_deg=known(float(table.lon[i])),
                station_m=known(float(table.station_m[i])),
                sigma_m=known(float(table.sigma_m[i])),
                length_m=known(float(table.length_m[i])),
                vehicles=None if vehicles is None else int(vehicles),
                growth_mps=known(float(table.growth_mps[i])),
            )
        )
    return points


def _event(flight: Flight, record: dict[str, Any]) -> StoredEvent:
    t_s = float(record["t_s"])
    return StoredEvent(
        flight=flight.id,
        utc=flight.started_utc + timedelta(seconds=t_s),
        t_s=t_s,
        approach=str(record["approach"]),
        event=str(record["event"]),
        status=str(record["status"]),
        lat_deg=record["eoq_lat"],
        lon_deg=record["eoq_lon"],
        station_m=record["eoq_station_m"],
        sigma_m=record["eoq_sigma_m"],
        length_m=record["length_m"],
        vehicles=record["vehicles"],
        growth_mps=record["growth_mps"],
        reasons="; ".join(record["reasons"]),
    )
