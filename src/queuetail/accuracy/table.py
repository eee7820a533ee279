"""points.csv: pixels whose true places are known; or places that were measured already."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from queuetail.accuracy.points import Errors, KnownPoint, PlacedPoint
from queuetail.errors import InputError
from queuetail.geo.earth import enu_from_geodetic, haversine_m
from queuetail.types import Origin

COLUMNS = ("t_s", "u_px", "v_px", "lat", "lon")
MEASURED = ("lat", "lon", "measured_lat", "measured_lon")
LIMITS = {"lat": 90.0, "measured_lat": 90.0, "lon": 180.0, "measured_lon": 180.0}
MOST_BYTES = 2_000_000


def read_points(path: Path) -> list[KnownPoint]:
    """Read a table of t_s, u_px, v_px, lat, lon and, if there, name; raises InputError."""
    found = []
    for row, numbers in _rows(path, COLUMNS):
        t_s, u, v, lat, lon = numbers
        found.append(KnownPoint(t_s, (u, v), lat, lon, row.get("name") or ""))
    return found


def read_measured(path: Path) -> Errors:
    """Read a table of true and measured places, and return the errors; raises InputError."""
    placed = []
    for row, numbers in _rows(path, MEASURED):
        lat, lon, measured_lat, measured_lon = (np.array([v]) for v in numbers)
        error = haversine_m(measured_lat, measured_lon, lat, lon)
        off = enu_from_geodetic(measured_lat, measured_lon, Origin(numbers[0], numbers[1]))[0]
        point = KnownPoint(
            math.nan, (math.nan, math.nan), numbers[0], numbers[1], row.get("name") or ""
        )
        placed.append(
            PlacedPoint(
                point, numbers[2], numbers[3], float(error[0]), float(off[1]), float(off[0])
            )
        )
    return Errors(tuple(placed))


def write_points(points: list[KnownPoint]) -> str:
    """Return points as the text of such a table."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([*COLUMNS, "name"])
    for p in points:
        place = f"{p.lat_deg:.8f}", f"{p.lon_deg:.8f}"
        writer.writerow([f"{p.t_s:.3f}", f"{p.px[0]:.2f}", f"{p.px[1]:.2f}", *place, p.name])
    return out.getvalue()


def _rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[dict[str, str], list[float]]]:
    """Yield each row and the numbers of its columns."""
    rows = csv.DictReader(io.StringIO(_text(path)), skipinitialspace=True)
    names = [name.strip() for name in rows.fieldnames or ()]
    rows.fieldnames = names
    missing = [name for name in columns if name not in names]
    if missing:
        raise InputError(
            f"{path}, line 1: the column {missing[0]} is missing; it has to have "
            f"{', '.join(columns)}"
        )
    count = 0
    for row in rows:
        if not any((v or "").strip() for v in row.values() if isinstance(v, str)):
            continue
        count += 1
        yield row, [_number(path, rows.line_num, name, row[name]) for name in columns]
    if not count:
        raise InputError(f"{path} has no points: add a line for each")


def _text(path: Path) -> str:
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such table of points") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})") from None
    if len(data) > MOST_BYTES:
        raise InputError(f"{path} is larger than 2 MB, which no table of points is")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8") from None


def _number(path: Path, line: int, name: str, cell: str | None) -> float:
    try:
        value = float(cell or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{path}, line {line}: '{cell or ''}' is not a number ({name})")
    if abs(value) > LIMITS.get(name, math.inf):
        raise InputError(
            f"{path}, line {line}: {name} {value:g} is not between −{LIMITS[name]:g} and "
            f"{LIMITS[name]:g}"
        )
    return value
