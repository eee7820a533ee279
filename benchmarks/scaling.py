"""How the road preset's cost grows with the picture and with the traffic: `scaling.py`.

Three simulated hovers, with about 5, 50 and 200 vehicles in view, are held in memory at four sizes
and driven through the pipeline.  Prints the milliseconds of processor time that each stage takes of
a picture, without decoding, once the road is known.  About five minutes on two cores.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from pathlib import Path

import cv2
import numpy as np

from queuetail.config import read_site
from queuetail.flight import Flight, open_flight
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.sim.scenario import Scenario
from queuetail.sim.simulate import simulate
from queuetail.types import Frame, Image

SIZES = ((960, 540), (1280, 720), (1920, 1080), (3840, 2160))
STANDING = {"cause": "flagger", "start_s": -90, "duration_s": 200, "at_m": 110}
TRAFFIC: dict[int, dict[str, object]] = {
    5: {"road": {"lanes": 1}, "traffic": {"demand_vph": 900}},
    50: {"road": {"lanes": 2}, "traffic": {"demand_vph": 3600, "queue": STANDING}},
    200: {
        "road": {"lanes": 6},
        "traffic": {"demand_vph": 12000, "truck_share": 0.04, "queue": STANDING},
        "flight": {"height_m": 119, "pitch_deg": -70},
    },
}
SECONDS, WARM_S = 12.0, 4.0
STAGES = ("register", "map", "road", "view", "background", "detect", "track", "queue")


class Shares:
    """Processor time of this thread per stage, from the moment that counting is on."""

    def __init__(self) -> None:
        self.spent_s: Counter[str] = Counter()
        self.counting = False
        self._last_s = time.thread_time()

    def lap(self, stage: str) -> None:
        now_s = time.thread_time()
        if self.counting:
            self.spent_s[stage] += now_s - self._last_s
        self._last_s = now_s


def flight_with(vehicles: int, folder: Path) -> Path:
    """Simulate the hover with about so many vehicles in view, unless it is there already."""
    place = folder / f"vehicles_{vehicles}"
    if not (place / "flight.mp4").is_file():
        head = {"duration_s": SECONDS, "seed": vehicles, "name": place.name}
        simulate(Scenario.model_validate({"scenario": head, **TRAFFIC[vehicles]}), place)
    return place


def frames_of(flight: Flight) -> list[tuple[float, list[Image]]]:
    """Return the time and the planes of every picture."""
    return [(f.t_s, [f.luma.copy(), *(c.copy() for c in f.chroma)]) for f in flight.frames()]


def measure(place: Path, size: tuple[int, int]) -> tuple[dict[str, float], int]:
    """Return each stage's milliseconds per processed picture, and the vehicles followed."""
    site = read_site(place / "site.toml")
    with open_flight(place / "flight.mp4", place / "telemetry.csv", site) as flight:
        shares = Shares()
        pipeline = PRESETS["road"](site, flight.origin, *size, shares.lap)
        processed, followed, pace = 0, 0, Pace(pipeline.longest_s)
        for index, (t_s, planes) in enumerate(frames_of(flight)):
            if not pace.takes(t_s):
                continue
            luma, *chroma = planes
            half = (size[0] // 2, size[1] // 2)
            frame = Frame(
                index,
                t_s,
                cv2.resize(luma, size, interpolation=cv2.INTER_LINEAR),
                lambda w, h: np.zeros((h, w, 3), np.uint8),
                tuple(cv2.resize(c, half, interpolation=cv2.INTER_LINEAR) for c in chroma),
            )
            shares.lap("")  # scaling is no stage
            shares.counting = t_s >= WARM_S
            seen = pipeline.step(frame, flight.telemetry_at(t_s))
            processed += shares.counting
            followed = max(followed, len(seen.vehicles))
    return {s: 1e3 * shares.spent_s[s] / processed for s in STAGES}, followed


def main() -> None:
    """Print a row per size and traffic."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=Path, default=Path("out/scaling"), metavar="DIR")
    folder = parser.parse_args().flights
    cv2.setNumThreads(1)
    print(f"| picture | vehicles followed | {' | '.join(STAGES)} | all |")
    print("|---" * (len(STAGES) + 3) + "|")
    for vehicles in TRAFFIC:
        place = flight_with(vehicles, folder)
        for size in SIZES:
            spent, followed = measure(place, size)
            cells = " | ".join(f"{spent[s]:.2f}" for s in STAGES)
            print(f"| {size[0]}×{size[1]} | {followed} | {cells} | {sum(spent.values()):.2f} |")


if __name__ == "__main__":
    main()
