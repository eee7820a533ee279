"""AirData flight logs: one row per tenth of a second, units in the column names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from queuetail.errors import InputError
from queuetail.telemetry.reading import Reading, VideoClock, stamp_of
from queuetail.telemetry.text import Numbers, Row, Table, column_names, read_table
from queuetail.types import TelemetrySample

METRES = {"feet": 0.3048, "ft": 0.3048, "meters": 1.0, "metres": 1.0, "m": 1.0}
COLUMN = re.compile(r"^(?P<name>[^()]*?)\s*(?:\((?P<unit>[^()]*)\))?$")
MARKS = {"compass_heading", "gimbal_heading", "gimbal_pitch", "height_above_takeoff", "isvideo"}
RATE_HZ = 10.0  # of AirData's export


@dataclass(frozen=True, slots=True)
class _Columns:
    """Where each quantity stands: by plain name, the full column name and its unit."""

    full: Mapping[str, str]
    unit: Mapping[str, str]

    def height(self, row: Row, name: str, numbers: Numbers) -> float | None:
        value = numbers.get(row, self.full.get(name))
        return None if value is None else value * METRES.get(self.unit.get(name, ""), 1.0)


def is_airdata(text: str) -> bool:
    """Tell whether the header has positions and names that only AirData uses."""
    names = set(_columns(column_names(text)).full)
    return {"latitude", "longitude"} <= names and bool(names & MARKS)


def read_airdata(text: str, source: str, video: VideoClock) -> Reading:
    """Read an AirData CSV export.

    The height is that above the ground at the drone where the log has it, else a sonar's positive
    reading, else that above the take-off point.  The heading is the gimbal's, else the compass'.
    """
    table = read_table(text)
    if not table.rows:
        raise InputError(f"{source}: there are no lines below the header")
    columns = _columns(table.columns)
    numbers = Numbers()
    times, time_notes, first_utc = _times(table, columns, video, numbers)
    height_name, height_note = _height_source(columns, table, numbers)
    heading = columns.full.get("gimbal_heading") or columns.full.get("compass_heading")
    samples = [
        TelemetrySample(
            t_s=t_s,
            lat_deg=numbers.get(row, columns.full["latitude"]),
            lon_deg=numbers.get(row, columns.full["longitude"]),
            height_agl_m=_height(row, columns, height_name, numbers),
            heading_deg=numbers.get(row, heading),
            gimbal_pitch_deg=numbers.get(row, columns.full.get("gimbal_pitch")),
            gimbal_roll_deg=numbers.get(row, columns.full.get("gimbal_roll")),
        )
        for t_s, row in zip(times, table.rows, strict=True)
        if t_s is not None
    ]
    notes = [*table.notes, *time_notes, *height_note]
    if heading is not None and "gimbal_heading" not in columns.full:
        notes.append("the heading is the drone's compass heading: the log has no gimbal heading")
    untimed = sum(t_s is None for t_s in times)
    if untimed:
        notes.append(f"{untimed} of {len(times)} lines dropped: no time")
    return Reading(samples, (*notes, *numbers.notes(source)), first_utc)


def _columns(names: Sequence[str]) -> _Columns:
    full: dict[str, str] = {}
    unit: dict[str, str] = {}
    for name in names:
        match = COLUMN.match(name)
        if match and match["name"]:
            plain = match["name"].strip().lower()
            full.setdefault(plain, name)
            unit.setdefault(plain, (match["unit"] or "").strip().lower())
    return _Columns(full, unit)


def _height_source(
    columns: _Columns, table: Table, numbers: Numbers
) -> tuple[str | None, list[str]]:
    """Choose one height column for the whole log, so that its datum never changes in mid-flight."""
    ground, takeoff = "height_above_ground_at_drone_location", "height_above_takeoff"
    for name in (ground, takeoff):
        given = sum(columns.height(row, name, numbers) is not None for row in table.rows)
        if given * 2 >= len(table.rows):
            note = (
                "above the ground by AirData's terrain model"
                if name == ground
                else (
                    "above the take-off point: give height_agl_m in the site file's [telemetry] "
                    "where the road lies lower or higher"
                )
            )
            unit = columns.unit[name]
            if unit not in METRES:
                note += f"; its unit '{unit}' is not known and was taken as metres"
            return name, [f"heights are {note}"]
    if "height_sonar" in columns.full:
        return "height_sonar", ["heights are a sonar's, which reads the first few metres only"]
    return None, ["the log has no height above the ground or the take-off point"]


def _height(row: Row, columns: _Columns, name: str | None, numbers: Numbers) -> float | None:
    value = None if name is None else columns.height(row, name, numbers)
    if value is None:
        value = columns.height(row, "height_sonar", numbers)
        return value if value is not None and value > 0 else None
    return value if name != "height_sonar" or value > 0 else None


def _times(
    table: Table, columns: _Columns, video: VideoClock, numbers: Numbers
) -> tuple[list[float | None], list[str], datetime | None]:
    """Return each row's time, notes, and the clock time of 0 where the clock is all there is."""
    stamps = [_stamp(row, columns.full.get("datetime"), numbers) for row in table.rows]
    milliseconds = [numbers.get(row, columns.full.get("time")) for row in table.rows]
    seconds = [None if ms is None else ms / 1000 for ms in milliseconds]
    if all(s is None for s in seconds):
        if all(stamp is None for stamp in stamps):
            return *_evenly(len(table.rows), video), None
        seconds = _spread([None if s is None else s.timestamp() for s in stamps])
    start_s, note = _video_start(seconds, table, columns, video)
    if start_s is not None:
        return [None if s is None else s - start_s for s in seconds], [note], None
    # Stamps are cut to whole seconds, so the latest estimate of the log's zero is the exact one.
    zeros = [
        stamp - timedelta(seconds=s)
        for stamp, s in zip(stamps, seconds, strict=True)
        if stamp is not None and s is not None
    ]
    if zeros:
        return seconds, [], max(zeros)
    first = min(s for s in seconds if s is not None)
    note = "the log has no isVideo marks and no UTC, so its first row is taken as the first frame"
    return [None if s is None else s - first for s in seconds], [note], None


def _stamp(row: Row, column: str | None, numbers: Numbers) -> datetime | None:
    cell = row.cells.get(column) if column is not None else None
    if cell is None:
        return None
    stamp = stamp_of(cell)
    if stamp is None:
        numbers.reject(row, column or "", cell)
    return stamp


def _spread(stamps: Sequence[float | None]) -> list[float | None]:
    """Spread rows that share one whole second evenly over it."""
    count: dict[float, int] = {}
    for stamp in stamps:
        if stamp is not None:
            count[stamp] = count.get(stamp, 0) + 1
    seen: dict[float, int] = {}
    spread: list[float | None] = []
    for stamp in stamps:
        if stamp is None:
            spread.append(None)
            continue
        spread.append(stamp + seen.get(stamp, 0) / count[stamp])
        seen[stamp] = seen.get(stamp, 0) + 1
    return spread


def _evenly(count: int, video: VideoClock) -> tuple[list[float | None], list[str]]:
    if video.duration_s is not None and video.duration_s > 0:
        step = video.duration_s / count
        note = f"the log has no time column: its {count} rows are spread evenly over the video"
    else:
        step = 1 / RATE_HZ
        note = "the log has no time column: its rows are taken as ten per second, AirData's rate"
    return [i * step for i in range(count)], [note]


def _video_start(
    seconds: Sequence[float | None], table: Table, columns: _Columns, video: VideoClock
) -> tuple[float | None, str]:
    """Return when the recording that fits the video began, by isVideo marks, and a note."""
    name = columns.full.get("isvideo")
    runs: list[tuple[float, float]] = []
    recording = False
    for t_s, row in zip(seconds, table.rows, strict=True):
        if t_s is None:
            continue
        marked = name is not None and row.cells.get(name, "0").lower() in {"1", "1.0", "true"}
        if marked:
            runs = [*runs[:-1], (runs[-1][0], t_s)] if recording else [*runs, (t_s, t_s)]
        recording = marked
    if not runs:
        return None, ""
    if len(runs) == 1:
        return runs[0][0], "the video starts where the log's isVideo mark begins"
    wanted = video.duration_s
    best = (
        0
        if wanted is None
        else min(range(len(runs)), key=lambda i: abs(runs[i][1] - runs[i][0] - wanted))
    )
    why = "the first of them" if wanted is None else f"number {best + 1}, whose length fits best"
    return runs[best][0], f"the log marks {len(runs)} recordings; the video is taken as {why}"
