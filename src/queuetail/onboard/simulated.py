"""A flight that is played instead of sensors: to try the whole link on one machine."""

from __future__ import annotations

import csv
import math
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from queuetail.errors import InputError
from queuetail.link.messages import (
    ClockSource,
    ClockTime,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lens,
    Lidar,
    Position,
    Quantity,
)
from queuetail.onboard.source import Source

LOG = "telemetry.csv"
HOVER_HZ = 10.0
HOVER_M, HOVER_HFOV_DEG = 100.0, 84.0
SWAY_M, SWAY_DEG, SWAY_PERIOD_S = 0.3, 0.2, 7.0
METRES_PER_DEGREE = 111_320.0
ECHO_M = 100.0  # the LW20/C's reach

Readings = Iterator[tuple[float, tuple[Quantity, ...]]]


class SimulatedSource(Source):
    """Plays readings in real time: a folder's telemetry.csv, or a hover above a site's road."""

    def __init__(self, path: Path) -> None:
        super().__init__(f"simulated flight {path}")
        self._readings = readings_of(path)  # read now, so that what is wrong is said at once

    def _session(self) -> bool:
        started_s: float | None = None
        started_utc_s = 0.0
        for t_s, quantities in self._readings:
            if started_s is None:
                started_s = time.monotonic() - t_s
                started_utc_s = time.time() - t_s
            if self._stopping.wait(max(started_s + t_s - time.monotonic(), 0.0)):
                break
            now_s = time.monotonic()
            self._tick(t_s, started_s + t_s)
            for quantity in quantities:
                self._hear(quantity, max(now_s, started_s + t_s), t_s)
            self._hear(ClockTime(started_utc_s + t_s, ClockSource.GPS), now_s, t_s)
        return False


def readings_of(path: Path) -> Readings:
    """Return the readings of a flight folder, or of a site file (with its log beside it, if any).

    Raises InputError where there is neither.
    """
    if path.is_dir():
        return iter(_rows_of(path / LOG))
    if path.suffix != ".toml":
        raise InputError(
            f"{path} is no flight folder and no site file; give a folder with {LOG} or a .toml"
        )
    beside = path.parent / LOG
    return iter(_rows_of(beside)) if beside.is_file() else _hover(path)


def _rows_of(log: Path) -> list[tuple[float, tuple[Quantity, ...]]]:
    try:
        with log.open(newline="", encoding="utf-8-sig") as file:
            rows = [(_cell(row, "t_s"), _quantities(row)) for row in csv.DictReader(file)]
    except FileNotFoundError:
        raise InputError(
            f"{log.parent}: there is no {LOG} in it; make a flight with queuetail simulate"
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{log}: it cannot be read ({error})") from None
    timed = [(t_s, quantities) for t_s, quantities in rows if t_s is not None and quantities]
    if not timed:
        raise InputError(f"{log}: none of its {len(rows)} lines has a t_s and a value")
    return sorted(timed, key=lambda pair: pair[0])


def _cell(row: dict[str, Any], name: str) -> float | None:
    try:
        value = float(row.get(name) or "nan")
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _quantities(row: dict[str, Any]) -> tuple[Quantity, ...]:
    lat, lon, height = _cell(row, "lat"), _cell(row, "lon"), _cell(row, "height_agl_m")
    heading, hfov = _cell(row, "heading_deg"), _cell(row, "hfov_deg")
    gimbal = Gimbal(heading, _cell(row, "gimbal_pitch_deg"), _cell(row, "gimbal_roll_deg"))
    found: list[Quantity] = []
    if lat is not None and lon is not None:
        found.append(Position(lat, lon))
    if height is not None:
        found.append(Lidar(height if 0 < height <= ECHO_M else None))
        found.append(Height(height, HeightSource.LIDAR))
    if heading is not None:
        found.append(Heading(heading))
    if gimbal != Gimbal():
        found.append(gimbal)
    if hfov is not None:
        found.append(Lens(hfov))
    return tuple(found)


def _hover(site_file: Path) -> Readings:
    """Yield an endless hover above the middle of the first approach, swaying a little."""
    try:
        site = tomllib.loads(site_file.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{site_file}: the site file cannot be read ({error})") from None
    try:
        (lat, lon), (next_lat, next_lon) = _middle_leg(site["approach"][0]["axis"])
    except (KeyError, IndexError, TypeError, ValueError):
        raise InputError(
            f"{site_file}: there is no {LOG} beside it, and no [[approach]] with an axis in "
            "latitude and longitude to hover above"
        ) from None
    height = float(site.get("telemetry", {}).get("height_agl_m", HOVER_M))
    hfov = float(site.get("camera", {}).get("hfov_deg", HOVER_HFOV_DEG))
    east = (next_lon - lon) * math.cos(math.radians(lat))
    heading = math.degrees(math.atan2(east, next_lat - lat)) % 360.0
    return _swaying((lat + next_lat) / 2, (lon + next_lon) / 2, height, heading, hfov)


def _middle_leg(axis: Any) -> tuple[tuple[float, float], tuple[float, float]]:
    points = [(float(lat), float(lon)) for lat, lon in axis]
    middle = (len(points) - 1) // 2
    return points[middle], points[middle + 1]


def _swaying(lat: float, lon: float, height: float, heading: float, hfov: float) -> Readings:
    tick = 0
    while True:
        t_s = tick / HOVER_HZ
        sway = math.sin(2 * math.pi * t_s / SWAY_PERIOD_S)
        turned = (heading + SWAY_DEG * sway) % 360.0
        yield (
            t_s,
            (
                Position(lat + SWAY_M * sway / METRES_PER_DEGREE, lon),
                Height(height + SWAY_M * sway, HeightSource.LIDAR),
                Heading(turned),
                Gimbal(turned, -90.0, 0.0),
                Lens(hfov),
            ),
        )
        tick += 1
