"""Fabricated truths and runs: a straight road, and runs that are off by known amounts."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from queuetail.geo.earth import geodetic_from_enu
from queuetail.types import Origin

ORIGIN = Origin(36.11, -97.058)
QUEUE_HEADER = (
    "t_s,approach,status,eoq_lat,eoq_lon,eoq_station_m,eoq_sigma_m,eoq_u_px,eoq_v_px,"
    "length_m,vehicles,growth_mps\n"
)
TRACK_HEADER = (
    "t_s,track_id,approach,lane,lat,lon,station_m,offset_m,speed_mps,length_m,u_px,v_px,state\n"
)
TRUTH_HEADER = "t_s,queued,eoq_station_m,eoq_lat,eoq_lon,eoq_u_px,eoq_v_px,in_view\n"
VEHICLE_HEADER = "t_s,vehicle_id,station_m,offset_m,speed_mps,length_m,lat,lon,u_px,v_px\n"


def lat_lon(station_m: float, offset_m: float) -> str:
    """The road runs due east, so that station is east and offset is north."""
    lat, lon = geodetic_from_enu(np.array([station_m, offset_m]), ORIGIN)
    return f"{lat:.10f},{lon:.10f}"


@dataclass
class Queue:
    """One answer: its time, status and EOQ."""

    t_s: float
    status: str
    station_m: float | None = None
    sigma_m: float | None = None
    approach: str = "east"
    in_view: int = 1


@dataclass
class Car:
    """One vehicle at one time."""

    t_s: float
    name: str
    station_m: float
    offset_m: float = -1.75
    speed_mps: float = 0.0
    approach: str = "east"


@dataclass
class Bench:
    """A truth folder and run folders beside it."""

    root: Path
    count: int = field(default=0)

    def truth(self, queue: list[Queue], cars: list[Car], site: str | None = None) -> Path:
        folder = self._folder("truth")
        rows = []
        for q in queue:
            cells = ",,,,,"
            if q.station_m is not None:
                place = lat_lon(q.station_m, -1.75)
                pixel = f"{q.station_m},100" if q.in_view else "-5,100"
                cells = f"{q.station_m},{place},{pixel},{q.in_view}"
            rows.append(f"{q.t_s:.3f},{2 if q.station_m is not None else 0},{cells}\n")
        (folder / "truth.csv").write_text(TRUTH_HEADER + "".join(rows))
        (folder / "vehicles.csv").write_text(
            VEHICLE_HEADER
            + "".join(
                f"{c.t_s:.3f},{c.name},{c.station_m},{c.offset_m},{c.speed_mps},4.5,"
                f"{lat_lon(c.station_m, c.offset_m)},{c.station_m},{100 - c.offset_m}\n"
                for c in cars
            )
        )
        stations = range(0, 1001, 100)
        (folder / "road.csv").write_text(
            "station_m,lat,lon\n" + "".join(f"{s},{lat_lon(s, 0)}\n" for s in stations)
        )
        if site is not None:
            (folder / "site.toml").write_text(site)
        return folder

    def run(
        self,
        queue: list[Queue],
        cars: list[Car],
        about: dict[str, object] | None = None,
        located: bool = True,
    ) -> Path:
        folder = self._folder("run")
        rows = []
        for q in queue:
            cells = ",,,"
            if q.station_m is not None:
                place = lat_lon(q.station_m, -1.75) if located else ","
                # a run's own stations may start anywhere: here, 5000 m off
                station = q.station_m + (5000 if located else 0)
                cells = f"{place},{station},{'' if q.sigma_m is None else q.sigma_m}"
            rows.append(f"{q.t_s:.3f},{q.approach},{q.status},{cells},,,,,\n")
        (folder / "queue.csv").write_text(QUEUE_HEADER + "".join(rows))
        (folder / "tracks.csv").write_text(
            TRACK_HEADER
            + "".join(
                f"{c.t_s:.3f},{c.name},{c.approach},1,"
                f"{lat_lon(c.station_m, c.offset_m) if located else ','},"
                f"{c.station_m},{c.offset_m},{c.speed_mps},4.5,"
                f"{c.station_m},{100 - c.offset_m},confirmed\n"
                for c in cars
            )
        )
        (folder / "run.json").write_text(
            json.dumps(about or {"video": {"width_px": 1000, "height_px": 200}})
        )
        return folder

    def _folder(self, name: str) -> Path:
        self.count += 1
        folder = self.root / f"{name}{self.count}"
        folder.mkdir()
        return folder


Answers = Callable[[float], tuple[str, float | None]]


def queue_rows(
    answer: Answers, until_s: float = 20.0, step_s: float = 0.1, **others: object
) -> list[Queue]:
    """Rows every `step_s` of what `answer` says: status and station."""
    times = np.round(np.arange(0, until_s + 1e-9, step_s), 3)
    return [Queue(float(t), *answer(float(t)), **others) for t in times]  # type: ignore[arg-type]


def driving_cars(until_s: float = 20.0) -> list[Car]:
    """Three cars, 40 m apart, that drive east at 10 m/s."""
    times = np.round(np.arange(0, until_s + 1e-9, 0.1), 3)
    return [
        Car(float(t), f"v{k}", 300 + 40 * k + 10 * float(t), speed_mps=10.0)
        for t in times
        for k in range(3)
    ]
