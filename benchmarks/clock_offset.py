"""Measure how well the offset between video and telemetry is found: `clock_offset.py FLIGHT …`.

Each FLIGHT is a folder as `queuetail simulate` writes it.  Its log is sampled at several rates and
rounded as drones do, shifted by known times, and the offset is estimated from the picture's motion.
The printed errors are against the shift and the scenario's own `time_offset_s`.
"""

from __future__ import annotations

import argparse
import dataclasses
import tomllib
from pathlib import Path

import numpy as np

from queuetail.config import read_site
from queuetail.flight import Flight, open_flight
from queuetail.live.clock_offset import OffsetEstimator
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.telemetry.flightlog import FlightLog
from queuetail.types import Registration

SHIFTS_S = (-3.3, -1.0, -0.25, 0.0, 0.5, 2.0)
LOGS = ((10.0, 0.1, 0.0), (10.0, 0.1, 0.03), (5.0, 0.1, 0.05), (1.0, 0.1, 0.0), (0.5, 1.0, 0.0))
EDGE_S = 1.0


def registrations(folder: Path, flight: Flight) -> list[tuple[float, Registration]]:
    """Run the flight through the road preset and keep how the picture moved."""
    site = read_site(folder / "site.toml")
    size = flight.video.width_px, flight.video.height_px
    pipeline = PRESETS["road"](site, flight.origin, *size, lambda stage: None)
    kept, pace = [], Pace(pipeline.longest_s)
    for frame in flight.frames():
        if not pace.takes(frame.t_s):
            continue
        seen = pipeline.step(frame, flight.telemetry_at(frame.t_s))
        kept.append((frame.t_s, seen.registration))
    return kept


def coarse(
    flight: Flight, end_s: float, rate_hz: float, round_deg: float, jitter_s: float
) -> FlightLog:
    """Return the flight's log as a slower, coarser drone would write it."""
    rng = np.random.default_rng(3)
    samples = []
    for t_s in np.arange(0.0, end_s, 1 / rate_hz).tolist():
        told = flight.telemetry_at(t_s)
        rounded: dict[str, float | None] = {"t_s": t_s + rng.normal(0, jitter_s)}
        for name in ("heading_deg", "gimbal_pitch_deg", "gimbal_roll_deg"):
            value = getattr(told, name)
            rounded[name] = None if value is None else round(value / round_deg) * round_deg
        for name in ("lat_deg", "lon_deg"):
            value = getattr(told, name)
            rounded[name] = None if value is None else round(value, 6)
        samples.append(dataclasses.replace(told, **rounded))  # type: ignore[arg-type]
    return FlightLog(samples, "a coarse log")


def own_offset_s(folder: Path) -> float:
    """Return what the scenario itself says: its log is late by that much."""
    scenario = tomllib.loads((folder / "scenario.toml").read_text("utf-8"))
    return -float(scenario.get("telemetry", {}).get("time_offset_s", 0.0))


def measure(folder: Path) -> list[float]:
    """Print a row per kind of log; return the errors in sigmas."""
    in_sigmas = []
    site = read_site(folder / "site.toml")
    log = folder / "telemetry.csv"
    with open_flight(folder / "flight.mp4", log, site) as flight:
        moved = registrations(folder, flight)
        size = flight.video.width_px, flight.video.height_px
        found = OffsetEstimator(*size, site.camera)
        for t_s, registration in moved:
            found.add(t_s, registration)
        for rate_hz, round_deg, jitter_s in LOGS:
            told = coarse(flight, moved[-1][0], rate_hz, round_deg, jitter_s)
            cells = []
            for shift_s in SHIFTS_S:
                offset = found.estimate(told.shifted(-shift_s).at)
                if offset.offset_s is None or offset.sigma_s is None:
                    cells.append("    unknown   ")
                    continue
                error_s = offset.offset_s - shift_s - own_offset_s(folder)
                in_sigmas.append(error_s / offset.sigma_s)
                cells.append(f"{error_s:+.3f}±{offset.sigma_s:.3f}  ")
            row = f"{rate_hz:4.1f} Hz {round_deg:.1f}° ±{1000 * jitter_s:2.0f} ms"
            print(f"{folder.name:16s} {row}  {' '.join(cells)}", flush=True)
    return in_sigmas


def main() -> None:
    """Print the errors of every flight, and how honest the sigmas are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("flights", type=Path, nargs="+", metavar="FLIGHT")
    shifts = "  ".join(f"{s:+.2f} s      " for s in SHIFTS_S)
    print(f"{'flight':16s} {'log':19s}  {shifts}")
    in_sigmas = [z for folder in parser.parse_args().flights for z in measure(folder)]
    beyond = np.abs(in_sigmas)
    print(
        f"{len(in_sigmas)} estimates: error over sigma is {np.sqrt(np.mean(beyond**2)):.2f} rms, "
        f"{beyond.max():.2f} at most"
    )


if __name__ == "__main__":
    main()
