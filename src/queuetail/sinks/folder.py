"""Reading a run folder back: queue.csv, tracks.csv, events.jsonl and run.json."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from queuetail.errors import InputError
from queuetail.sinks.tables import QUEUE_COLUMNS, TRACK_COLUMNS
from queuetail.types import Bools, Floats, Ints, QueueStatus

TEXTS = ("approach", "status", "state")
STATUSES = frozenset(s.value for s in QueueStatus)
THIN_S = 0.2  # between the samples of one track that a diagram needs


@dataclass(frozen=True, slots=True)
class QueueTable:
    """The rows of queue.csv for one approach, NaN where there is no value."""

    approach: str
    t_s: Floats
    status: tuple[QueueStatus, ...]
    lat: Floats
    lon: Floats
    station_m: Floats
    sigma_m: Floats
    length_m: Floats
    vehicles: Floats
    growth_mps: Floats

    def __len__(self) -> int:
        return len(self.t_s)

    def having(self, *wanted: QueueStatus) -> Bools:
        """Return which rows have one of the states."""
        return np.array([s in wanted for s in self.status], bool)

    @property
    def durations_s(self) -> Floats:
        """How long each row's answer stood: until the next row; the last one as the median."""
        if len(self) < 2:
            return np.zeros(len(self))
        steps = np.diff(self.t_s)
        return np.append(steps, np.median(steps))


@dataclass(frozen=True, slots=True)
class TrackTable:
    """Samples of tracks.csv for one approach, thinned in time."""

    approach: str
    track_id: Ints
    t_s: Floats
    station_m: Floats
    speed_mps: Floats


def read_queue(run_dir: Path) -> tuple[QueueTable, ...]:
    """Read queue.csv, one table per approach; frames before it was known count as unknown.

    Raises InputError where `run_dir` is not a run folder or the file is not a queue.csv.
    """
    rows = []
    for line, row in _rows(run_dir, "queue.csv", QUEUE_COLUMNS):
        _check(run_dir / "queue.csv", line, row, QUEUE_COLUMNS)
        rows.append(row)
    names = list(dict.fromkeys(row[1] for row in rows if row[1])) or ([""] if rows else [])
    tables = []
    for name in names:
        mine = [row for row in rows if row[1] in (name, "")]
        numbers = np.array([[_number(row[i]) for i in (0, *range(3, 12))] for row in mine])
        t_s, lat, lon, station, sigma, _, _, length, vehicles, growth = numbers.T
        status = tuple(QueueStatus(row[2]) for row in mine)
        tables.append(
            QueueTable(name, t_s, status, lat, lon, station, sigma, length, vehicles, growth)
        )
    return tuple(tables)


def read_tracks(run_dir: Path, thin_s: float = THIN_S) -> tuple[TrackTable, ...]:
    """Read tracks.csv, one table per approach (the empty name: on none); none without the file."""
    if not (run_dir / "tracks.csv").is_file():
        return ()
    samples: dict[str, list[tuple[int, float, float, float]]] = {}
    last_s: dict[int, float] = {}
    for line, row in _rows(run_dir, "tracks.csv", TRACK_COLUMNS):
        try:
            track_id, t_s = int(row[1]), float(row[0])
        except ValueError:
            raise InputError(
                f"{run_dir / 'tracks.csv'}, line {line}: t_s or track_id is not a number"
            ) from None
        if t_s - last_s.get(track_id, -math.inf) < thin_s:
            continue
        last_s[track_id] = t_s
        _check(run_dir / "tracks.csv", line, row, TRACK_COLUMNS)
        sample = (track_id, t_s, _number(row[6]), _number(row[8]))
        samples.setdefault(row[2], []).append(sample)
    tables = []
    for name, listed in samples.items():
        ids, t_s, station, speed = np.array(listed, float).T
        tables.append(TrackTable(name, ids.astype(np.int64), t_s, station, speed))
    return tuple(tables)


def read_events(run_dir: Path) -> tuple[dict[str, Any], ...]:
    """Read events.jsonl; a line that is cut off is left out, none without the file."""
    path = run_dir / "events.jsonl"
    events = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
        try:
            event = json.loads(line)
        except json.JSONDecodeError:
            continue
        if isinstance(event, dict):
            events.append(event)
    return tuple(events)


def read_run(run_dir: Path) -> dict[str, Any]:
    """Read run.json; empty without the file. Raises InputError where it is not a JSON object."""
    path = run_dir / "run.json"
    if not path.is_file():
        return {}
    try:
        run = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path} is damaged ({error}); run the video again") from None
    if not isinstance(run, dict):
        raise InputError(f"{path} is not what queuetail run writes; run the video again")
    return run


def _rows(run_dir: Path, name: str, columns: str) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and cells of the whole rows of a table whose header is as it should be."""
    path = run_dir / name
    if not run_dir.is_dir():
        raise InputError(f"{run_dir}: there is no such run folder")
    if not path.is_file():
        raise InputError(
            f"{run_dir} is not a run folder: it has no {name} (queuetail run makes one)"
        )
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.reader(file)
            if next(rows, None) != columns.split(","):
                raise InputError(
                    f"{path}, line 1: expected the columns {columns.replace(',', ', ')}"
                )
            width = columns.count(",") + 1
            for row in rows:
                if len(row) == width:
                    yield rows.line_num, row
                elif row:
                    _refuse_unless_last(path, rows, row)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path} is damaged ({error}); run the video again") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None


def _check(path: Path, line: int, row: list[str], columns: str) -> None:
    """Refuse a cell that is not what its column promises."""
    for name, cell in zip(columns.split(","), row, strict=True):
        if name == "status" and cell not in STATUSES:
            raise InputError(f"{path}, line {line}: '{cell}' is not a status")
        if name in TEXTS or not cell:
            continue
        try:
            float(cell)
        except ValueError:
            raise InputError(f"{path}, line {line}: '{cell}' is not a number ({name})") from None


def _refuse_unless_last(path: Path, rows: Any, row: list[str]) -> None:
    """A short last row is what a killed copy leaves; anywhere else the file is damaged."""
    line = rows.line_num
    if next(rows, None) is not None:
        raise InputError(f"{path}, line {line}: {len(row)} cells, which is not a row of this table")


def _number(cell: str) -> float:
    return float(cell) if cell else math.nan
