"""`queuetail live` as a user runs it: a process, a sender, files, health, and a clean end."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import pytest
from rich.console import Console
from test_health import WELL, published

from broadcast import Sender, free_port
from queuetail.cli import main
from queuetail.live.files import owned
from queuetail.live.terminal import StatusView
from short_flight import cut_flight

LIMIT_S = 40.0


def ask(port: int) -> dict[str, Any]:
    """Return what /health says, well or not."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=5) as reply:
            return dict(json.load(reply))
    except urllib.error.HTTPError as error:
        return dict(json.load(error))


def written(record: dict[str, Any]) -> int:
    """Return how many answers are in queue.csv, which leaves out those that came too late."""
    return next(o["delivered"] for o in record["outlets"] if o["name"] == "queue.csv")


def test_a_stream_with_klv_from_start_to_sigterm(flagger: Path, tmp_path: Path) -> None:
    """The bundled flight over UDP with its telemetry beside it, recorded and stored."""
    clip = cut_flight(flagger / "flight.mp4", tmp_path / "flight.ts", 8.0)
    place = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    out, recordings, store = tmp_path / "out", tmp_path / "recordings", tmp_path / "history.db"
    command = [sys.executable, "-m", "queuetail.cli", "live", place, "--port", "0"]
    command += ["--site", str(flagger / "site.toml"), "--out", str(out)]
    command += ["--record", str(recordings), "--store", str(store)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        port = int(re.search(r"127\.0\.0\.1:(\d+)/health", first)[1])  # type: ignore[index]
        assert ask(port)["ok"] is False
        with Sender(clip, f"{place}?pkt_size=1316", "mpegts", telemetry=flagger / "telemetry.csv"):
            end_s = monotonic() + LIMIT_S
            while written(record := ask(port)) < 15:
                assert monotonic() < end_s, record
                sleep(0.1)
        process.send_signal(signal.SIGTERM)
        text, errors = process.communicate(timeout=LIMIT_S)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert errors == ""
    assert "SB: " in text
    assert {o["name"] for o in record["outlets"]} >= {"queue.csv", "recording", "history"}
    assert record["telemetry_age_s"]["position"] < 30
    rows = (out / "queue.csv").read_text().splitlines()[1:]
    assert len(rows) >= 15
    assert all(row.split(",")[1] == "SB" for row in rows)
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    assert events[0]["event"] == "watch_started"
    assert store.stat().st_size > 0
    assert list(recordings.glob("*/*.ts"))
    assert list(recordings.glob("*/*.mcap"))


def test_a_recording_is_played_to_its_end(
    flagger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    clip = cut_flight(flagger / "flight.mp4", tmp_path / "flight.mp4", 1.5)
    command = ["live", str(clip), "--realtime", "--no-store", "--port", "0"]
    command += ["--telemetry", str(flagger / "telemetry.csv")]
    command += ["--site", str(flagger / "site.toml")]
    assert main(command) == 0
    assert "SB:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nowhere.mp4"], "is no file, no device and no address"),
        (["udp://0.0.0.0:5600", "--telemetry", "carrier-pigeon:3"], "no source of live telemetry"),
        (["udp://0.0.0.0:5600", "--telemetry", "LOG"], "play the log in real time with csv:"),
        (["udp://0.0.0.0:5600", "--store", "x://"], "store"),
        (["udp://0.0.0.0:5600", "--store", "LOG"], "the store cannot be used"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(
    words: list[str], sentence: str, flagger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(flagger / "telemetry.csv")
    assert main(["live", *(log if word == "LOG" else word for word in words)]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert error.count("\n") == 1


def test_a_start_that_fails_leaves_the_files_of_others(
    flagger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "queue.csv"
    table.write_text("an earlier run")
    words = ["live", "udp://0.0.0.0:5600", "--no-store", "--out", str(tmp_path)]
    with owned(tmp_path):
        assert main([*words, "--port", "0"]) == 2
    assert "another queuetail live is writing there" in capsys.readouterr().err
    with socket.create_server(("127.0.0.1", 0)) as taken:
        assert main([*words, "--port", str(taken.getsockname()[1])]) == 2
    assert "Address already in use" in capsys.readouterr().err
    assert table.read_text() == "an earlier run"


@pytest.mark.parametrize("words", [["--port", "70000"], ["--duration", "-1"]])
def test_impossible_options_are_refused(words: list[str]) -> None:
    with pytest.raises(SystemExit):
        main(["live", "udp://0.0.0.0:5600", *words])


def test_only_changes_are_printed_where_nobody_watches() -> None:
    console = Console(record=True, force_terminal=False, width=200)
    with StatusView(console) as view:
        view.show(None)
        view.show(published(WELL))
        view.show(published(WELL))
    text = console.export_text()
    assert text.count("NB: UNKNOWN: no picture for 3.0 s") == 1
    assert "latency 40 ms (99 %: 80)" in text
