"""`--random SEED`: scenarios drawn from ranges, so that nobody can tune to the named ones."""

from __future__ import annotations

from typing import Any

import numpy as np

from queuetail.config import parse_settings
from queuetail.errors import InputError
from queuetail.sim.check import check_drawable
from queuetail.sim.scenario import Scenario

ATTEMPTS = 50
CAUSES = ("flagger", "flagger", "signal", "lane_drop", "incident", "waves", "moving_bottleneck")
NO_QUEUE_SHARE = 0.2


def random_scenario(seed: int) -> Scenario:
    """Draw a scenario that can be drawn; the same seed gives the same scenario."""
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([seed, 53, attempt])
        scenario = parse_settings(Scenario, _draw(rng, seed), f"random scenario {seed}")
        try:
            check_drawable(scenario)
        except InputError:
            continue
        return scenario
    raise RuntimeError(f"no drawable scenario in {ATTEMPTS} attempts for seed {seed}")


def _draw(rng: np.random.Generator, seed: int) -> dict[str, Any]:
    lanes = int(rng.choice([1, 2, 2, 3]))
    bend = float(rng.choice([-1, 1]) * rng.uniform(150, 900)) if rng.random() < 0.35 else 0.0
    road = {
        "lanes": lanes,
        "lane_width_m": _uniform(rng, 3.1, 3.75, 2),
        "shoulder_m": _uniform(rng, 2.2, 3.2),
        "course_deg": _uniform(rng, 0, 360),
        "bend_radius_m": round(bend),
        "grade_percent": _uniform(rng, -4, 4),
        "asphalt": str(rng.choice(["dark", "light"])),
        "markings": str(rng.choice(["new", "worn"])),
        "concrete_joints": bool(rng.random() < 0.2),
    }
    return {
        "scenario": {"name": f"random_{seed}", "seed": seed, "duration_s": 75.0},
        "road": road,
        "traffic": _traffic(rng, lanes),
        "opposite": _opposite(rng),
        "flight": _flight(rng),
        "picture": _picture(rng),
        "telemetry": _telemetry(rng),
    }


def _uniform(rng: np.random.Generator, low: float, high: float, digits: int = 1) -> float:
    return round(float(rng.uniform(low, high)), digits)


def _traffic(rng: np.random.Generator, lanes: int) -> dict[str, Any]:
    per_lane = _uniform(rng, 350, 1500, 0)
    speed_mph = float(rng.choice([35, 45, 55, 65, 70]))
    causes = CAUSES if lanes > 1 else tuple(c for c in CAUSES if c not in ("lane_drop", "incident"))
    cause = "none" if rng.random() < NO_QUEUE_SHARE else str(rng.choice(causes))
    queue = {
        "cause": cause,
        "start_s": _uniform(rng, -40, 30),
        "duration_s": _uniform(rng, 25, 90),
        "at_m": _uniform(rng, 0, 130),
        "crawl_mph": round(speed_mph * float(rng.uniform(0.08, 0.24)), 1),
        "period_s": _uniform(rng, 30, 60),
    }
    return {
        "demand_vph": per_lane * lanes,
        "truck_share": _uniform(rng, 0, 0.3, 2),
        "posted_speed_mph": speed_mph,
        "parked": int(rng.choice([0, 0, 0, 3, 6])),
        "queue": queue,
    }


def _opposite(rng: np.random.Generator) -> dict[str, Any]:
    lanes = int(rng.choice([0, 1, 2, 3]))
    queue = {"cause": "flagger", "start_s": _uniform(rng, -30, 20), "at_m": _uniform(rng, 0, 90)}
    table: dict[str, Any] = {
        "lanes": lanes,
        "median_m": _uniform(rng, 0.4, 14),
        "demand_vph": _uniform(rng, 300, 1400, 0) * lanes,
    }
    if lanes and rng.random() < 0.3:
        table["queue"] = queue
    return table


def _flight(rng: np.random.Generator) -> dict[str, Any]:
    pitch_deg = -90.0 if rng.random() < 0.2 else -_uniform(rng, 28, 88)
    table = {
        "height_m": _uniform(rng, 60, 122),
        "hfov_deg": _uniform(rng, 58, 90),
        "pitch_deg": pitch_deg,
        "heading_to_road_deg": _uniform(rng, -180, 180),
        "aim_m": _uniform(rng, -40, 10),
        "aim_left_m": _uniform(rng, -12, 12),
        "jitter_m": _uniform(rng, 0.05, 0.5, 2),
        "jitter_deg": _uniform(rng, 0.02, 0.2, 2),
        "drift_mps": _uniform(rng, 0, 0.1, 2),
        "drift_course_deg": _uniform(rng, 0, 360),
    }
    if rng.random() < 0.3:
        table |= {"gust_m": _uniform(rng, 0.3, 2), "gust_deg": _uniform(rng, 0.3, 2)}
    if rng.random() < 0.2:
        table |= {"yaw_correction_deg": _uniform(rng, -25, 25)}
    return table


def _picture(rng: np.random.Generator) -> dict[str, Any]:
    table: dict[str, Any] = {
        "frame_rate_hz": float(rng.choice([24, 25, 30])),
        "noise": _uniform(rng, 1, 6),
        "brightness": _uniform(rng, 0.6, 1.15, 2),
        "sun_azimuth_deg": _uniform(rng, 0, 360),
        "sun_elevation_deg": _uniform(rng, 12, 70),
        "shadow": _uniform(rng, 0.05, 0.7, 2),
        "haze": _uniform(rng, 0, 0.6, 2),
        "land": str(rng.choice(["grass", "dry", "fields"])),
    }
    if rng.random() < 0.3:
        table |= {"clouds": _uniform(rng, 0.2, 0.7), "brightness_change": _uniform(rng, 0, 0.2, 2)}
    if rng.random() < 0.25:
        table |= {"tree_shadows": int(rng.integers(5, 30))}
    if rng.random() < 0.3:
        table |= {"bit_rate_kbps": _uniform(rng, 400, 3000, 0)}
    if rng.random() < 0.2:
        table |= {"codec": "h265"}
    if rng.random() < 0.3:
        table |= {"interval_jitter": _uniform(rng, 0, 0.3, 2), "dropped_share": 0.1}
    if rng.random() < 0.15:
        table |= {"occluder": str(rng.choice(["gantry", "bridge"])), "occluder_at_m": -15.0}
    return table


def _telemetry(rng: np.random.Generator) -> dict[str, Any]:
    return {
        "position_rate_hz": float(rng.choice([1, 5, 10])),
        "attitude_rate_hz": float(rng.choice([5, 10])),
        "gps_walk_m": _uniform(rng, 0, 1.5),
        "height_error_m": _uniform(rng, -1, 1),
        "heading_bias_deg": _uniform(rng, -1, 1),
        "pitch_bias_deg": _uniform(rng, -0.5, 0.5),
        "time_offset_s": _uniform(rng, -0.2, 0.2, 2),
    }
