"""SUMO moves the vehicles: one process per simulation, read back as matrices over time."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from queuetail.config import MPS_PER_MPH
from queuetail.errors import InputError
from queuetail.sim.axis import VIEW_STATION_M
from queuetail.sim.bodies import BODIES, PAINTS
from queuetail.sim.network import (
    Departure,
    departures,
    draw_body,
    sides,
    warmup_s,
    write_network,
    write_routes,
)
from queuetail.sim.scenario import Scenario
from queuetail.types import Bools, Floats, Ints

MISSING = (
    "simulate needs SUMO; in the project's folder run `make setup-dev`, or pip install '.[sim]'"
)
PARKED_EVERY_M = 21.0


@dataclass(frozen=True, slots=True)
class Traffic:
    """Every vehicle at every tick: rows are ticks, columns vehicles, NaN where it is not there."""

    tick_s: Floats  # (k,) after frame 0; negative in the warm-up
    ids: tuple[str, ...]
    body: Ints  # (n,) into BODIES
    paint: Ints  # (n,) into PAINTS
    opposite: Bools  # (n,)
    parked: Bools  # (n,)
    front_m: Floats  # (k, n) station of the front bumper
    offset_m: Floats  # (k, n)
    speed_mps: Floats  # (k, n)

    @property
    def length_m(self) -> Floats:
        """Length of each vehicle, (n,)."""
        return np.array([BODIES[b].length_m for b in self.body])

    def at(self, t_s: float) -> tuple[Ints, Floats, Floats, Floats]:
        """Return who is there at a time (columns), front stations, offsets and speeds."""
        last = len(self.tick_s) - 2
        k = int(np.clip(np.searchsorted(self.tick_s, t_s, "right") - 1, 0, last))
        share = (t_s - self.tick_s[k]) / (self.tick_s[k + 1] - self.tick_s[k])
        share = float(np.clip(share, 0.0, 1.0))
        here = np.flatnonzero(~np.isnan(self.front_m[k]) & ~np.isnan(self.front_m[k + 1]))

        def between(values: Floats) -> Floats:
            return np.asarray(values[k, here] * (1 - share) + values[k + 1, here] * share)

        return here, between(self.front_m), between(self.offset_m), between(self.speed_mps)


def require_sumo() -> None:
    """Raise InputError where the extra `sim` is not installed."""
    if any(importlib.util.find_spec(name) is None for name in ("sumo", "libsumo")):
        raise InputError(MISSING)


def simulate_traffic(scenario: Scenario, seed: int) -> Traffic:
    """Run SUMO for a scenario; the same seed gives the same traffic."""
    require_sumo()
    entries = departures(scenario, seed)
    with tempfile.TemporaryDirectory(prefix="queuetail-sim-") as name:
        folder = Path(name)
        job, recorded = folder / "job.json", folder / "recorded.npz"
        job.write_text(json.dumps(_prepare(scenario, seed, entries, folder)), encoding="utf-8")
        _call([sys.executable, "-m", "queuetail.sim.drive", str(job), str(recorded)])
        with np.load(recorded) as rows:
            return _gather(scenario, seed, entries, {key: rows[key] for key in rows.files})


def _call(command: list[str]) -> None:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip()).splitlines()[-1:]
        raise RuntimeError(f"SUMO failed: {' '.join(last)}")


def _prepare(
    scenario: Scenario, seed: int, entries: list[Departure], folder: Path
) -> dict[str, Any]:
    """Write SUMO's files and return the job for `queuetail.sim.drive`."""
    import sumo  # noqa: PLC0415  (the extra `sim`, wanted only here)

    network, routes = folder / "road.net.xml", folder / "road.rou.xml"
    netconvert = Path(sumo.SUMO_HOME) / "bin" / "netconvert"
    if not netconvert.exists():
        netconvert = netconvert.with_suffix(".exe")
    _call([str(netconvert), *write_network(scenario, folder), "-o", str(network)])
    write_routes(scenario, entries, routes)
    options = (
        f"--step-length 0.1 --seed {seed} --lanechange.duration 3 --time-to-teleport -1 "
        "--no-step-log --no-warnings --collision.action none --default.speeddev 0"
    )
    return {
        "command": ["sumo", "-n", str(network), "-r", str(routes), *options.split()],
        "warmup_s": warmup_s(scenario),
        "duration_s": scenario.scenario.duration_s,
        "sides": [
            {
                "edges": side.edges,
                "light": f"{side.name}n1",
                "lanes": side.lanes,
                "free_mps": scenario.traffic.posted_speed_mph * MPS_PER_MPH,
                "crawl_mps": side.queue.crawl_mph * MPS_PER_MPH,
                "queue": side.queue.model_dump(),
            }
            for side in sides(scenario)
        ],
    }


def _gather(
    scenario: Scenario, seed: int, entries: list[Departure], rows: dict[str, Any]
) -> Traffic:
    """Turn SUMO's rows into matrices and add the parked vehicles."""
    rng = np.random.default_rng([seed, 5])
    kinds = {entry.name: entry.body for entry in entries}
    ids, column = np.unique(rows["vehicle"], return_inverse=True)
    moving, parked = len(ids), scenario.traffic.parked
    shape = (len(rows["tick_s"]), moving + parked)
    front, offset, speed = (np.full(shape, np.nan) for _ in range(3))
    front[rows["tick"], column] = rows["x_m"]
    offset[rows["tick"], column] = rows["y_m"]
    speed[rows["tick"], column] = rows["speed_mps"]
    body = [kinds[name] for name in ids.tolist()] + [draw_body(rng, 0.25) for _ in range(parked)]
    road = scenario.road
    edge_m = -road.lanes * road.lane_width_m
    for i in range(moving, moving + parked):
        place = i - moving - 0.5 * parked
        half_m = 0.5 * BODIES[body[i]].width_m
        front[:, i] = VIEW_STATION_M + PARKED_EVERY_M * place + rng.uniform(-1, 1)
        offset[:, i] = edge_m - max(0.5 * road.shoulder_m, half_m + 0.3)
        speed[:, i] = 0.0
    names = (*ids.tolist(), *(f"parked.{i}" for i in range(parked)))
    return Traffic(
        tick_s=np.round(rows["tick_s"], 6),
        ids=names,
        body=np.array(body, int),
        paint=rng.integers(0, len(PAINTS), len(names)),
        opposite=np.array([name.startswith("o.") for name in names], bool),
        parked=np.array([name.startswith("parked.") for name in names], bool),
        front_m=front,
        offset_m=offset,
        speed_mps=speed,
    )
