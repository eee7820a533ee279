"""`queuetail history`: lists, tables, CSV, JSON, and the import of a run."""

from __future__ import annotations

import csv
import io
import json
import shutil
from pathlib import Path

import pytest

from queuetail.cli import main
from queuetail.run import run
from short_flight import cut_flight

SECONDS = 4.0


@pytest.fixture(scope="module")
def run_dir(flagger: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the bundled flight's first seconds."""
    folder = tmp_path_factory.mktemp("run")
    video = cut_flight(flagger / "flight.mp4", folder / "short.mp4", SECONDS)
    run(
        video,
        flagger / "telemetry.csv",
        flagger / "site.toml",
        out=folder / "out",
        with_video=False,
    )
    return folder / "out"


@pytest.fixture
def database(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], flagger: Path
) -> tuple[str, str]:
    """A store with that run in it, and the run's name there."""
    store = str(tmp_path / "h.db")
    command = ["history", "import", str(run_dir), "--store", store]
    assert main([*command, "--start", "2026-05-14T15:30:00Z"]) == 0
    return store, capsys.readouterr().out.split()[0]


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["history", *arguments]) == 0
    return capsys.readouterr().out


def test_a_run_is_listed(database: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    store, name = database
    (flight,) = json.loads(printed(capsys, "--store", store, "--json"))
    assert flight["id"] == name
    assert flight["started_utc"] == "2026-05-14T15:30:00+00:00"
    assert flight["last_utc"].startswith("2026-05-14T15:30:0")
    assert flight["is_finished"]
    assert 4 <= flight["answers"] <= 6
    assert flight["events"] >= 1
    assert name in printed(capsys, "--store", store)


def test_history_and_events(database: tuple[str, str], capsys: pytest.CaptureFixture[str]) -> None:
    store, name = database
    text = printed(capsys, "--store", store, "--flight", name, "--show", "eoq", "--csv")
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [r["approach"] for r in rows] == ["SB"] * len(rows)
    assert rows[0]["status"] == "unknown"
    since = "2026-05-14T15:30:01.5"
    later = json.loads(
        printed(capsys, "--store", store, "--show", "eoq", "--json", "--since", since)
    )
    assert len(later) == sum(float(r["t_s"]) >= 1.5 for r in rows)
    events = json.loads(printed(capsys, "--store", store, "--flight", name, "--json"))
    assert events[0]["event"] == "watch_started"
    assert "watch_started" in printed(capsys, "--store", store, "--flight", name)
    assert printed(capsys, "--store", store, "--show", "eoq", "--approach", "WB") == (
        "no eoq there\n"
    )


def test_importing_again_replaces(
    database: tuple[str, str], run_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store, _ = database
    before = printed(capsys, "--store", store, "--json")
    command = ["history", "--store", store, "import", str(run_dir)]
    assert main([*command, "--start", "2026-05-14T10:30:00-05:00"]) == 0
    capsys.readouterr()
    assert printed(capsys, "--store", store, "--json") == before


def test_what_is_missing_is_said(
    run_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], database: tuple[str, str]
) -> None:
    undated = tmp_path / "undated"
    shutil.copytree(run_dir, undated)
    record = json.loads((undated / "run.json").read_text("utf-8"))
    record["video"]["start_utc"] = None
    (undated / "run.json").write_text(json.dumps(record), "utf-8")
    assert main(["history", "import", str(undated), "--store", str(tmp_path / "h.db")]) == 2
    assert "give --start" in capsys.readouterr().err
    assert main(["history", "--store", str(tmp_path / "no.db")]) == 2
    assert "there is no history there yet" in capsys.readouterr().err
    assert main(["history", "--store", database[0], "--flight", "nobody"]) == 2
    assert "has no flight nobody" in capsys.readouterr().err
    assert main(["history", "--store", "postgresql://a:b@c/d"]) == 2
    assert "a password on the command line" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["history", "--since", "yesterday"])
    assert "'yesterday' is no moment" in capsys.readouterr().err
