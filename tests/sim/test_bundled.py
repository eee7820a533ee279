"""The bundled flight is the simulator's: its scenario, its size, and a queue from start to end."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import pytest

pytest.importorskip("libsumo")

from queuetail.config import read_site
from queuetail.sim.axis import Axis
from queuetail.sim.flight import TruePath
from queuetail.sim.log import flight_log, write_csv
from queuetail.sim.scenario import read_scenario
from queuetail.sim.simulate import frame_ticks
from queuetail.sim.traffic import simulate_traffic
from queuetail.sim.truth import axis_points, write_truth
from queuetail.types import Origin

LIMIT = 3_000_000


def read(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def same(new: str, old: str) -> bool:
    return new == old or abs(float(new) - float(old)) < 0.101


def test_it_stays_small(flagger: Path) -> None:
    assert sum(p.stat().st_size for p in flagger.iterdir()) < LIMIT


def test_its_scenario_makes_it_again(flagger: Path, tmp_path: Path) -> None:
    """But for the video, which depends on the encoder, and the last digit, which may on the CPU."""
    scenario = read_scenario(flagger / "scenario.toml")
    seed = scenario.scenario.seed
    path = TruePath(scenario, seed)
    times_s = frame_ticks(scenario, seed) / 90_000
    write_truth(scenario, simulate_traffic(scenario, seed), path, times_s, tmp_path)
    write_csv(flight_log(scenario, path, seed), tmp_path / "telemetry.csv")
    for name in ("truth.csv", "vehicles.csv", "road.csv", "telemetry.csv"):
        made, kept = (read(folder / name) for folder in (tmp_path, flagger))
        assert len(made) == len(kept), name
        for new, old in zip(made, kept, strict=True):
            assert len(new) == len(old), name
            assert all(map(same, new, old)), (name, new, old)


def test_its_site_file_is_the_scenarios_road(flagger: Path) -> None:
    site, scenario = read_site(flagger / "site.toml"), read_scenario(flagger / "scenario.toml")
    station, lat, lon = axis_points(Axis.of(scenario.road), Origin(*scenario.scenario.origin))
    (approach,) = site.approach
    assert approach.axis is not None
    assert approach.start_station_m == station[0]
    for (a, b), i in zip(approach.axis, (0, -1), strict=True):
        assert math.hypot(a - lat[i], b - lon[i]) < 1e-7
    assert (approach.lanes, approach.lane_width_m) == (scenario.road.lanes, 3.6)
    assert site.site.posted_speed_mph == scenario.traffic.posted_speed_mph


def test_it_shows_free_traffic_a_queue_and_its_end(flagger: Path) -> None:
    with (flagger / "truth.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    queued = [float(r["t_s"]) for r in rows if r["eoq_station_m"]]
    assert 20 < queued[0] < 30
    assert 70 < queued[-1] < float(rows[-1]["t_s"]) - 2
    assert all(r["in_view"] == "1" for r in rows if r["eoq_station_m"])
