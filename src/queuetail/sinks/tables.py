"""queue.csv and tracks.csv: the numbers, in the columns that docs/outputs.md promises."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from queuetail.geo.near_origin import fast_geodetic
from queuetail.sinks import RunInfo
from queuetail.sinks.lines import LineFile
from queuetail.types import (
    Approach,
    Floats,
    Frame,
    GroundMapping,
    Observation,
    QueueState,
    QueueStatus,
    TrackState,
    Unknown,
)

QUEUE_COLUMNS = (
    "t_s,approach,status,eoq_lat,eoq_lon,eoq_station_m,eoq_sigma_m,eoq_u_px,eoq_v_px,"
    "length_m,vehicles,growth_mps"
)
TRACK_COLUMNS = (
    "t_s,track_id,approach,lane,lat,lon,station_m,offset_m,speed_mps,length_m,u_px,v_px,state"
)
TRACK_DECIMALS = np.array([8, 8, 2, 2, 2, 2, 1, 1])  # lat … v_px
TRACK_ROW = "%.8f,%.8f,%.2f,%.2f,%.2f,%.2f,%.1f,%.1f"
NO_APPROACH = (QueueState("", QueueStatus.UNKNOWN),)


class QueueCsv:
    """queue.csv: one row per processed frame and approach."""

    def __init__(self, info: RunInfo) -> None:
        self._file = LineFile(info.out / "queue.csv", QUEUE_COLUMNS)

    def write(self, frame: Frame, observation: Observation) -> None:
        """Add the rows of one frame."""
        self._file.extend(queue_rows(observation))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


class TracksCsv:
    """tracks.csv: one row per confirmed vehicle and frame."""

    def __init__(self, info: RunInfo) -> None:
        self._file = LineFile(info.out / "tracks.csv", TRACK_COLUMNS)

    def write(self, frame: Frame, observation: Observation) -> None:
        """Add the rows of one frame."""
        self._file.extend(track_rows(observation))

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def queue_rows(observation: Observation) -> list[str]:
    """Return the lines of queue.csv for one frame; one ``unknown`` where there is no approach."""
    time_text = f"{observation.t_s:.3f}"
    rows = []
    for state in observation.states or NO_APPROACH:
        head = f"{time_text},{quoted(state.approach)},{state.status.value}"
        eoq = state.eoq
        if eoq is None:
            rows.append(head + "," * 9)
            continue
        cells = (
            _cell(eoq.lat_deg, 8),
            _cell(eoq.lon_deg, 8),
            _cell(eoq.station_m, 2),
            _cell(eoq.sigma_m, 2),
            _cell(eoq.px[0], 1),
            _cell(eoq.px[1], 1),
            _cell(eoq.length_m, 2),
            str(eoq.vehicles),
            _cell(eoq.growth_mps, 2),
        )
        rows.append(f"{head},{','.join(cells)}")
    return rows


def track_rows(observation: Observation) -> list[str]:
    """Return the lines of tracks.csv for one frame."""
    vehicles, tracks = observation.vehicles, observation.vehicles.tracks
    shown = [i for i, state in enumerate(tracks.states) if state is not TrackState.TENTATIVE]
    if not shown:
        return []
    values = np.column_stack(
        [
            *_geodetic(observation.mapping, tracks.enu[shown]),
            vehicles.station_m[shown],
            vehicles.offset_m[shown],
            vehicles.speed_mps[shown],
            tracks.length_m[shown],
            tracks.px[shown],
        ]
    )
    numbers = _formatted(values)
    names = _approach_names(observation.approaches)
    time_text = f"{observation.t_s:.3f}"
    return [
        f"{time_text},{track_id},{names[approach]},{lane or ''},{text},{tracks.states[i].value}"
        for i, track_id, approach, lane, text in zip(
            shown,
            tracks.ids[shown].tolist(),
            vehicles.approach[shown].tolist(),
            vehicles.lane[shown].tolist(),
            numbers,
            strict=True,
        )
    ]


@lru_cache(maxsize=256)
def quoted(text: str) -> str:
    """Return `text` as one CSV cell on one line, quoted where that is needed."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="").writerow([" ".join(text.split()), ""])
    return buffer.getvalue()[:-1]


def _formatted(values: Floats) -> list[str]:
    """Return one joined text per row; cells without a finite value stay empty."""
    rounded = (
        np.column_stack(  # + 0.0 turns -0.0 into 0.0
            [np.round(column, d) for column, d in zip(values.T, TRACK_DECIMALS, strict=True)]
        )
        + 0.0
    )
    if np.isfinite(rounded).all():
        return [TRACK_ROW % tuple(row) for row in rounded.tolist()]
    return [
        ",".join(_cell(v, d) for v, d in zip(row, TRACK_DECIMALS.tolist(), strict=True))
        for row in rounded.tolist()
    ]


def _geodetic(mapping: GroundMapping | Unknown, enu: Floats) -> tuple[Floats, Floats]:
    if isinstance(mapping, Unknown) or mapping.origin is None:
        nothing = np.full(len(enu), np.nan)
        return nothing, nothing
    return fast_geodetic(enu, mapping.origin)


def _approach_names(approaches: Sequence[Approach]) -> list[str]:
    """Return the approaches' names as cells; index -1 (no approach) gives the empty one."""
    return [*(quoted(a.name) for a in approaches), ""]


def _cell(value: float | None, decimals: int) -> str:
    if value is None or not np.isfinite(value):
        return ""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"
