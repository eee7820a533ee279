"""Scenario files: what is refused, with which words, before any time is spent."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from queuetail.config import parse_settings
from queuetail.errors import InputError
from queuetail.settings import Settings
from queuetail.sim import traffic
from queuetail.sim.check import check_drawable
from queuetail.sim.randomised import random_scenario
from queuetail.sim.scenario import Scenario, read_scenario
from queuetail.sim.simulate import command, simulate
from queuetail.sim.site import scenario_toml

LEAST_SCENARIOS = 16


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[trafic]\n", "did you mean 'traffic'"),
        ("[flight]\nheigth_m = 3\n", "did you mean 'height_m'"),
        ("[traffic]\ndemand_vph = 9000\n", "beyond the capacity at the entrance"),
        ("[opposite]\nlanes = 1\ndemand_vph = 2300\n", "[opposite] demand_vph = 2300"),
        ("[flight]\npitch_deg = -10\n", "flight.pitch_deg"),
        ("[road]\nbend_radius_m = 20\n", "tighter than 60 m"),
        ("[road]\nlanes = 1\n[traffic.queue]\ncause = 'lane_drop'\n", "needs two lanes"),
        ("[road]\nshoulder_m = 0\n[traffic]\nparked = 2\n", "parked needs a shoulder"),
        ("[telemetry]\ngaps = [[4, 2]]\n", "ends before it starts"),
        ("[scenario\n", "not valid TOML"),
        ("[picture]\nwidth_px = 1281\n", "picture.width_px"),
        ("scenario = 3\n", "scenario"),
    ],
)
def test_bad_scenarios_are_refused_with_the_reason(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as refused:
        read_scenario(path)
    assert words in str(refused.value)
    assert "bad.toml" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such scenario file"):
        read_scenario(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("flight", "words"),
    [
        ({"aim_left_m": 200.0, "hfov_deg": 30.0, "height_m": 60.0}, "sees 0 m of the road"),
        ({"height_m": 500.0, "hfov_deg": 120.0, "pitch_deg": -90.0}, "a lane is only"),
    ],
)
def test_undrawable_scenarios_cost_no_time(
    tmp_path: Path, flight: dict[str, float], words: str
) -> None:
    raw = {"flight": flight, "picture": {"width_px": 640, "height_px": 360}}
    scenario = parse_settings(Scenario, raw, "far")
    with pytest.raises(InputError, match=words):
        simulate(scenario, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_missing_extra_is_said(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(traffic.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install '\.\[sim\]'"):
        simulate(Scenario(), tmp_path)


def test_command_wants_one_source(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="either a scenario file or --random"):
        command(None, tmp_path, None, None)


def test_named_scenarios_can_be_drawn_and_are_told_apart(root: Path) -> None:
    paths = sorted((root / "benchmarks" / "scenarios").glob("*.toml"))
    assert len(paths) >= LEAST_SCENARIOS
    scenarios = [read_scenario(path) for path in paths]
    for scenario in scenarios:
        check_drawable(scenario)
        assert scenario.scenario.description
    assert len({s.scenario.seed for s in scenarios}) == len(paths)


def test_random_scenarios_differ_repeat_and_can_be_drawn() -> None:
    drawn = [random_scenario(seed) for seed in range(25)]
    assert drawn[3] == random_scenario(3)
    assert len({s.model_dump_json() for s in drawn}) == len(drawn)
    assert len({s.traffic.queue.cause for s in drawn}) > 3


def test_resolved_scenario_reads_back() -> None:
    scenario = random_scenario(8)
    again = parse_settings(Scenario, tomllib.loads(scenario_toml(scenario)), "again")
    assert again == scenario


def test_every_key_is_in_the_docs(root: Path) -> None:
    text = (root / "docs" / "simulator.md").read_text(encoding="utf-8")

    def keys(model: type[Settings]) -> set[str]:
        found = set()
        for name, field in model.model_fields.items():
            inner = field.annotation
            if isinstance(inner, type) and issubclass(inner, Settings):
                found |= keys(inner)
            else:
                found.add(name)
        return found

    assert not {key for key in keys(Scenario) if f"`{key}`" not in text}
