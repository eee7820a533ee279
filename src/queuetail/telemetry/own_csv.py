"""queuetail's own telemetry format: a table of t_s or utc and one column per field."""

from __future__ import annotations

from datetime import datetime

from queuetail.errors import InputError
from queuetail.telemetry.reading import Reading, stamp_of
from queuetail.telemetry.text import Numbers, Row, Table, column_names, read_table
from queuetail.types import TelemetrySample

COLUMNS = {
    "lat": "lat_deg",
    "lon": "lon_deg",
    "height_agl_m": "height_agl_m",
    "heading_deg": "heading_deg",
    "gimbal_pitch_deg": "gimbal_pitch_deg",
    "gimbal_roll_deg": "gimbal_roll_deg",
    "hfov_deg": "hfov_deg",
}
TIME_COLUMNS = ("t_s", "utc")


def is_own_csv(text: str) -> bool:
    """Tell whether the header has a time column or at least two columns of this format."""
    columns = set(column_names(text))
    return "t_s" in columns or len(columns & {*COLUMNS, *TIME_COLUMNS}) >= 2


def read_own_csv(text: str, source: str) -> Reading:
    """Read the format that `queuetail simulate` writes (docs/telemetry.md).

    Raises InputError without a time column, or without any column that is known.
    """
    table = read_table(text)
    known = [name for name in COLUMNS if name in table.columns]
    if not known:
        raise InputError(
            f"{source}: the header has none of the columns {', '.join(COLUMNS)}; add at least one"
        )
    if not any(name in table.columns for name in TIME_COLUMNS):
        raise InputError(
            f"{source}: the header has no time column; "
            "add t_s (seconds after the first frame) or utc (ISO 8601)"
        )
    numbers = Numbers()
    timed = [(_time_of(row, numbers), row) for row in table.rows]
    untimed = sum(time is None for time, _ in timed)
    if any(isinstance(time, float) for time, _ in timed):
        times = [(time, row) for time, row in timed if isinstance(time, float)]
        first_utc = None
        untimed = len(timed) - len(times)
    else:
        stamps = [(stamp, row) for stamp, row in timed if isinstance(stamp, datetime)]
        first_utc = min((stamp for stamp, _ in stamps), default=None)
        times = [
            ((stamp - first_utc).total_seconds(), row)
            for stamp, row in stamps
            if first_utc is not None
        ]
    samples = [
        TelemetrySample(time, **{COLUMNS[name]: numbers.get(row, name) for name in known})
        for time, row in times
    ]
    notes = (*_notes_on_columns(table, source), *numbers.notes(source))
    if untimed:
        notes = (*notes, f"{untimed} of {len(timed)} lines dropped: no time")
    return Reading(samples, notes, first_utc)


def _time_of(row: Row, numbers: Numbers) -> float | datetime | None:
    seconds = numbers.get(row, "t_s")
    if seconds is not None:
        return seconds
    stamp = row.cells.get("utc")
    if stamp is None:
        return None
    when = stamp_of(stamp)
    if when is None:
        numbers.reject(row, "utc", stamp)
    return when


def _notes_on_columns(table: Table, source: str) -> tuple[str, ...]:
    ignored = [n for n in table.columns if n and n not in COLUMNS and n not in TIME_COLUMNS]
    if not ignored:
        return table.notes
    return (*table.notes, f"{source}: columns not used: {', '.join(ignored)}")
