"""Does the road preset's memory stay flat?  `memory.py --hours 2`.

The bundled flight goes through the pipeline over and over, its time running on, without tables or
report.  Prints the resident memory of the process every ten simulated minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil

from queuetail.config import read_site
from queuetail.flight import open_flight
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.types import Image

FLAGGER = Path(__file__).resolve().parent.parent / "examples" / "flagger"
EVERY_S = 600.0


def no_colours(width: int, height: int) -> Image:
    """Stand for the colours of a frame that only its luma is asked of."""
    return np.zeros((height, width, 3), np.uint8)


def main() -> None:
    """Print a row every ten simulated minutes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=2.0)
    until_s = 3600 * parser.parse_args().hours
    site = read_site(FLAGGER / "site.toml")
    with open_flight(FLAGGER / "flight.mp4", FLAGGER / "telemetry.csv", site) as flight:
        size = flight.video.width_px, flight.video.height_px
        pipeline = PRESETS["road"](site, flight.origin, *size, lambda stage: None)
    begun_s, told_s, steps = 0.0, 0.0, 0
    print("| simulated minutes | pictures | resident memory |\n|---|---|---|")
    while begun_s < until_s:
        with open_flight(FLAGGER / "flight.mp4", FLAGGER / "telemetry.csv", site) as flight:
            last_s, pace = 0.0, Pace(pipeline.longest_s)
            for frame in flight.frames():
                if not pace.takes(frame.t_s):
                    continue
                last_s = frame.t_s
                now = replace(frame, index=steps, t_s=begun_s + last_s, bgr=no_colours)
                pipeline.step(now, flight.telemetry_at(last_s))
                steps += 1
                if now.t_s >= told_s:
                    used_mb = psutil.Process().memory_info().rss / 1e6
                    print(f"| {now.t_s / 60:.0f} | {steps} | {used_mb:.0f} MB |", flush=True)
                    told_s += EVERY_S
            begun_s += last_s + 1 / 15


if __name__ == "__main__":
    main()
