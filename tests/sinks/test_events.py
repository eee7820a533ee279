"""The event machine, by table, and the lines it writes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import synthetic

from queuetail.sinks.events import Event, EventsJsonl, Memory, event_line, next_events
from queuetail.types import EndOfQueue, QueueState, QueueStatus, Unknown

CLEAR = QueueState("EB", QueueStatus.CLEAR)
LOST = QueueState("EB", QueueStatus.UNKNOWN, None, ("too dark",))


def queued(station_m: float, status: QueueStatus = QueueStatus.QUEUED) -> QueueState:
    end = EndOfQueue(station_m, 1.0, (0, 0), (0, 0), None, None, 7, 30.0, 4, float("nan"))
    return QueueState("EB", status, end)


def beyond(station_m: float) -> QueueState:
    return queued(station_m, QueueStatus.BEYOND_VIEW)


@pytest.mark.parametrize(
    ("states", "expected"),
    [
        ([CLEAR, CLEAR], ["watch_started", ""]),
        ([LOST, LOST, CLEAR], ["watch_started", "", "view_recovered"]),
        ([queued(9)], ["watch_started queue_formed"]),
        ([CLEAR, queued(90), CLEAR], ["watch_started", "queue_formed", "queue_dissolved"]),
        ([CLEAR, queued(90), queued(70)], ["watch_started", "queue_formed", ""]),
        (
            [CLEAR, queued(90), queued(64), queued(50), queued(90)],
            ["watch_started", "queue_formed", "queue_moved", "", "queue_moved"],
        ),
        (
            [CLEAR, queued(90), LOST, queued(60), queued(50)],
            ["watch_started", "queue_formed", "view_lost", "view_recovered", ""],
        ),
        (
            [CLEAR, queued(90), LOST, CLEAR, queued(90)],
            ["watch_started", "queue_formed", "view_lost", "view_recovered queue_dissolved",
             "queue_formed"],
        ),
        ([CLEAR, LOST, queued(9)], ["watch_started", "view_lost", "view_recovered queue_formed"]),
        (
            [CLEAR, queued(90), beyond(80), beyond(10), queued(5), CLEAR],
            ["watch_started", "queue_formed", "beyond_view", "queue_moved", "back_in_view",
             "queue_dissolved"],
        ),
        ([CLEAR, beyond(80)], ["watch_started", "queue_formed beyond_view"]),
        (
            [CLEAR, beyond(80), LOST, beyond(80)],
            ["watch_started", "queue_formed beyond_view", "view_lost", "view_recovered"],
        ),
    ],
)  # fmt: skip
def test_machine(states: list[QueueState], expected: list[str]) -> None:
    memory, said = Memory(), []
    for state in states:
        memory, events = next_events(memory, state)
        said.append(" ".join(events))
    assert said == expected


def test_line_has_every_key_and_no_nan() -> None:
    record = json.loads(event_line(1.23456, Event.QUEUE_FORMED, queued(12.345678)))
    assert list(record) == [
        "t_s", "approach", "event", "status", "eoq_lat", "eoq_lon", "eoq_station_m",
        "eoq_sigma_m", "length_m", "vehicles", "growth_mps", "reasons",
    ]  # fmt: skip
    assert record["t_s"] == 1.235
    assert record["eoq_station_m"] == 12.35
    assert record["growth_mps"] is None
    assert json.loads(event_line(0, Event.VIEW_LOST, LOST))["reasons"] == ["too dark"]


def test_run_writes_its_story(tmp_path: Path) -> None:
    sink = EventsJsonl(synthetic.info(tmp_path))
    for shot, shown in synthetic.short_run():
        sink.write(shot, shown)
    sink.close()
    said = [json.loads(x)["event"] for x in (tmp_path / "events.jsonl").read_text().splitlines()]
    assert said == [
        "watch_started", "queue_formed", "queue_moved", "view_lost", "view_recovered",
        "beyond_view", "back_in_view", "queue_dissolved",
    ]  # fmt: skip


def test_frames_without_approaches_are_view_lost(tmp_path: Path) -> None:
    sink = EventsJsonl(synthetic.info(tmp_path))
    shot, shown = synthetic.short_run()[0]
    sink.write(shot, shown)
    lost = synthetic.observation(1, 1.0, [], None, Unknown(("no pose",)), approaches=())
    sink.write(shot, lost)
    sink.close()
    last = json.loads((tmp_path / "events.jsonl").read_text().splitlines()[-1])
    assert (last["approach"], last["event"], last["reasons"]) == ("EB", "view_lost", ["no pose"])
