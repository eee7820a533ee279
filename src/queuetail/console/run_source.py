"""A finished run as the console sees it: its files, told as the run told them."""

from __future__ import annotations

import asyncio
import dataclasses
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from queuetail.config import Site
from queuetail.console.run_pictures import RunPictures, mapping_at
from queuetail.console.source import About, PastState, PathSample
from queuetail.errors import InputError
from queuetail.evaluate.files import Columns, read_columns
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import enu_to_px
from queuetail.live.records import Health, Published
from queuetail.mapping import site_approaches, site_origin
from queuetail.sinks.folder import read_run
from queuetail.traffic.road import place
from queuetail.types import (
    Approach,
    EndOfQueue,
    Floats,
    GroundMapping,
    Ints,
    Observation,
    Origin,
    QueueState,
    QueueStatus,
    Registration,
    RoadVehicles,
    Tracks,
    TrackState,
    Unknown,
)

WIDTH_M = 2.0  # of a vehicle, which the tables do not tell
LONGEST_M = 5.0  # that a rear may be off from the end of its queue
NEAR_S = 1.0  # tracks of so long before and after tell where the picture lies
PATHS_EVERY_S = 0.5
QUEUE_NUMBERS = (
    *("t_s", "eoq_lat", "eoq_lon", "eoq_station_m", "eoq_sigma_m", "eoq_u_px", "eoq_v_px"),
    *("length_m", "vehicles", "growth_mps"),
)
TRACK_NUMBERS = (
    *("t_s", "track_id", "lat", "lon", "station_m", "offset_m", "speed_mps", "length_m"),
    *("u_px", "v_px"),
)
HAS_QUEUE = (QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)


class RunSource:
    """Reads a run's folder once; ``at`` puts one moment together."""

    def __init__(
        self,
        folder: Path,
        site: Site | None = None,
        site_file: Path | None = None,
        video: Path | None = None,
        telemetry: Path | None = None,
    ) -> None:
        """Read the tables and open the video, which defaults to the run's annotated one.

        Raises InputError where the folder is no run, or a file is not what it should be.
        """
        self._queue, self._tracks = read_tables(folder)
        record = read_run(folder)
        self._names = np.array(self._tracks.texts["approach"], dtype=object)
        site = site or site_of(record, folder)
        self._pictures = RunPictures(folder, record, video, telemetry, site)
        self._approaches, self._origin = road_of(record, site)
        self._start_utc = start_of(record)
        t_s = self._queue.numbers["t_s"]
        self._times = np.unique(t_s)
        self._rows = np.searchsorted(t_s, self._times)
        title = site.site.name if site != Site() else folder.resolve().name
        self.about = About(
            title,
            self._pictures.name,
            str(record.get("preset") or ""),
            site,
            site_file,
            is_live=False,
            start_s=float(self._times[0]),
            end_s=float(self._times[-1]),
            step_s=float(np.median(np.diff(self._times))) if len(self._times) > 1 else 0.0,
            is_drawn=self._pictures.is_drawn,
        )
        self._past = self._all_past()

    def newest(self) -> Published | None:
        """Return the run's last answer."""
        return self.at(float(self._times[-1]))

    def at(self, t_s: float) -> Published | None:
        """Return the answer at `t_s`, or the one before; the first one before all."""
        index = max(int(np.searchsorted(self._times, t_s + 1e-6, side="right")) - 1, 0)
        t_s = float(self._times[index])
        vehicles = self._vehicles(t_s)
        mapping = self._mapping(t_s) or Unknown(("the run's files do not say",))
        observation = Observation(
            frame_index=index,
            t_s=t_s,
            mapping=mapping,
            registration=Registration(np.eye(3), 1.0),
            detections_px=np.empty((0, 4)),
            approaches=self._approaches,
            vehicles=with_boxes(vehicles, self._approaches, mapping),
            states=self._states(index, vehicles),
        )
        return Published(
            number=index + 1,
            utc=self._start_utc + timedelta(seconds=t_s),
            frame=self._pictures.frame(t_s, index),
            observation=observation,
            health=Health(),
            telemetry=self._pictures.telemetry_at(t_s),
        )

    async def newer(self, number: int, timeout_s: float) -> Published | None:
        """Return the last answer once; a finished run gets no newer ones."""
        if number < len(self._times):
            return self.newest()
        await asyncio.sleep(timeout_s)
        return None

    def past(self, since_s: float, until_s: float) -> Sequence[PastState]:
        """Return the answers between two times."""
        return [p for p in self._past if since_s <= p.t_s <= until_s]

    def paths(self, since_s: float, until_s: float) -> Sequence[PathSample]:
        """Return where the vehicles were, twice a second."""
        numbers, names = self._tracks.numbers, self._names
        found, last_s = [], -np.inf
        for t_s in np.unique(numbers["t_s"]).tolist():
            if not since_s <= t_s <= until_s or t_s - last_s < PATHS_EVERY_S:
                continue
            last_s = t_s
            rows = self._rows_at(t_s)
            for name in sorted(set(names[rows].tolist()) - {""}):
                mine = rows[names[rows] == name]
                found.append(
                    PathSample(
                        t_s,
                        name,
                        numbers["track_id"][mine],
                        numbers["station_m"][mine],
                        numbers["speed_mps"][mine],
                    )
                )
        return found

    def health(self) -> Health:
        """Return that there is nothing to tell."""
        return Health()

    def close(self) -> None:
        """Release the video."""
        self._pictures.close()

    def _all_past(self) -> list[PastState]:
        found = []
        for index, t_s in enumerate(self._times.tolist()):
            utc = self._start_utc + timedelta(seconds=t_s)
            states = self._states(index, None)
            found += [PastState(index + 1, utc, t_s, state) for state in states]
        return found

    def _states(self, index: int, vehicles: RoadVehicles | None) -> tuple[QueueState, ...]:
        """Return one moment's answers; `vehicles` tell which one is the last in the queue."""
        begin = int(self._rows[index])
        stop = int(self._rows[index + 1]) if index + 1 < len(self._rows) else None
        names = self._queue.texts["approach"][begin:stop]
        return tuple(self._state(begin + k, name, vehicles) for k, name in enumerate(names))

    def _state(self, row: int, name: str, vehicles: RoadVehicles | None) -> QueueState:
        status = QueueStatus(self._queue.texts["status"][row])
        value = {key: float(column[row]) for key, column in self._queue.numbers.items()}
        if status not in HAS_QUEUE or not np.isfinite(value["eoq_station_m"]):
            reasons = ("the run did not know",) if status is QueueStatus.UNKNOWN else ()
            return QueueState(name, status, None, reasons)
        place_px = value["eoq_u_px"], value["eoq_v_px"]
        lat, lon = value["eoq_lat"], value["eoq_lon"]
        growth = value["growth_mps"]
        is_placed = bool(np.isfinite(lat) and np.isfinite(lon))
        eoq = EndOfQueue(
            station_m=value["eoq_station_m"],
            sigma_m=value["eoq_sigma_m"],
            enu=(float("nan"), float("nan")),
            px=place_px,
            lat_deg=lat if is_placed else None,
            lon_deg=lon if is_placed else None,
            track_id=last_in(vehicles, value["eoq_station_m"]) if vehicles is not None else -1,
            length_m=value["length_m"],
            vehicles=int(np.nan_to_num(value["vehicles"])),
            growth_mps=growth if np.isfinite(growth) else None,
        )
        return QueueState(name, status, eoq)

    def _rows_at(self, t_s: float) -> Ints:
        times = self._tracks.numbers["t_s"]
        low, high = np.searchsorted(times, [t_s - 5e-4, t_s + 5e-4])
        return np.arange(low, high)

    def _places(self, rows: Ints) -> Floats:
        """Return where vehicles are, by the road or by their coordinates, ENU (n, 2)."""
        numbers, names = self._tracks.numbers, self._names[rows]
        enu = np.full((len(rows), 2), np.nan)
        if self._origin is not None:
            lat, lon = numbers["lat"][rows], numbers["lon"][rows]
            enu = enu_from_geodetic(lat, lon, self._origin)
        for approach in self._approaches if self._origin is None else ():
            mine = names == approach.name
            at = numbers["station_m"][rows][mine], numbers["offset_m"][rows][mine]
            enu[mine] = place(approach, *at)
        return enu

    def _vehicles(self, t_s: float) -> RoadVehicles:
        rows = self._rows_at(t_s)
        numbers, count = self._tracks.numbers, len(rows)
        index = {a.name: k for k, a in enumerate(self._approaches)}
        approach = np.array([index.get(n, -1) for n in self._names[rows]], np.int64)
        lanes = self._tracks.texts["lane"]
        speed = numbers["speed_mps"][rows]
        station, length = numbers["station_m"][rows], numbers["length_m"][rows]
        tracks = Tracks(
            ids=numbers["track_id"][rows].astype(np.int64),
            states=tuple(TrackState(self._tracks.texts["state"][r]) for r in rows),
            px=np.column_stack([numbers["u_px"][rows], numbers["v_px"][rows]]),
            boxes_px=np.full((count, 4), np.nan),
            enu=self._places(rows),
            velocity_mps=np.full((count, 2), np.nan),
            sigma_m=np.full(count, np.nan),
            length_m=length,
        )
        return RoadVehicles(
            tracks=tracks,
            approach=approach,
            lane=np.array([int(lanes[r] or 0) for r in rows], np.int64),
            station_m=station,
            offset_m=numbers["offset_m"][rows],
            speed_mps=speed,
            rear_station_m=station - length / 2,
            queued=np.asarray(np.abs(speed) < self._queue_speed_mps),
        )

    @property
    def _queue_speed_mps(self) -> float:
        """The tables do not say who was queued: those slower than the queue speed are drawn so."""
        return self.about.site.queue_speed_mps

    def _mapping(self, t_s: float) -> GroundMapping | None:
        times = self._tracks.numbers["t_s"]
        low, high = np.searchsorted(times, [t_s - NEAR_S, t_s + NEAR_S])
        rows = np.arange(low, high)
        px = np.column_stack([self._tracks.numbers[k][rows] for k in ("u_px", "v_px")])
        pose = self._pictures.mapping_by_pose(t_s, self._origin)
        return mapping_at(px, self._places(rows), self._origin, pose, self._pictures.size)


def with_boxes(
    vehicles: RoadVehicles, approaches: tuple[Approach, ...], mapping: GroundMapping | Unknown
) -> RoadVehicles:
    """Put a box around each vehicle's footprint, which is what the tables tell of its size."""
    if isinstance(mapping, Unknown):
        return vehicles
    boxes = vehicles.tracks.boxes_px.copy()
    for index, approach in enumerate(approaches):
        mine = vehicles.approach == index
        station, offset = vehicles.station_m[mine], vehicles.offset_m[mine]
        half_m = vehicles.tracks.length_m[mine] / 2
        corners = np.stack(
            [
                enu_to_px(mapping, place(approach, station + along * half_m, offset + aside))
                for along in (-1, 1)
                for aside in (-WIDTH_M / 2, WIDTH_M / 2)
            ]
        )
        low, high = corners.min(axis=0), corners.max(axis=0)
        boxes[mine] = np.column_stack([low, high - low])
    tracks = dataclasses.replace(vehicles.tracks, boxes_px=boxes)
    return dataclasses.replace(vehicles, tracks=tracks)


def read_tables(folder: Path) -> tuple[Columns, Columns]:
    """Read queue.csv and tracks.csv; raises InputError where the folder is no run."""
    if not (folder / "queue.csv").is_file():
        raise InputError(
            f"{folder} is not a run folder: it has no queue.csv (queuetail run makes one)"
        )
    queue = read_columns(folder / "queue.csv", QUEUE_NUMBERS, ("approach", "status"), ("t_s",))
    statuses = {s.value for s in QueueStatus}
    strange = next((s for s in queue.texts["status"] if s not in statuses), None)
    if strange is not None:
        raise InputError(f"{folder / 'queue.csv'}: status is {strange!r}")
    if not len(queue.numbers["t_s"]):
        raise InputError(f"{folder / 'queue.csv'} has no rows: the run processed no frame")
    texts = ("approach", "lane", "state")
    if not (folder / "tracks.csv").is_file():
        nothing = {name: np.empty(0) for name in TRACK_NUMBERS}
        return queue, Columns(nothing, dict.fromkeys(texts, ()))
    tracks = read_columns(folder / "tracks.csv", TRACK_NUMBERS, texts, ("t_s", "track_id"))
    states = {s.value for s in TrackState}
    if not set(tracks.texts["state"]) <= states:
        raise InputError(f"{folder / 'tracks.csv'}: a state is not one of {', '.join(states)}")
    return queue, tracks


def site_of(record: dict[str, Any], folder: Path) -> Site:
    """Return the settings that the run was made with."""
    settings = record.get("settings")
    try:
        return Site.model_validate(settings) if isinstance(settings, dict) else Site()
    except ValidationError as error:
        problem = error.errors()[0]["msg"]
        raise InputError(
            f"{folder / 'run.json'}: its settings are of another version ({problem}); "
            "give the site file with --site"
        ) from None


def road_of(record: dict[str, Any], site: Site) -> tuple[tuple[Approach, ...], Origin | None]:
    """Return the approaches as the run had them, else as the site file has."""
    listed = record.get("approaches") or []
    first = next((a["axis_lat_lon"][0] for a in listed if a.get("axis_lat_lon")), None)
    if not listed:
        origin = site_origin(site)
        return site_approaches(site, origin), origin
    origin = Origin(*first) if first is not None else None
    found = []
    for a in listed:
        axis = np.array(a["axis_enu_m"], float)
        if origin is not None:
            points = np.array(a["axis_lat_lon"], float)
            axis = enu_from_geodetic(points[:, 0], points[:, 1], origin)
        found.append(Approach(a["name"], axis, a["start_station_m"], a["lanes"], a["lane_width_m"]))
    return tuple(found), origin


def start_of(record: dict[str, Any]) -> datetime:
    """Return when the video began; the epoch where it does not say."""
    text = (record.get("video") or {}).get("start_utc")
    try:
        moment = datetime.fromisoformat(text) if text else datetime.fromtimestamp(0, UTC)
    except ValueError:
        moment = datetime.fromtimestamp(0, UTC)
    return moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)


def last_in(vehicles: RoadVehicles, station_m: float) -> int:
    """Return the vehicle whose rear is at the end of the queue; -1 where none is near."""
    gaps = np.abs(vehicles.rear_station_m - station_m)
    if not (gaps < LONGEST_M).any():
        return -1
    return int(vehicles.tracks.ids[int(np.nanargmin(gaps))])
