"""`queuetail feed`: a finished run in every format, and a check of a site's feeds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from cap_schema import check_alert
from lxml import etree
from receivers import RawServer, free_port
from wzdx_schema import device_feed_validator

from queuetail.cli import main
from queuetail.commands.feeds import NAMES
from queuetail.feeds.finished import FORMATS
from queuetail.feeds.webhook import VARIABLE
from queuetail.sinks.tables import QUEUE_COLUMNS, TRACK_COLUMNS

ROWS = """0.000,SB,unknown,,,,,,,,,
1.000,SB,clear,,,,,,,,,
2.000,SB,queued,36.11,-97.0568,900.00,1.00,600.0,300.0,55.00,4,0.10
3.000,SB,queued,36.11,-97.0568,899.00,1.00,600.0,300.0,56.00,4,0.10
9.000,SB,clear,,,,,,,,,
12.000,SB,clear,,,,,,,,,
"""
OK = b"HTTP/1.1 204 No\r\nContent-Length: 0\r\n\r\n"


@pytest.fixture
def run(tmp_path: Path, flagger: Path) -> list[str]:
    """A run's folder, and the site file that it goes with."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "queue.csv").write_text(f"{QUEUE_COLUMNS}\n{ROWS}")
    (folder / "tracks.csv").write_text(TRACK_COLUMNS + "\n")
    (folder / "run.json").write_text('{"video": {"start_utc": "2026-05-14T15:30:00+00:00"}}')
    return [str(folder), "--site", str(flagger / "site.toml")]


def test_every_format_is_offered() -> None:
    assert set(NAMES) == set(FORMATS)


@pytest.mark.parametrize("name", NAMES)
def test_a_run_is_printed(
    name: str, run: list[str], shared: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["feed", "print", *run, "--format", name]) == 0
    text = capsys.readouterr().out
    if name == "wzdx":
        record = json.loads(text)
        device_feed_validator(shared).validate(record)
        assert record["features"][0]["properties"]["eoq"]["utc"] == "2026-05-14T15:30:03.000Z"
    elif name in ("tim", "cifs", "state"):
        assert json.loads(text)
    elif name == "cap":
        check_alert(text.encode())
    elif name == "cot":
        assert etree.fromstring(text.encode()).get("type") == "b-m-p-s-m"
    else:
        assert bytes.fromhex(text.strip())[:2] == b"\x02\x01"


def test_a_moment_without_a_queue_has_no_message(
    run: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    for time_s in ("0", "1", "12"):
        assert main(["feed", "print", *run, "--format", "cap", "--time", time_s]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 3
    assert "end of queue unknown: the run did not know" in told[0]
    assert all("no queue" in line for line in told[1:])
    assert main(["feed", "print", *run, "--time", "-1"]) == 2
    assert "first answer is that of 0.0 s" in capsys.readouterr().err


def test_feeds_are_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "0123456789abcdef")
    posted: list[bytes] = []

    def receive(connection: object) -> None:
        posted.append(connection.recv(65_536))  # type: ignore[attr-defined]
        connection.sendall(OK)  # type: ignore[attr-defined]

    site = tmp_path / "site.toml"
    table = '[[feeds.webhook]]\nname = "{}"\nurl = "http://127.0.0.1:{}/"\nallow_private = true\n'
    with RawServer(receive) as server:
        site.write_text(f"[feeds.wzdx]\n{table.format('here', server.port)}")
        assert main(["feed", "check", str(site)]) == 0
        told = capsys.readouterr()
        assert told.out.splitlines() == [
            "wzdx: ready",
            "here: told that the state is unknown",
            "served by queuetail live at /feeds/wzdx.geojson",
        ]
        assert told.err == ""
        site.write_text(table.format("away", free_port()))
        assert main(["feed", "check", str(site), "--timeout", "0.2"]) == 1
        assert "away: [Errno" in capsys.readouterr().out
    site.write_text("[site]\n")
    assert main(["feed", "check", str(site)]) == 2
    assert "switches no feed on" in capsys.readouterr().err
