"""Reading a run and a truth: CSV columns as arrays, every fault named with its file and line."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import numpy as np

from queuetail.config import Site, read_site
from queuetail.errors import InputError
from queuetail.evaluate.axis import Axis, make_axis
from queuetail.evaluate.records import Answer
from queuetail.types import Floats, Ints, QueueStatus

ANSWERS = {
    QueueStatus.CLEAR.value: Answer.CLEAR,
    QueueStatus.QUEUED.value: Answer.QUEUED,
    QueueStatus.BEYOND_VIEW.value: Answer.BEYOND_VIEW,
    QueueStatus.UNKNOWN.value: Answer.UNKNOWN,
}


@dataclass(frozen=True, slots=True)
class Columns:
    """The columns that were asked for: numbers (NaN where a cell is empty) and texts."""

    numbers: dict[str, Floats]
    texts: dict[str, tuple[str, ...]]


@dataclass(frozen=True, slots=True)
class RunData:
    """What a run wrote: queue.csv, tracks.csv and, where it got that far, run.json."""

    queue: Columns
    answer: Ints  # codes of Answer, one per row of queue.csv
    tracks: Columns
    about: dict[str, Any]


@dataclass(frozen=True, slots=True)
class TruthData:
    """What the simulator wrote: truth.csv, vehicles.csv, road.csv and, if any, site.toml."""

    eoq: Columns
    vehicles: Columns
    axis: Axis
    site: Site | None


def read_run(folder: Path) -> RunData:
    """Read a run's folder; raises InputError with the file, the line and the mend."""
    _require_folder(folder, "a run: give the folder that `queuetail run` wrote")
    queue = read_columns(
        folder / "queue.csv",
        numbers=("t_s", "eoq_lat", "eoq_lon", "eoq_station_m", "eoq_sigma_m"),
        texts=("approach", "status"),
        always=("t_s",),
    )
    tracks = read_columns(
        folder / "tracks.csv",
        numbers=("t_s", "lat", "lon", "station_m", "offset_m", "speed_mps", "u_px", "v_px"),
        texts=("track_id", "approach"),
        always=("t_s",),
    )
    if not len(queue.numbers["t_s"]):
        raise InputError(f"{folder / 'queue.csv'} has no rows: the run processed no frame")
    return RunData(queue, _answers(folder / "queue.csv", queue), tracks, _read_about(folder))


def read_truth(folder: Path) -> TruthData:
    """Read a truth's folder; raises InputError with the file, the line and the mend."""
    _require_folder(folder, "ground truth: give the folder with truth.csv")
    eoq = read_columns(
        folder / "truth.csv",
        numbers=("t_s", "eoq_station_m", "eoq_u_px", "eoq_v_px", "in_view"),
        always=("t_s",),
    )
    if not len(eoq.numbers["t_s"]):
        raise InputError(f"{folder / 'truth.csv'} has no rows")
    if (np.diff(eoq.numbers["t_s"]) <= 0).any():
        raise InputError(f"{folder / 'truth.csv'}: t_s must increase from row to row")
    names = ("t_s", "station_m", "offset_m", "speed_mps", "lat", "lon", "u_px", "v_px")
    vehicles = read_columns(
        folder / "vehicles.csv",
        numbers=names,
        texts=("vehicle_id",),
        always=("t_s", "station_m", "offset_m", "lat", "lon"),
    )
    road = read_columns(
        folder / "road.csv",
        numbers=("station_m", "lat", "lon"),
        always=("station_m", "lat", "lon"),
    ).numbers
    try:
        axis = make_axis(road["station_m"], road["lat"], road["lon"])
    except ValueError as error:
        raise InputError(f"{folder / 'road.csv'}: {error}") from None
    site = read_site(folder / "site.toml") if (folder / "site.toml").exists() else None
    return TruthData(eoq, vehicles, axis, site)


def read_columns(
    path: Path,
    numbers: tuple[str, ...],
    texts: tuple[str, ...] = (),
    always: tuple[str, ...] = (),
) -> Columns:
    """Read columns of a CSV file with a header; those in `always` may have no empty cell."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            header = next(reader, [])
            rows = [(reader.line_num, row) for row in reader if row]
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"{path} is not a CSV file in UTF-8") from None
    lacking = [name for name in (*texts, *numbers) if name not in header]
    if lacking:
        raise InputError(f"{path}: line 1 lacks the column '{lacking[0]}'")
    for line, row in rows:
        if len(row) != len(header):
            raise InputError(
                f"{path}: line {line} has {len(row)} cells, not {len(header)}; was it cut off?"
            )
    cells = (
        dict(zip(header, zip(*(row for _, row in rows), strict=True), strict=True)) if rows else {}
    )
    lines = [line for line, _ in rows]
    return Columns(
        {
            name: _as_numbers(path, name, cells.get(name, ()), lines, name in always)
            for name in numbers
        },
        {name: cells.get(name, ()) for name in texts},
    )


def frame_size(run: RunData, truth_dir: Path) -> tuple[int, int] | None:
    """Return the video's width and height by run.json, else by the truth's flight.mp4, if any."""
    video = run.about.get("video")
    if isinstance(video, dict):
        size = video.get("width_px"), video.get("height_px")
        if all(isinstance(side, int) and side > 0 for side in size):
            return int(size[0]), int(size[1])  # type: ignore[arg-type]
    try:
        with av.open(str(truth_dir / "flight.mp4")) as container:
            stream = container.streams.video[0]
            return int(stream.width), int(stream.height)
    except (OSError, IndexError):  # av's own errors are OSErrors or ValueErrors with files
        return None


def _require_folder(folder: Path, what: str) -> None:
    if not folder.is_dir():
        problem = "is not a folder" if folder.exists() else "does not exist"
        raise InputError(f"{folder} {problem}, so it is not {what}")


def _as_numbers(
    path: Path, name: str, cells: tuple[str, ...], lines: list[int], always: bool
) -> Floats:
    try:
        values = np.array([float(cell) if cell else math.nan for cell in cells])
    except ValueError:
        at = next(i for i, cell in enumerate(cells) if cell and not _is_number(cell))
        raise InputError(
            f"{path}: line {lines[at]}: {name} is {cells[at]!r}, not a number"
        ) from None
    bad = np.isinf(values)
    if always:
        bad |= np.isnan(values)
    if bad.any():
        at = int(np.argmax(bad))
        raise InputError(f"{path}: line {lines[at]}: {name} is {cells[at]!r}, not a finite number")
    return values


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _answers(path: Path, queue: Columns) -> Ints:
    statuses = queue.texts["status"]
    strange = next((s for s in statuses if s not in ANSWERS), None)
    if strange is not None:
        raise InputError(f"{path}: status is {strange!r}, not one of {', '.join(ANSWERS)}")
    return np.array([ANSWERS[s] for s in statuses], dtype=np.int64)


def _read_about(folder: Path) -> dict[str, Any]:
    """Return run.json, or nothing where the run was stopped before it was written."""
    path = folder / "run.json"
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError:
        raise InputError(f"{path} is not valid JSON; was it cut off?") from None
    if not isinstance(about, dict):
        raise InputError(f"{path} is not a JSON object")
    return about
