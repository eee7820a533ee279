"""queue.csv and tracks.csv hold exactly the promised columns and whole rows."""

from __future__ import annotations

import csv
import dataclasses
import math
import time
from pathlib import Path

import numpy as np
import pytest
import synthetic
from hypothesis import given
from hypothesis import strategies as st

from queuetail.errors import InputError
from queuetail.sinks.tables import (
    QUEUE_COLUMNS,
    TRACK_COLUMNS,
    QueueCsv,
    TracksCsv,
    queue_rows,
    track_rows,
)
from queuetail.types import (
    Approach,
    EndOfQueue,
    QueueState,
    QueueStatus,
    TrackState,
    Unknown,
)

DESIGN_QUEUE = [
    "t_s", "approach", "status", "eoq_lat", "eoq_lon", "eoq_station_m", "eoq_sigma_m",
    "eoq_u_px", "eoq_v_px", "length_m", "vehicles", "growth_mps",
]  # fmt: skip
DESIGN_TRACKS = [
    "t_s", "track_id", "approach", "lane", "lat", "lon", "station_m", "offset_m", "speed_mps",
    "length_m", "u_px", "v_px", "state",
]  # fmt: skip


def test_columns_are_the_designs() -> None:
    assert QUEUE_COLUMNS.split(",") == DESIGN_QUEUE
    assert TRACK_COLUMNS.split(",") == DESIGN_TRACKS


def test_golden_rows() -> None:
    ground = synthetic.mapping()
    state = QueueState("EB", QueueStatus.QUEUED, synthetic.eoq(600.0, ground))
    states = [TrackState.CONFIRMED, TrackState.TENTATIVE, TrackState.COASTING]
    seen = synthetic.vehicles([600.0, 605, 620], [-0.001, 3, 12.346], ground, states)
    seen = dataclasses.replace(seen, approach=np.array([0, 0, -1]), lane=np.array([2, 2, 0]))
    shown = synthetic.observation(0, 1.23449, [state], seen, ground)
    assert queue_rows(shown) == [
        "1.234,EB,queued,36.11013293,-97.05677787,600.00,1.50,197.8,160.4,40.00,3,0.40"
    ]
    assert track_rows(shown) == [
        "1.234,1,EB,2,36.11013293,-97.05677787,600.00,-5.25,0.00,5.00,197.8,160.4,confirmed",
        "1.234,3,,,36.11013293,-97.05655574,620.00,-5.25,12.35,5.00,235.6,160.4,coasting",
    ]


def test_no_approach_gives_one_unknown_row() -> None:
    assert queue_rows(synthetic.observation(0, 0.0)) == ["0.000,,unknown,,,,,,,,,"]


def test_local_metres_leave_latitude_empty() -> None:
    ground = dataclasses.replace(synthetic.mapping(), origin=None)
    seen = synthetic.vehicles([600.0], [1.0], ground)
    for where in (ground, Unknown(("lost",))):
        row = track_rows(synthetic.observation(0, 0.0, [], seen, where))[0].split(",")
        assert row[4:6] == ["", ""]
        assert len(row) == len(DESIGN_TRACKS)


def test_awkward_names_stay_one_cell() -> None:
    approach = Approach('A, "B"\nC', synthetic.EAST.axis_enu)
    state = QueueState(approach.name, QueueStatus.CLEAR)
    rows = queue_rows(synthetic.observation(0, 0.0, [state], approaches=(approach,)))
    assert [len(r) for r in csv.reader(rows)] == [len(DESIGN_QUEUE)]
    assert next(csv.reader(rows))[1] == 'A, "B" C'


numbers = st.floats(allow_nan=True, allow_infinity=True)


@given(
    name=st.text(max_size=12),
    status=st.sampled_from(QueueStatus),
    values=st.lists(numbers, min_size=7, max_size=7),
    lane=st.integers(0, 4),
    approach=st.integers(-1, 0),
)
def test_any_observation_gives_parsable_rows(
    name: str, status: QueueStatus, values: list[float], lane: int, approach: int
) -> None:
    station, sigma, u, v, length, growth, speed = values
    ground = synthetic.mapping()
    end = EndOfQueue(station, sigma, (0, 0), (u, v), None, None, 1, length, 2, growth)
    seen = synthetic.vehicles([0.0], [0.0], ground)
    seen = dataclasses.replace(
        seen,
        station_m=np.array([station]),
        speed_mps=np.array([speed]),
        lane=np.array([lane]),
        approach=np.array([approach]),
        tracks=dataclasses.replace(seen.tracks, enu=np.array([[u, v]])),
    )
    road = Approach(name, synthetic.EAST.axis_enu)
    shown = synthetic.observation(
        0, 0.0, [QueueState(name, status, end)], seen, ground, approaches=(road,)
    )
    for rows, columns in ((queue_rows(shown), DESIGN_QUEUE), (track_rows(shown), DESIGN_TRACKS)):
        parsed = list(csv.reader(rows))
        assert [len(r) for r in parsed] == [len(columns)] * len(rows)
        for column, cell in zip(columns, parsed[0], strict=True):
            if column not in ("approach", "status", "state"):
                assert cell == "" or math.isfinite(float(cell))


def test_rows_reach_the_disk_before_close(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sink = QueueCsv(synthetic.info(tmp_path))
    clock = time.monotonic() + 5
    monkeypatch.setattr(time, "monotonic", lambda: clock)
    sink.write(*synthetic.short_run()[0])
    text = (tmp_path / "queue.csv").read_text()
    assert text.splitlines()[1].startswith("0.000,EB,clear")
    assert text.endswith("\n")
    sink.close()


def test_interrupted_after_a_few_frames_is_whole(tmp_path: Path) -> None:
    sinks = [QueueCsv(synthetic.info(tmp_path)), TracksCsv(synthetic.info(tmp_path))]
    for shot, shown in synthetic.short_run()[:7]:
        for sink in sinks:
            sink.write(shot, shown)
    for sink in sinks:
        sink.close()
        sink.close()
    assert len((tmp_path / "queue.csv").read_text().splitlines()) == 8
    assert len((tmp_path / "tracks.csv").read_text().splitlines()) == 1 + 7 * 3


def test_unwritable_folder_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"queue\.csv cannot be written: No such file"):
        QueueCsv(synthetic.info(tmp_path / "nowhere"))
