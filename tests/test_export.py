"""Exports are read back by other parsers and hold the run's ends of queue."""

from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import gpxpy
import pytest

from queuetail.errors import InputError
from queuetail.export import FORMATS, export
from queuetail.sinks.tables import QUEUE_COLUMNS

KML = "{http://www.opengis.net/kml/2.2}"


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """A run of 20 s at 10 rows/s: clear, queued, unknown for 4 s, queued, beyond view."""
    rows = []
    for i in range(200):
        t_s = i / 10
        place = f"{36.11 - i * 1e-6:.8f},-97.05700000,{600 - i / 2:.2f},1.50,10.0,20.0,{i:.2f},4,"
        if t_s < 3:
            rows.append(f"{t_s:.3f},EB & co,clear,,,,,,,,,")
        elif 8 <= t_s < 12:
            rows.append(f"{t_s:.3f},EB & co,unknown,,,,,,,,,")
        else:
            rows.append(f"{t_s:.3f},EB & co,{'beyond_view' if t_s >= 18 else 'queued'},{place}")
    (tmp_path / "queue.csv").write_text("\n".join([QUEUE_COLUMNS, *rows]) + "\n")
    run = {"site": {"name": "A <site> & more"}, "video": {"start_utc": "2026-05-04T10:00:00+00:00"}}
    (tmp_path / "run.json").write_text(json.dumps(run))
    return tmp_path


def test_geojson(run_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "eoq.geojson"
    export(run_dir, "geojson", out)
    features = json.loads(out.read_text())["features"]
    line = features[0]
    assert line["geometry"]["type"] == "MultiLineString"
    assert [len(part) for part in line["geometry"]["coordinates"]] == [5, 8]
    points = [f for f in features if f["geometry"]["type"] == "Point"]
    assert points[0]["geometry"]["coordinates"] == [-97.057, 36.10997]
    assert points[0]["properties"]["t_s"] == 3.0
    assert points[0]["properties"]["utc"] == "2026-05-04T10:00:03+00:00"
    assert points[0]["properties"]["growth_mps"] is None
    assert {p["properties"]["status"] for p in points} == {"queued", "beyond_view"}
    assert [p["properties"]["kind"] for p in points].count("last_eoq") == 1


def test_gpx(run_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "eoq.gpx"
    export(run_dir, "gpx", out)
    document = gpxpy.parse(out.read_text())
    assert document.name == "A <site> & more"
    assert [len(s.points) for s in document.tracks[0].segments] == [5, 8]
    first = document.tracks[0].segments[0].points[0]
    assert (first.latitude, first.longitude) == pytest.approx((36.10997, -97.057), abs=1e-9)
    assert first.time is not None
    assert first.time.isoformat().startswith("2026-05-04T10:00:03")
    assert document.waypoints[0].name == "last end of queue EB & co"


def test_kml(run_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "eoq.kml"
    export(run_dir, "kml", out)
    root = ET.parse(out).getroot()
    lines = root.findall(f".//{KML}LineString/{KML}coordinates")
    assert [len((line.text or "").split()) for line in lines] == [5, 8]
    assert (lines[0].text or "").startswith("-97.05700000,36.10997000")
    assert len(root.findall(f".//{KML}TimeStamp")) == 13


@pytest.mark.parametrize("fmt", FORMATS)
def test_without_utc_there_are_no_times(run_dir: Path, tmp_path: Path, fmt: str) -> None:
    (run_dir / "run.json").write_text(json.dumps({"video": {"start_utc": None}}))
    out = tmp_path / f"eoq.{fmt}"
    export(run_dir, fmt, out)
    text = out.read_text()
    assert "<time>" not in text
    assert "TimeStamp" not in text
    assert '"utc"' not in text


@pytest.mark.parametrize("fmt", FORMATS)
def test_a_single_place_is_exported(run_dir: Path, tmp_path: Path, fmt: str) -> None:
    row = "0.000,EB,queued,36.10000000,-97.00000000,1.00,1.00,1.0,1.0,1.00,2,"
    (run_dir / "queue.csv").write_text(f"{QUEUE_COLUMNS}\n{row}\n")
    export(run_dir, fmt, tmp_path / "one")
    assert "36.1" in (tmp_path / "one").read_text()


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", "holds no end of queue"),
        ("0.000,EB,clear,,,,,,,,,\n", "holds no end of queue"),
        ("0.000,EB,queued,,,12.00,1.00,1.0,1.0,5.00,2,\n", "local metres only"),
        ("0.000,EB,queued\n0.000,EB,clear,,,,,,,,,\n", "line 2: 3 cells"),
        ("0.000,EB,jammed,,,,,,,,,\n", "line 2: 'jammed' is not a status"),
        ("soon,EB,clear,,,,,,,,,\n", "line 2: 'soon' is not a number"),
    ],
)
def test_nothing_to_export(run_dir: Path, tmp_path: Path, rows: str, message: str) -> None:
    (run_dir / "queue.csv").write_text(f"{QUEUE_COLUMNS}\n{rows}")
    with pytest.raises(InputError, match=message):
        export(run_dir, "gpx", tmp_path / "x.gpx")


def test_bad_places(run_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such run folder"):
        export(tmp_path / "nowhere", "gpx", tmp_path / "x")
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(InputError, match=r"not a run folder: it has no queue\.csv"):
        export(empty, "gpx", tmp_path / "x")
    with pytest.raises(InputError, match="cannot be written: Is a directory"):
        export(run_dir, "gpx", empty)
    with pytest.raises(InputError, match="known formats: geojson, gpx, kml"):
        export(run_dir, "shp", tmp_path / "x")
    (run_dir / "run.json").write_text("{")
    with pytest.raises(InputError, match=r"run\.json is damaged"):
        export(run_dir, "gpx", tmp_path / "x")
    (run_dir / "queue.csv").write_text("a,b\n1,2\n")
    (run_dir / "run.json").unlink()
    with pytest.raises(InputError, match="line 1: expected the columns"):
        export(run_dir, "gpx", tmp_path / "x")
