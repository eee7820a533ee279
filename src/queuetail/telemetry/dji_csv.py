"""DJI frame metadata as a table: frame, timestamp, focal_len, latitude, longitude, rel_alt, …"""

from __future__ import annotations

from datetime import datetime

from queuetail.errors import InputError
from queuetail.telemetry.lens import (
    effective_focals,
    focal_length_mm,
    hfov_from_equivalent,
    zoom_ratio,
)
from queuetail.telemetry.reading import Reading, stamp_of
from queuetail.telemetry.text import Numbers, Row, column_names, read_table
from queuetail.types import TelemetrySample

TIME_COLUMNS = ("timestamp", "utc", "time", "datetime")


def is_dji_csv(text: str) -> bool:
    """Tell whether the header has DJI's own names of position and height or lens."""
    columns = set(column_names(text))
    return {"latitude", "longitude"} <= columns and bool(
        columns & {"rel_alt", "focal_len", "gb_yaw"}
    )


def read_dji_csv(text: str, source: str) -> Reading:
    """Read the per-frame table that SRT converters write; raises InputError without time stamps."""
    table = read_table(text)
    column = next((name for name in TIME_COLUMNS if name in table.columns), None)
    if column is None:
        raise InputError(f"{source}: the header has no timestamp column, so no sample has a time")
    numbers = Numbers()
    stamped = [
        (stamp, row) for row in table.rows if (stamp := _stamp_of(row, column, numbers)) is not None
    ]
    if not stamped:
        raise InputError(f"{source}: no line has a readable {column} such as 2022-10-07 17:52:13.5")
    first = min(stamp for stamp, _ in stamped)
    rows = [row for _, row in stamped]
    focals = effective_focals(
        [focal_length_mm(row.cells.get("focal_len", ""), numbers.get(row, "fnum")) for row in rows],
        [zoom_ratio(numbers.get(row, "dzoom_ratio")) for row in rows],
    )
    samples = [
        TelemetrySample(
            t_s=(stamp - first).total_seconds(),
            lat_deg=numbers.get(row, "latitude"),
            lon_deg=numbers.get(row, "longitude"),
            height_agl_m=numbers.get(row, "rel_alt"),
            heading_deg=numbers.get(row, "gb_yaw"),
            gimbal_pitch_deg=numbers.get(row, "gb_pitch"),
            gimbal_roll_deg=numbers.get(row, "gb_roll"),
            hfov_deg=None if focal is None else hfov_from_equivalent(focal),
        )
        for (stamp, row), focal in zip(stamped, focals, strict=True)
    ]
    notes = [*table.notes, *numbers.notes(source)]
    if len(rows) < len(table.rows):
        notes.append(f"{len(table.rows) - len(rows)} of {len(table.rows)} lines dropped: no time")
    return Reading(samples, tuple(notes), first)


def _stamp_of(row: Row, column: str, numbers: Numbers) -> datetime | None:
    cell = row.cells.get(column)
    if cell is None:
        return None
    stamp = stamp_of(cell)
    if stamp is None:
        numbers.reject(row, column, cell)
    return stamp
