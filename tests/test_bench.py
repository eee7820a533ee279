"""bench: a short clip through all methods, ratios by hand, and what it refuses."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from queuetail.bench import (
    DECODE,
    Bench,
    Measured,
    at_width,
    from_json,
    jobs,
    measure,
    peak_mb,
    summarise,
    to_json,
)
from queuetail.bench_table import absolute_rows, ratio_rows, setting, stage_rows
from queuetail.cli import main
from queuetail.config import PaperSettings, Site, parse_settings, read_site
from queuetail.video import VideoInfo
from short_flight import cut_flight

INFO = VideoInfo("v.mp4", 1280, 720, 0, 30.0, 60.0, "h264", datetime(2026, 6, 1, tzinfo=UTC))


def took(loop_s: float, frames: int = 100, whole_s: float | None = None) -> Measured:
    stages = {"decode": 600.0 * loop_s / frames, "track": 400.0 * loop_s / frames}
    return Measured(frames, loop_s, whole_s or loop_s, 100.0, stages)


@pytest.fixture
def fabricated() -> Bench:
    """Two turns, in the second of which the machine is half as fast; road looks at every 2nd."""
    return summarise(
        INFO,
        10.0,
        0.5,
        {
            DECODE: [took(1.0), took(2.0)],
            "road": [took(2.0, 50, 4.0), took(4.0, 50, 8.0)],
            "paper at 720 px": [took(10.0), took(20.0)],
        },
    )


def test_ratios_are_taken_within_a_turn(fabricated: Bench) -> None:
    (ratio,) = fabricated.ratios
    assert (ratio.fast, ratio.slow, ratio.loop, ratio.whole) == ("road", "paper at 720 px", 5, 2.5)
    assert fabricated.methods["road"].times_decode == 2.0
    assert fabricated.methods["road"].whole_times_decode == 4.0


def test_rates_count_the_videos_frames_and_stages_sum_to_the_loop(fabricated: Bench) -> None:
    road = fabricated.methods["road"]
    assert road.frames == 50
    assert road.rate_hz == np.median([100 / 2.0, 100 / 4.0])
    assert sum(road.stage_ms.values()) == pytest.approx(30.0)  # 3 s in the median turn, 100 frames


def test_the_tables_show_ratios_and_where_the_time_goes(fabricated: Bench) -> None:
    assert ratio_rows(fabricated)[1] == ["road ÷ paper at 720 px, speed", "5.0 ×", "2.5 ×"]
    assert ratio_rows(fabricated)[2][1] == "2.00 ×"
    rows = {row[0]: row for row in absolute_rows(fabricated)}
    assert rows[DECODE][2] == "7.5"  # 75 frames/s where 10 frames are a second of video
    assert rows["road"][4] == "50 of 100"
    assert stage_rows(fabricated)[-1] == ["all", "15.00", "30.00", "150.00"]
    assert "2 turns" in setting(fabricated)
    record = json.loads(json.dumps(to_json(fabricated)))
    assert record["video"]["start_utc"].startswith("2026-06")
    assert from_json(record) == fabricated


def test_the_papers_full_width_is_the_videos() -> None:
    made = jobs(Path("v.mp4"), None, Site(), 1920, 5.0)
    assert [(name, job.preset, job.site.paper.width_px) for name, job in made.items()] == [
        (DECODE, None, 720),
        ("road", "road", 720),
        ("paper at 720 px", "paper", 720),
        ("paper at 1920 px", "paper", 1920),
    ]


@pytest.mark.parametrize(
    ("width_px", "blur_px", "dilate_px", "min_blob_px2"),
    [
        (720, 5, 5, 40.0),
        (1440, 9, 9, 160.0),
        (3840, 27, 9, 40 * (3840 / 720) ** 2),
        (320, 3, 3, 7.9),
    ],
)
def test_the_papers_sliders_grow_with_the_picture(
    width_px: int, blur_px: int, dilate_px: int, min_blob_px2: float
) -> None:
    scaled = at_width(PaperSettings(), width_px)
    assert (scaled.width_px, scaled.blur_px, scaled.dilate_px) == (width_px, blur_px, dilate_px)
    assert scaled.min_blob_px2 == pytest.approx(min_blob_px2, abs=0.01)
    assert parse_settings(PaperSettings, scaled.model_dump(), "scaled") == scaled


def test_every_method_is_measured_on_the_same_frames(flagger: Path, tmp_path: Path) -> None:
    video = cut_flight(flagger / "flight.mp4", tmp_path / "v.mp4", 1.0)
    site = read_site(flagger / "site.toml")
    made = jobs(video, flagger / "telemetry.csv", site, 320, 0.5)
    decode, road, paper = (measure(made[k]) for k in (DECODE, "road", "paper at 320 px"))
    assert 14 <= decode.frames <= 17
    assert road.frames <= decode.frames
    assert paper.frames == decode.frames
    for run in (road, paper):
        assert run.whole_s >= run.loop_s
        total_s = sum(run.stage_ms.values()) * run.frames / 1000
        assert total_s == pytest.approx(run.loop_s, rel=0.1)
        assert {"decode", "register", "track", "sinks"} <= run.stage_ms.keys()


def test_peak_memory_is_resident_and_only_grows() -> None:
    before = peak_mb()
    block = np.ones(50_000_000, np.uint8)
    assert 20 < before <= peak_mb() < 64_000
    del block
    after = peak_mb()
    assert after >= before


def test_the_command_prints_and_writes(
    flagger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    video = cut_flight(flagger / "flight.mp4", tmp_path / "v.mp4", 0.3)
    out = tmp_path / "bench.json"
    arguments = ["bench", str(video), "--telemetry", str(flagger / "telemetry.csv")]
    arguments += ["--site", str(flagger / "site.toml"), "--turns", "1", "--seconds", "2"]
    assert main([*arguments, "--json", str(out)]) == 0
    shown = capsys.readouterr().out
    assert shown.index("Ratios") < shown.index("Absolute") < shown.index("Milliseconds")
    record = json.loads(out.read_text(encoding="utf-8"))
    assert set(record["methods"]) == {DECODE, "road", "paper at 720 px", "paper at 1280 px"}
    assert record["seconds"] <= 0.5
    assert record["cores"] == os.cpu_count()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["none.mp4"], "there is no such file"),
        (["--seconds", "0"], "--seconds above 0"),
        (["--seconds", "nan"], "--seconds above 0"),
        (["--turns", "0"], "--turns of 1 or more"),
    ],
)
def test_bad_input_gets_one_sentence(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bench", *arguments]) == 2
    errors = capsys.readouterr().err
    assert says in errors
    assert "Traceback" not in errors
