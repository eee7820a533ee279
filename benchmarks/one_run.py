"""Run one preset on one simulated flight, evaluate it, and write the figures as JSON.

python benchmarks/one_run.py FLIGHT_DIR VARIANT RUN_DIR FIGURES.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from queuetail.config import read_site
from queuetail.evaluate import evaluate, to_json
from queuetail.run import run
from queuetail.sim.scenario import Scenario, read_scenario
from queuetail.types import Floats

# Which preset a variant is, and whether it is told where the road is, or the posted limit only.
VARIANTS = {"road": ("road", True), "road-no-site": ("road", False), "paper": ("paper", True)}


def figures_of(flight: Path, variant: str, out: Path) -> dict[str, Any]:
    """Run and evaluate; return the evaluation and what pooling over the suite needs beside it."""
    preset, with_site = VARIANTS[variant]
    scenario = read_scenario(flight / "scenario.toml")
    site = flight / "site.toml" if with_site else limit_only(flight / "site.toml", out)
    started = perf_counter()
    result = run(
        flight / "flight.mp4",
        flight / "telemetry.csv",
        site,
        preset,
        out,
        with_video=False,
    )
    run_s = perf_counter() - started
    evaluation = evaluate(out, flight)
    return {
        "exact_telemetry": is_exact(scenario),
        "frames": result.frames,
        "run_s": round(run_s, 2),
        "tolerant_errors_m": _absolute(evaluation.timeline.tolerant_m),
        "strict_errors_m": _absolute(evaluation.timeline.strict_m),
        "true_rows": _rows(flight / "vehicles.csv"),
        "track_rows": _rows(out / "tracks.csv"),
        **to_json(evaluation),
    }


def limit_only(site: Path, out: Path) -> Path:
    """Write a site file that says no more than the posted limit, which is what `queued` means."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "limit.toml"
    limit_mph = read_site(site).site.posted_speed_mph
    path.write_text("" if limit_mph is None else f"[site]\nposted_speed_mph = {limit_mph:g}\n")
    return path


def is_exact(scenario: Scenario) -> bool:
    """Say whether the flight's log tells the truth, whenever it speaks."""
    log = scenario.telemetry
    wrong = (
        *(log.gps_walk_m, log.height_error_m, log.heading_bias_deg),
        *(log.pitch_bias_deg, log.time_offset_s),
    )
    return not any(wrong) and not log.gaps


def _absolute(errors: Floats) -> list[float]:
    """Return every sample's error, so that a percentile over the suite is one over samples."""
    return [round(float(e), 2) for e in np.abs(errors[np.isfinite(errors)])]


def _rows(path: Path) -> int:
    with path.open("rb") as file:
        return sum(1 for _ in file) - 1


def main() -> None:
    """Do as the module says."""
    flight, variant, out, target = sys.argv[1:]
    record = figures_of(Path(flight), variant, Path(out))
    Path(target).write_text(json.dumps(record) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
