"""Where the console's data come from: a live run's newest answers, a finished run's files."""

from __future__ import annotations

import asyncio
import json
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from answers_double import MAPPING, ORIGIN, ROAD, SITE, answer, live_source, lost
from fastapi.testclient import TestClient

from queuetail.cli import main
from queuetail.commands.console import print_code
from queuetail.config import read_site
from queuetail.console.app import create_api
from queuetail.console.auth import Access
from queuetail.console.live_source import PAST_S, LiveSource
from queuetail.console.map_view import flat_picture
from queuetail.console.overlay import drawing
from queuetail.console.run_source import RunSource
from queuetail.errors import InputError
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import px_to_enu
from queuetail.sinks.tables import QUEUE_COLUMNS, TRACK_COLUMNS, queue_rows, track_rows
from queuetail.types import GroundMapping, QueueStatus


def test_who_waits_is_woken_by_the_next_answer() -> None:
    source = live_source()
    source.take(answer(1))

    async def waiting() -> tuple[Any, Any, Any]:
        at_once = await source.newer(0, 5.0)
        nothing = await source.newer(1, 0.01)
        timer = threading.Timer(0.05, source.take, [answer(2)])
        timer.start()
        woken = await source.newer(1, 10.0)
        timer.join()
        return at_once, nothing, woken

    at_once, nothing, woken = asyncio.run(waiting())
    assert at_once is not None
    assert at_once.number == 1
    assert nothing is None
    assert woken.number == 2
    source.take(answer(3))  # whoever waited is gone, and its loop too


def test_the_past_is_thinned_and_ends() -> None:
    source = live_source()
    for number in range(1, 101):
        source.take(answer(number))
    times = [p.t_s for p in source.past(0.0, 100.0)]
    assert len(times) == 20
    assert min(np.diff(times)) >= 0.5 - 1e-9
    assert {p.approach for p in source.paths(0.0, 100.0)} == {"NB"}
    source.take(answer(round(10 * (PAST_S + 50))))
    assert len(source.past(0.0, 1e9)) == 1
    assert len(source.paths(0.0, 1e9)) == 1


def test_what_is_drawn_lies_in_the_picture() -> None:
    drawn = drawing(answer(1))
    json.dumps(drawn, allow_nan=False)
    assert [b[1] for b in drawn["boxes"]] == ["end", "queued", "moving"]
    assert [b[2] for b in drawn["boxes"]] == [False, True, False]
    (end,) = drawn["ends"]
    ground = px_to_enu(MAPPING, np.array(end["bar"]))
    assert ground[:, 0] == pytest.approx(-10.0, abs=0.1)  # station 1190 of an axis from -200 m
    assert len(end["sigma"]) == 2
    assert {lane["dashed"] for lane in drawn["lanes"]} == {True, False}
    for ticks in (drawn["ticks"], drawn["ticks_ft"]):
        assert len(ticks) > 1
        assert all(int(tick["text"]) % 10 == 0 for tick in ticks)
    nothing = drawing(lost(2))
    assert nothing["ends"] == nothing["lanes"] == nothing["boxes"] == []


def test_the_picture_laid_flat_is_where_it_should_be() -> None:
    base = flat_picture(answer(1))
    assert base is not None
    lat, lon = geodetic_from_enu(np.array([[0.0, 60.0]]), ORIGIN)
    assert base.south_west[0] < lat[0] < base.north_east[0]
    assert base.south_west[1] < lon[0] < base.north_east[1]
    assert flat_picture(lost(2)) is None


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The tables of a run: clear, queued, unknown."""
    answers = [answer(n, None if n < 10 else 1190.0 + n / 10) for n in range(1, 30)]
    answers.append(lost(30))
    queue = [QUEUE_COLUMNS, *(row for a in answers for row in queue_rows(a.observation))]
    tracks = [TRACK_COLUMNS, *(row for a in answers for row in track_rows(a.observation))]
    (tmp_path / "queue.csv").write_text("\n".join(queue) + "\n", encoding="utf-8")
    (tmp_path / "tracks.csv").write_text("\n".join(tracks) + "\n", encoding="utf-8")
    return tmp_path


def write_record(folder: Path) -> None:
    """Add what `queuetail run` says of itself."""
    lat_lon = np.column_stack(geodetic_from_enu(ROAD.axis_enu, ORIGIN)).tolist()
    approach = {"name": "NB", "lanes": 2, "lane_width_m": 3.6, "start_station_m": 1000.0}
    approach |= {"axis_lat_lon": lat_lon, "axis_enu_m": ROAD.axis_enu.tolist()}
    record = {
        "preset": "road",
        "video": {"name": "a.mp4", "start_utc": "2026-05-14T15:30:00+00:00"},
        "approaches": [approach],
        "settings": SITE.model_dump(mode="json"),
    }
    (folder / "run.json").write_text(json.dumps(record), encoding="utf-8")


def test_a_finished_run_tells_what_it_wrote(folder: Path) -> None:
    write_record(folder)
    source = RunSource(folder)
    assert (source.about.is_live, source.about.start_s, source.about.end_s) == (False, 0.1, 3.0)
    before = source.at(0.95)
    assert before is not None
    assert before.observation.states[0].status is QueueStatus.CLEAR
    shown = source.at(2.0)
    assert shown is not None
    assert shown.utc.isoformat() == "2026-05-14T15:30:02+00:00"
    (state,) = shown.observation.states
    assert state.eoq is not None
    assert state.eoq.station_m == pytest.approx(1192.0)
    assert state.eoq.track_id == 1
    assert shown.observation.vehicles.queued.tolist() == [True, True, False]
    last = source.newest()
    assert last is not None
    assert last.observation.states[0].status is QueueStatus.UNKNOWN
    assert len(source.past(0.0, 100.0)) == 30
    assert len(source.past(1.0, 2.0)) == 11
    assert [len(p.ids) for p in source.paths(0.0, 100.0)][:2] == [3, 3]


def test_a_finished_run_answers_as_a_live_one(folder: Path) -> None:
    write_record(folder)
    client = TestClient(create_api(RunSource(folder), Access()), base_url="http://127.0.0.1")
    record = client.get("/api/v1/state?t_s=2").json()
    assert record["live"] is False
    assert record["age_s"] is None
    assert record["approaches"][0]["signs"][0]["distance_m"] == pytest.approx(492.0)
    assert client.get("/api/v1/picture?t_s=2").status_code == 404
    kinds = {f["properties"]["kind"] for f in client.get("/api/v1/map?t_s=2").json()["features"]}
    assert {"eoq", "past"} <= kinds
    assert client.get("/health").status_code == 200
    for path in ("/api/v1/tracks?t_s=2", "/api/v1/history", "/api/v1/paths", "/api/v1/health"):
        assert client.get(path).status_code == 200


def test_tables_alone_will_do(folder: Path) -> None:
    (folder / "tracks.csv").unlink()
    source = RunSource(folder)
    shown = source.at(2.0)
    assert shown is not None
    assert shown.observation.states[0].eoq is not None
    assert source.about.title == folder.name


def test_the_flights_own_video_brings_pictures_and_their_place(
    flagger: Path, tmp_path: Path
) -> None:
    """A run of one moment of the bundled flight, whose numbers come from its truth."""
    t_s = 40.0
    head = f"{t_s:.3f},SB,queued,36.10989878,-97.05676593,932.01,0.5,811.2,369.2,50.0,3,0.5"
    (tmp_path / "queue.csv").write_text(f"{QUEUE_COLUMNS}\n{head}\n", encoding="utf-8")
    site = flagger / "site.toml"

    video = flagger / "flight.mp4"
    source = RunSource(tmp_path, read_site(site), site, video, flagger / "telemetry.csv")
    try:
        shown = source.at(t_s)
        assert shown is not None
        assert shown.frame is not None
        picture = shown.frame.bgr(64, 36)
        assert picture.std() > 1
        assert (shown.frame.bgr(64, 36) == picture).all()
        mapping = shown.observation.mapping
        assert isinstance(mapping, GroundMapping)
        assert mapping.pose is not None
        place = px_to_enu(mapping, np.array([[811.2, 369.2]]))
        lat, lon = geodetic_from_enu(place, mapping.origin)  # type: ignore[arg-type]
        assert float(lat[0]) == pytest.approx(36.10989878, abs=5e-5)
        assert float(lon[0]) == pytest.approx(-97.05676593, abs=5e-5)
        assert flat_picture(shown) is not None
    finally:
        source.close()


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("queue.csv", None, "is not a run folder: it has no queue.csv"),
        ("queue.csv", QUEUE_COLUMNS + "\n", "has no rows"),
        ("queue.csv", QUEUE_COLUMNS + "\n1.0,NB,jammed,,,,,,,,,\n", "status is 'jammed'"),
        (
            "queue.csv",
            QUEUE_COLUMNS + "\nx,NB,clear,,,,,,,,,\n",
            "line 2: t_s is 'x', not a number",
        ),
        ("tracks.csv", TRACK_COLUMNS + "\n1.0,1,NB,1,,,,,,,,,flying\n", "a state is not one of"),
        ("run.json", '{"settings": {"site": {"nam": 1}}}', "are of another version"),
    ],
)
def test_a_folder_that_is_no_run_is_refused(
    folder: Path, name: str, text: str | None, said: str
) -> None:
    if text is None:
        (folder / name).unlink()
    else:
        (folder / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=said):
        RunSource(folder)


def test_what_open_refuses(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["open", str(folder / "nothing")]) == 2
    assert "is not a run folder" in capsys.readouterr().err
    assert main(["open", str(folder), "--telemetry", "x.csv"]) == 2
    assert "give --video, too" in capsys.readouterr().err
    shutil.copy(folder / "queue.csv", folder / "flight.mp4")
    assert main(["open", str(folder), "--video", str(folder / "flight.mp4")]) == 2
    assert capsys.readouterr().err.startswith("queuetail: ")


def test_the_code_for_the_phone_is_for_terminals(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    print_code("http://10.0.0.5:8080/?token=x")
    assert capsys.readouterr().out == ""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    print_code("http://10.0.0.5:8080/?token=x")
    assert "█" in capsys.readouterr().out


def test_a_source_is_not_slowed_by_many_waiting(source: LiveSource) -> None:
    async def crowd() -> int:
        waiting = [asyncio.ensure_future(source.newer(40, 10.0)) for _ in range(50)]
        await asyncio.sleep(0)
        source.take(answer(41))
        return sum(p is not None for p in await asyncio.gather(*waiting))

    assert asyncio.run(crowd()) == 50
