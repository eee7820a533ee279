"""The truth of a simulated flight, checked without the simulator's own code."""

from __future__ import annotations

import csv
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from queuetail.config import parse_settings
from queuetail.sim.flight import TruePath
from queuetail.sim.scenario import Scenario
from queuetail.sim.simulate import simulate
from queuetail.sim.traffic import simulate_traffic
from queuetail.sim.truth import end_of_queue
from queuetail.types import CameraPose

pytest.importorskip("libsumo", reason="the extra `sim` is not installed")

SHORT = {
    "scenario": {"duration_s": 24.0, "name": "short"},
    "traffic": {
        "demand_vph": 2600,
        "queue": {"cause": "flagger", "start_s": -4.0, "duration_s": 12.0, "at_m": 60},
    },
    "picture": {"width_px": 320, "height_px": 180, "frame_rate_hz": 5},
}


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return parse_settings(Scenario, SHORT, "short")


@pytest.fixture(scope="module")
def flight(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("flight")
    simulate(scenario, out, seed=4)
    return out


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def by_hand(east: float, north: float, up: float, pose: CameraPose) -> tuple[float, float]:
    """Project metres relative to the ground below the camera, with school trigonometry."""
    yaw, pitch, roll = (math.radians(a) for a in (pose.yaw_deg, pose.pitch_deg, pose.roll_deg))
    height = up - pose.height_agl_m
    ahead = east * math.sin(yaw) + north * math.cos(yaw)  # along the heading, on the ground
    right = east * math.cos(yaw) - north * math.sin(yaw)
    depth = ahead * math.cos(pitch) + height * math.sin(pitch)
    down = ahead * math.sin(pitch) - height * math.cos(pitch)
    x = right * math.cos(roll) + down * math.sin(roll)
    y = down * math.cos(roll) - right * math.sin(roll)
    lens = pose.intrinsics
    return lens.cx_px + lens.fx_px * x / depth, lens.cy_px + lens.fy_px * y / depth


def metres_from(lat: float, lon: float, pose: CameraPose) -> tuple[float, float]:
    """Return metres east and north of the drone by the radii of curvature of WGS84."""
    a, e2 = 6_378_137.0, 6.694379990141e-3
    bend = 1 - e2 * math.sin(math.radians(pose.lat_deg)) ** 2
    north = math.radians(lat - pose.lat_deg) * a * (1 - e2) / bend**1.5
    east = math.radians(lon - pose.lon_deg) * a / math.sqrt(bend)
    return east * math.cos(math.radians((lat + pose.lat_deg) / 2)), north


def test_truth_pixels_agree_with_trigonometry(scenario: Scenario, flight: Path) -> None:
    path = TruePath(scenario, 4)
    checked = 0
    for row in rows(flight / "truth.csv"):
        if not row["eoq_lat"]:
            continue
        pose = path.view(float(row["t_s"])).pose
        east, north = metres_from(float(row["eoq_lat"]), float(row["eoq_lon"]), pose)
        u, v = by_hand(east, north, 0.0, pose)
        assert abs(u - float(row["eoq_u_px"])) < 0.15
        assert abs(v - float(row["eoq_v_px"])) < 0.15
        checked += 1
    assert checked > 30


def brute_force_queued(t_s: np.ndarray, speed: np.ndarray, limit: float) -> np.ndarray:
    """Read one vehicle's speeds literally: second by second, sample by sample."""
    queued, out = False, []
    for i, now in enumerate(t_s):
        window = [j for j in range(max(i - 20, 0), i + 1) if t_s[j] >= now - 1.0 - 1e-6]
        whole = now - t_s[window[0]] >= 1.0 - 1e-6
        if whole and all(speed[j] < limit for j in window):
            queued = True
        if whole and all(speed[j] > 1.25 * limit for j in window):
            queued = False
        out.append(queued)
    return np.array(out)


def test_eoq_agrees_with_a_brute_force_reading(scenario: Scenario, flight: Path) -> None:
    traffic = simulate_traffic(scenario, 4)
    limit = 55 * 0.44704 / 3
    states = {}
    for n in range(len(traffic.ids)):
        here = np.flatnonzero(~np.isnan(traffic.speed_mps[:, n]))
        states[n] = (
            here,
            brute_force_queued(traffic.tick_s[here], traffic.speed_mps[here, n], limit),
        )
    for row in rows(flight / "truth.csv"):
        k = int(np.flatnonzero(traffic.tick_s <= float(row["t_s"]) + 1e-9)[-1])
        rears = sorted(
            float(traffic.front_m[k, n] - traffic.length_m[n])
            for n, (here, queued) in states.items()
            if here[0] <= k <= here[-1] and queued[k - here[0]]
        )
        ends = [a for a, b in itertools.pairwise(rears) if b - a <= 60.0]
        assert bool(row["eoq_station_m"]) == bool(ends)
        if ends:  # the file's place is interpolated within the tick of 0.1 s
            assert abs(float(row["eoq_station_m"]) - ends[0]) < 0.1 * 1.25 * limit + 0.02


def test_end_of_queue_needs_a_companion_within_60_m() -> None:
    rear = np.array([500.0, 100.0, 159.9, 20.0])
    assert end_of_queue(rear, np.array([True, True, True, True])) == 1
    assert end_of_queue(rear, np.array([True, True, False, True])) is None
    assert end_of_queue(rear, np.zeros(4, bool)) is None


def test_same_seed_same_bytes(scenario: Scenario, flight: Path, tmp_path: Path) -> None:
    simulate(scenario, tmp_path, seed=4)
    for name in ("truth.csv", "vehicles.csv", "road.csv", "telemetry.csv", "flight.srt"):
        assert (tmp_path / name).read_bytes() == (flight / name).read_bytes()
