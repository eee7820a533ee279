"""The main job on the start of the bundled flight: its files, their columns, interruption."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import av
import numpy as np
import pytest

from queuetail.errors import InputError
from queuetail.run import RunResult, run
from queuetail.types import Observation
from queuetail.video import VideoInfo
from short_flight import cut_flight

# The columns that design.md promises to the outside.
QUEUE = (
    "t_s,approach,status,eoq_lat,eoq_lon,eoq_station_m,eoq_sigma_m,eoq_u_px,eoq_v_px,"
    "length_m,vehicles,growth_mps"
)
TRACKS = "t_s,track_id,approach,lane,lat,lon,station_m,offset_m,speed_mps,length_m,u_px,v_px,state"
FILES = {"queue.csv", "tracks.csv", "events.jsonl", "annotated.mp4", "report.html", "run.json"}
SECONDS = 3.0


@pytest.fixture(scope="session")
def short(flagger: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return cut_flight(
        flagger / "flight.mp4", tmp_path_factory.mktemp("flight") / "short.mp4", SECONDS
    )


@pytest.fixture(scope="module")
def finished(short: Path, flagger: Path, tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    seen: list[Observation] = []
    opened: list[VideoInfo] = []
    result = run(
        short,
        flagger / "telemetry.csv",
        flagger / "site.toml",
        "paper",
        tmp_path_factory.mktemp("run") / "new" / "folder",
        opened=opened.append,
        progress=seen.append,
    )
    assert len(opened) == 1
    assert len(seen) == result.frames
    assert [o.frame_index for o in seen] == list(range(result.frames))
    return result


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_a_run_leaves_every_promised_file(finished: RunResult) -> None:
    assert {p.name for p in finished.out.iterdir()} >= FILES
    assert not finished.interrupted
    assert finished.frames == pytest.approx(SECONDS * 30, abs=3)
    assert finished.duration_s == pytest.approx(SECONDS, abs=0.15)


def test_the_tables_have_the_promised_columns(finished: RunResult) -> None:
    queue, tracks = finished.out / "queue.csv", finished.out / "tracks.csv"
    assert queue.read_text(encoding="utf-8").splitlines()[0] == QUEUE
    assert tracks.read_text(encoding="utf-8").splitlines()[0] == TRACKS
    found = rows(queue)
    assert len(found) == finished.frames
    assert {r["approach"] for r in found} == {"SB"}
    assert {r["status"] for r in found} <= {"clear", "queued", "beyond_view", "unknown"}
    stamps = [float(r["t_s"]) for r in found]
    assert stamps[0] == 0.0
    assert stamps == sorted(set(stamps))


def test_vehicles_are_where_the_truth_has_them(finished: RunResult, flagger: Path) -> None:
    """At 2 s most true vehicles have a track within half a truck's length, on the right road.

    Not the other way round: while the paper's method learns the road it tracks shades of it, too.
    """
    truth = [r for r in rows(flagger / "vehicles.csv") if float(r["t_s"]) == 2.0]
    found = [r for r in rows(finished.out / "tracks.csv") if abs(float(r["t_s"]) - 2.0) < 0.01]
    true_m, found_m = (
        np.array([[float(r["station_m"]), float(r["offset_m"])] for r in some])
        for some in (truth, [r for r in found if r["approach"]])
    )
    assert len(true_m) >= 3
    gaps = np.linalg.norm(true_m[:, None] - found_m[None], axis=2).min(axis=1)
    assert np.median(gaps) < 4.0


def test_the_annotated_video_keeps_the_times(finished: RunResult) -> None:
    with av.open(str(finished.out / "annotated.mp4")) as container:
        times = [f.time for f in container.decode(video=0)]
    stamps = [float(r["t_s"]) for r in rows(finished.out / "queue.csv")]
    np.testing.assert_allclose(np.array(times) - times[0], stamps, atol=2e-3)


def test_the_record_of_the_run(finished: RunResult, short: Path) -> None:
    record = json.loads((finished.out / "run.json").read_text(encoding="utf-8"))
    assert record["preset"] == "paper"
    assert record["video"]["name"] == short.name
    assert len(record["video"]["sha256"]) == len(record["telemetry"]["sha256"]) == 64
    assert record["frames"] == finished.frames
    assert record["interrupted"] is False
    assert {"decode", "map", "background", "track", "queue", "sinks"} <= set(record["timings_ms"])
    assert record["approaches"][0]["name"] == "SB"
    assert record["approaches"][0]["start_station_m"] == 400.0
    assert record["settings"]["site"]["posted_speed_mph"] == 65
    for line in (finished.out / "events.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line)


def test_the_same_input_gives_the_same_answer(
    finished: RunResult, short: Path, flagger: Path, tmp_path: Path
) -> None:
    """And without video the older annotated.mp4 goes, since it would show other results."""
    (tmp_path / "annotated.mp4").write_bytes(b"older")
    again = run(
        short,
        flagger / "telemetry.csv",
        flagger / "site.toml",
        "paper",
        tmp_path,
        with_video=False,
    )
    for name in ("queue.csv", "tracks.csv", "events.jsonl"):
        assert (again.out / name).read_bytes() == (finished.out / name).read_bytes(), name
    assert not (tmp_path / "annotated.mp4").exists()


def small_site(folder: Path, flagger: Path) -> Path:
    """Return the flight's site file with a smaller working picture, for speed."""
    path = folder / "small.toml"
    text = (flagger / "site.toml").read_text(encoding="utf-8")
    path.write_text(text + "\n[paper]\nwidth_px = 320\n", encoding="utf-8")
    return path


def test_telemetry_beside_the_video_is_found(short: Path, flagger: Path, tmp_path: Path) -> None:
    video = cut_flight(short, tmp_path / "beside.mp4", 0.2)
    (tmp_path / "beside.srt").write_bytes((flagger / "flight.srt").read_bytes())
    result = run(video, None, small_site(tmp_path, flagger), "paper", tmp_path / "o", False)
    record = json.loads((result.out / "run.json").read_text(encoding="utf-8"))
    assert record["telemetry"]["name"] == "beside.srt"


def test_after_the_log_ends_all_is_unknown(short: Path, flagger: Path, tmp_path: Path) -> None:
    """Never clear: a stale answer is worse than none.  A value holds for 1 s beyond the log."""
    lines = (flagger / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    log = tmp_path / "half.csv"
    log.write_text("\n".join(lines[:6]) + "\n", encoding="utf-8")
    result = run(short, log, small_site(tmp_path, flagger), "paper", tmp_path / "o", False)
    late = [r for r in rows(result.out / "queue.csv") if float(r["t_s"]) > 1.5]
    assert late
    assert {r["status"] for r in late} == {"unknown"}


def test_control_points_in_local_metres_stay_without_latitude(
    short: Path, flagger: Path, tmp_path: Path
) -> None:
    """Even where a flight log is given: the metres' place on earth is not the drone's."""
    points = [
        ((100, 100), (0, 100)),
        ((1200, 100), (100, 100)),
        ((1200, 700), (90, 0)),
        ((100, 700), (10, 0)),
    ]
    text = "".join(
        f"[[control_point]]\npx = {list(px)}\nenu_m = {list(enu)}\n" for px, enu in points
    )
    text += '[[approach]]\nname = "A"\naxis_enu_m = [[0, 50], [100, 50]]\n[paper]\nwidth_px = 320\n'
    site = tmp_path / "local.toml"
    site.write_text(text, encoding="utf-8")
    video = cut_flight(short, tmp_path / "v.mp4", 1.0)
    result = run(video, flagger / "telemetry.csv", site, "paper", tmp_path / "o")
    assert {r["lat"] for r in rows(result.out / "tracks.csv")} <= {""}
    record = json.loads((result.out / "run.json").read_text(encoding="utf-8"))
    assert record["approaches"][0]["axis_lat_lon"] is None


def test_a_truncated_video_is_run_to_its_end_and_said(flagger: Path, tmp_path: Path) -> None:
    video = tmp_path / "cut.mkv"
    cut_flight(flagger / "flight.mp4", video, 4.0)
    data = video.read_bytes()
    video.write_bytes(data[: len(data) * 7 // 10])
    result = run(
        video, flagger / "telemetry.csv", small_site(tmp_path, flagger), "paper", tmp_path / "o"
    )
    assert any("is truncated" in n for n in result.notes)
    assert 10 < result.frames < 110
    record = json.loads((result.out / "run.json").read_text(encoding="utf-8"))
    assert any("is truncated" in n for n in record["notes"])
    assert len(rows(result.out / "queue.csv")) == result.frames


def test_an_error_in_mid_flight_leaves_valid_files(
    short: Path, flagger: Path, tmp_path: Path
) -> None:
    class StopError(Exception):
        pass

    def stop(observation: Observation) -> None:
        if observation.frame_index == 5:
            raise StopError

    site = small_site(tmp_path, flagger)
    with pytest.raises(StopError):
        run(short, flagger / "telemetry.csv", site, "paper", tmp_path / "o", progress=stop)
    assert len(rows(tmp_path / "o" / "queue.csv")) == 6
    with av.open(str(tmp_path / "o" / "annotated.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) == 6


def test_bad_input_leaves_no_folder_behind(flagger: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        run(tmp_path / "none.mp4", flagger / "telemetry.csv", None, "paper", tmp_path / "o")
    assert not (tmp_path / "o").exists()


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_leaves_valid_files_of_what_was_done(
    flagger: Path, tmp_path: Path, stop: signal.Signals
) -> None:
    out = tmp_path / "o"
    command = [sys.executable, "-m", "queuetail.cli", "run", str(flagger / "flight.mp4")]
    command += ["--telemetry", str(flagger / "telemetry.csv"), "--preset", "paper"]
    command += ["--site", str(small_site(tmp_path, flagger)), "--out", str(out)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A test run in the background of a shell inherits that Ctrl-C is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    queue, deadline = out / "queue.csv", time.monotonic() + 60
    while not (queue.exists() and queue.stat().st_size > 2000) and time.monotonic() < deadline:
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
    os.kill(process.pid, stop)
    shown, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "Traceback" not in errors
    assert "interrupted" in shown
    record = json.loads((out / "run.json").read_text(encoding="utf-8"))
    assert record["interrupted"] is True
    found = rows(queue)
    assert 10 < len(found) < 2300
    assert abs(len(found) - record["frames"]) <= 1
    assert all(len(r) == len(QUEUE.split(",")) and None not in r.values() for r in found)
    rows(out / "tracks.csv")
    for line in (out / "events.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line)
    assert "</html>" in (out / "report.html").read_text(encoding="utf-8")
    with av.open(str(out / "annotated.mp4")) as container:
        shown_frames = sum(1 for _ in container.decode(video=0))
    assert abs(shown_frames - len(found)) <= 1
