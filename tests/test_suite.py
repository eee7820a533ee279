"""The benchmark suite: figures pooled by hand, tables, the page, and going on where it stopped."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("libsumo")
pytest.importorskip("motmetrics")

import suite as suite_module
from one_run import is_exact
from queuetail.errors import InputError
from queuetail.sim.scenario import read_scenario
from queuetail.sim.site import write_scenario
from suite import QUICK, SCENARIOS, Case, Suite, cases_of, flight_of, go, measure, simulate
from suite_tables import BEGIN, END, Pool, rewrite, suite_text, target_rows, variant_rows

SHARES = {"samples": 100, "queued": 1.0, "clear": 0.0}
RECORD: dict[str, Any] = {
    "exact_telemetry": True,
    "frames": 100,
    "true_rows": 30,
    "track_rows": 90,
    "tolerant_errors_m": [0.0, 0.2, 0.4],
    "strict_errors_m": [1.0, 2.0, 3.0],
    "tolerant": {"samples": 3, "inside_2_sigma": 1.0},
    "answers": {
        "queue_in_view": SHARES,
        "no_queue": SHARES,
        "missed_tolerant": 0.0,
        "false_tolerant": 0.0,
        "unknown": 0.0,
    },
    "episodes": {
        "episodes": [{"onset_delay_s": 0.5, "dissolve_delay_s": None}],
        "missed": 0,
        "false": 0,
    },
    "vehicles": {
        "pairs": 30,
        "recall": 1.0,
        "precision": 1.0,
        "idf1": 1.0,
        "hota": 0.9,
        "left_bias_m": -0.2,
        "speed_rmse_mps": 0.3,
    },
}
SMALL = """[scenario]
duration_s = 3
[picture]
width_px = 320
height_px = 180
[traffic]
queue_speed_mph = 20
[traffic.queue]
cause = "flagger"
start_s = -20
at_m = 10
"""


def changed(**tables: Any) -> dict[str, Any]:
    """Return the record with some of its tables' entries changed."""
    record = copy.deepcopy(RECORD)
    for name, value in tables.items():
        if isinstance(value, dict):
            record[name].update(value)
        else:
            record[name] = value
    return record


def test_pooling_counts_samples_not_scenarios() -> None:
    bad = changed(
        tolerant_errors_m=[10.0],
        true_rows=10,
        tolerant={"samples": 1, "inside_2_sigma": 0.0},
        answers={"missed_tolerant": 0.5, "queue_in_view": {**SHARES, "samples": 300}},
        vehicles={"recall": 0.0, "pairs": 10, "speed_rmse_mps": 0.7},
    )
    pool = Pool([RECORD, bad])
    assert pool.eoq_m(50) == pytest.approx(0.3)
    assert pool.eoq_m(100) == 10.0
    assert pool.inside_2_sigma == 0.75
    assert pool.missed == pytest.approx(0.375)
    assert pool.recall == 0.75
    assert pool.speed_rmse_mps == pytest.approx(((30 * 0.09 + 10 * 0.49) / 40) ** 0.5)
    assert Pool([]).eoq_m(50) is None
    assert Pool([]).recall is None


def test_a_failed_scenario_shows_and_is_not_pooled() -> None:
    rows = variant_rows({"b": {"error": "SUMO | died\nbadly"}, "a": RECORD, "c": RECORD, "d": {}})
    assert [row[0] for row in rows] == ["scenario", "a", "b", "c", "d", "**all 2**"]
    assert rows[2][1] == "failed: SUMO / died badly"
    assert rows[4][1] == "failed: not run"
    assert rows[1][1:5] == ["0.20", "0.38", "0.40", "2.00"]


def test_figures_are_judged_against_what_is_asked() -> None:
    calm = changed(episodes={"episodes": [], "false": 2}, tolerant_errors_m=[])
    biased = changed(exact_telemetry=False, tolerant_errors_m=[2.6], vehicles={"left_bias_m": -0.6})
    rows = {
        row[0]: row[1:] for row in target_rows({"road": {"a": RECORD, "b": calm, "c": biased}}, {})
    }
    assert rows["EOQ error, exact telemetry, median"] == ["≤ 0.50 m", "0.20 m ✓"]
    assert rows["EOQ error, biased telemetry, median"] == ["≤ 2.50 m", "2.60 m ✗"]
    assert rows["sideways error, biased telemetry (vehicles' median, worst)"][1] == "0.60 m ✗"
    assert rows["false alarms in scenarios without queue"][1] == "2 ✗"
    assert rows["dissolve delay, worst"][1] == "–"
    assert rows["IDF1"] == ["≥ 0.950", "1.000 ✓"]


def test_speed_is_judged_too() -> None:
    methods = {
        "decode only": {"rate_hz": 300.0},
        "road": {
            "rate_hz": 150.0,
            "times_decode": 2.0,
            "whole_times_decode": 2.6,
            "peak_mb": 250.0,
        },
    }
    video = {"width_px": 1280, "height_px": 720, "frame_rate_hz": 30.0}
    ratios = [{"slow": "paper at 720 px", "whole": 4.5}, {"slow": "paper at 1280 px", "whole": 9.0}]
    one = {"methods": methods, "video": video, "ratios": ratios}
    rows = {r[0]: r[1:] for r in target_rows({"road": {}}, {"speed": one, "speed_4k": one})}
    assert rows["1280×720: speed ÷ paper at 720 px, whole run"] == ["≥ 4 ×", "4.5 × ✓"]
    assert rows["1280×720: speed ÷ paper at 1280 px, whole run"] == ["≥ 10.0 ×", "9 × ✗"]
    assert rows["1280×720: time ÷ decode only, whole run"][1] == "2.6 × ✗"
    assert rows["1280×720: × real time (decode only: 10.0)"][1] == "5 × ✓"
    assert target_rows({"road": {}}, {"speed": {"error": "x"}})[-1][0] == "speed RMSE"


def test_the_page_keeps_what_others_wrote(tmp_path: Path) -> None:
    page = tmp_path / "benchmarks.md"
    rewrite(page, "first")
    assert (
        page.read_text(encoding="utf-8")
        == f"# Benchmarks\n\n## The suite\n\n{BEGIN}\nfirst\n{END}\n"
    )
    page.write_text(f"intro\n{BEGIN}\nfirst\n{END}\nafter\n", encoding="utf-8")
    rewrite(page, suite_text({"road": {"a": RECORD}}, {}))
    text = page.read_text(encoding="utf-8")
    assert text.startswith(f"intro\n{BEGIN}\n")
    assert text.endswith(f"{END}\nafter\n")
    assert "```console\nmake benchmark\n```\n| figure |" in text
    assert "first" not in text
    widths = {line.count("|") for line in text.splitlines() if line.startswith("| a |")}
    assert widths == {text.split("| scenario")[1].splitlines()[0].count("|") + 1}


def test_the_quick_subset_exists_and_telemetry_is_told_apart() -> None:
    names = {p.stem for p in SCENARIOS.glob("*.toml")}
    assert set(QUICK) <= names
    assert is_exact(read_scenario(SCENARIOS / "flagger_day.toml"))
    assert not is_exact(read_scenario(SCENARIOS / "biased_telemetry.toml"))


def test_an_unreadable_scenario_stops_before_any_time_is_spent(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml"):
        cases_of([tmp_path / "none.toml"], [])
    (drawn,) = cases_of([], [5])
    assert drawn.name == "random_5"
    assert drawn.how == ("--random", "5")


def test_flights_made_elsewhere_serve_only_where_they_are_of_the_same_scenario(
    tmp_path: Path,
) -> None:
    path = tmp_path / "small.toml"
    path.write_text(SMALL, encoding="utf-8")
    (case,) = cases_of([path], [])
    there = tmp_path / "there" / "small"
    there.mkdir(parents=True)
    write_scenario(case.scenario, there / "scenario.toml")
    suite = Suite(tmp_path / "out", (case,), ("road",), tmp_path / "there")
    assert flight_of(suite, case) == there
    assert simulate(suite, case) is None
    text = SMALL.replace("at_m = 10", "at_m = 20")
    (there / "scenario.toml").write_text(text, encoding="utf-8")
    assert flight_of(suite, case) == tmp_path / "out" / "flights" / "small"


def test_a_short_suite_runs_fails_in_part_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "good.toml").write_text(SMALL, encoding="utf-8")
    (tmp_path / "bad.toml").write_text(SMALL + "[flight]\naim_left_m = 200\n", encoding="utf-8")
    cases = cases_of([tmp_path / "good.toml", tmp_path / "bad.toml"], [])
    suite = Suite(tmp_path / "out", cases, ("paper",))
    figures = go(suite, 2, lambda text: None)
    assert figures["paper"]["bad"]["error"].startswith("no flight: queuetail: ")
    good = figures["paper"]["good"]
    assert good["frames"] == 90
    assert good["exact_telemetry"] is True
    assert good["true_rows"] > 0

    asked: list[str] = []
    real = suite_module._do

    def noted(command: list[str], alone: bool = False) -> str | None:
        asked.append(command[1] if command[1] != "-m" else command[3])
        return real(command, alone)

    monkeypatch.setattr(suite_module, "_do", noted)
    assert go(suite, 2, lambda text: None)["paper"]["good"] == good
    assert asked == ["simulate"]  # the bad one is tried again, the good one stands
    target = suite.result(_named(cases, "good"), "paper")
    target.write_text(target.read_text(encoding="utf-8")[:50], encoding="utf-8")
    monkeypatch.setattr(suite_module, "_do", lambda command, alone=False: "killed")
    measure(suite, _named(cases, "good"), "paper")
    assert json.loads(target.read_text(encoding="utf-8")) == {"error": "killed"}


def _named(cases: tuple[Case, ...], name: str) -> Case:
    return next(c for c in cases if c.name == name)
