"""report.html is one whole page for any run, also for an empty one."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import synthetic

from queuetail.errors import InputError
from queuetail.sinks.folder import read_queue, read_tracks
from queuetail.sinks.report import key_figures, write_report
from queuetail.sinks.standard import standard_sinks
from queuetail.sinks.tables import QUEUE_COLUMNS, TRACK_COLUMNS
from queuetail.types import Frame, Observation, Unknown

VOID = {"meta", "img", "link", "br", "hr", "input"}


class Page(HTMLParser):
    """Checks that tags balance and collects what the page would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in VOID:
            self.open.append(tag)
        self.loads += [v or "" for k, v in attrs if k in ("src", "href", "xlink:href", "srcset")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


def written(out: Path, run: list[tuple[Frame, Observation]], name: str = "a test") -> str:
    sinks = standard_sinks(synthetic.info(out, name=name), video=False)
    for shot, shown in run:
        for sink in sinks:
            sink.write(shot, shown)
    axis = synthetic.EAST.axis_enu.tolist()
    record = {"site": name, "approaches": [{"name": "EB", "axis_enu_m": axis, "lanes": 2,
              "start_station_m": 500.0, "axis_lat_lon": None}]}  # fmt: skip
    (out / "run.json").write_text(json.dumps(record))
    for sink in sinks:
        sink.close()
    return (out / "report.html").read_text(encoding="utf-8")


def checked(text: str) -> Page:
    page = Page(text)
    assert page.open == []
    assert all(load.startswith(("data:", "#")) for load in page.loads)
    assert not re.search(r"(url\(|@import)\s*['\"]?https?:", text)
    assert "<script" not in text
    return page


def test_whole_run(tmp_path: Path) -> None:
    text = written(tmp_path, synthetic.short_run(), 'Bridge <b>"7"</b> & co')
    page = checked(text)
    assert len(text) < 3_000_000
    assert 'Bridge <b>"7"</b> & co' in page.words
    assert "<b>" not in text
    for words in ("time queued", "longest queue", "queue formed", "registration lost",
                  "beyond view", "Time–space diagram, EB", "latitude", "drone"):  # fmt: skip
        assert words in text
    assert "data:image/jpeg" in text


def test_regenerated_from_the_folder_alone(tmp_path: Path) -> None:
    written(tmp_path, synthetic.short_run())
    text = write_report(tmp_path).read_text(encoding="utf-8")
    assert "There is no picture" in checked(text).words


def test_regenerated_with_the_annotated_video(tmp_path: Path) -> None:
    sinks = standard_sinks(synthetic.info(tmp_path), video=True)
    for shot, shown in synthetic.short_run(20):
        for sink in sinks:
            sink.write(shot, shown)
    for sink in sinks:
        sink.close()
    text = write_report(tmp_path).read_text(encoding="utf-8")
    assert "There is no picture" not in checked(text).words


def test_an_older_runs_video_is_removed(tmp_path: Path) -> None:
    (tmp_path / "annotated.mp4").write_bytes(b"old")
    written(tmp_path, synthetic.short_run(5))
    assert not (tmp_path / "annotated.mp4").exists()


@pytest.mark.parametrize(
    ("run", "words"),
    [
        ([], "No frame was processed"),
        ([(synthetic.frame(0, 0.0), synthetic.observation(0, 0.0))], "No approach was found"),
        (synthetic.short_run()[:10], "no queue was seen"),
        (
            [
                (shot, dataclasses.replace(shown, mapping=Unknown(("no pose",)), approaches=()))
                for shot, shown in synthetic.short_run()[31:35]
            ],
            "unknown for the whole run",
        ),
        (synthetic.short_run()[20:21], "a queue stood for 0.0 s"),
    ],
)
def test_thin_runs_say_so(tmp_path: Path, run: list[tuple[Frame, Observation]], words: str) -> None:
    assert words in checked(written(tmp_path, run)).words


def test_local_metres_only(tmp_path: Path) -> None:
    ground = dataclasses.replace(synthetic.mapping(), origin=None, pose=None)
    run = []
    for shot, shown in synthetic.short_run():
        states = tuple(
            dataclasses.replace(
                s, eoq=s.eoq and dataclasses.replace(s.eoq, lat_deg=None, lon_deg=None)
            )
            for s in shown.states
        )
        run.append((shot, dataclasses.replace(shown, mapping=ground, states=states)))
    page = checked(written(tmp_path, run))
    assert "metres of the site file" in page.words
    assert "North is up" not in page.words
    assert "latitude" not in page.words


def test_key_figures_by_hand(tmp_path: Path) -> None:
    rows = [
        "0.000,EB,clear,,,,,,,,,",
        "1.000,EB,queued,,,600.00,1.00,1.0,1.0,20.00,3,",
        "3.000,EB,queued,,,590.00,3.00,1.0,1.0,30.48,4,0.50",
        "4.000,EB,unknown,,,,,,,,,",
        "5.000,EB,clear,,,,,,,,,",
    ]
    tracks = [
        "0.000,7,EB,1,,,600.00,-1.00,4.4704,4.50,1.0,1.0,confirmed",
        "0.100,7,EB,1,,,600.40,-1.00,99.00,4.50,1.0,1.0,confirmed",
        "0.200,8,EB,1,,,500.00,-1.00,13.4112,4.50,1.0,1.0,coasting",
    ]
    (tmp_path / "queue.csv").write_text("\n".join([QUEUE_COLUMNS, *rows]) + "\n3.0,EB")
    (tmp_path / "tracks.csv").write_text("\n".join([TRACK_COLUMNS, *tracks]) + "\n")
    (table,), (seen,) = read_queue(tmp_path), read_tracks(tmp_path)
    figures = {what: value for what, value, _ in key_figures(table, seen)}
    assert figures == {
        "time queued": "3.0 s",
        "unknown": "17 %",
        "longest queue": "30 m",
        "most upstream end": "590 m",
        "most downstream end": "600 m",
        "typical uncertainty": "± 2.0 m",
        "fastest growth": "0.5 m/s",
        "vehicles seen": "2",
        "mean speed": "20 mph",
    }
    assert np.allclose(table.durations_s, [1, 2, 1, 1, 1])


def test_not_a_run_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"it has no queue\.csv"):
        write_report(tmp_path)
