"""Two simulated signs along the bundled flight, flown live: signs.py [--faces DIR].

The flight runs in real time through the live pipeline into the signs' controller, which is armed.
The far sign dies in mid-flight, comes back without memory, and must then show the newest message
only.  Printed is what each sign shows, when, and how far the truth is from it.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
from pathlib import Path
from time import monotonic, sleep

from queuetail.config import Site, read_site
from queuetail.live.open_feed import open_feed
from queuetail.live.runtime import LiveRun
from queuetail.signs.agent import SignAgent
from queuetail.signs.controller import SignController
from queuetail.signs.records import Phases, as_text
from queuetail.video.stream_source import parse_source

FLAGGER = Path(__file__).resolve().parent.parent / "examples" / "flagger"
FAR_M, NEAR_M = 540.0, 915.0  # stations: the queue reaches about 887 m, and passes the near sign
AWAY_S = (42.0, 56.0)  # of the flight: the far sign is dead
AFTER_S = 15.0  # after the flight's end: caution, then the default


def true_end(t_s: float) -> float | None:
    """Return the true station of the end of the queue, None where there is no queue."""
    with (FLAGGER / "truth.csv").open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if float(row["t_s"]) >= t_s:
                return float(row["eoq_station_m"]) if row["eoq_station_m"] else None
    return None


def site(far: SignAgent, near: SignAgent) -> Site:
    """Return the flight's site file with two signs."""
    signs = [
        {"name": "far", "station_m": FAR_M, "address": far.address},
        {"name": "near", "station_m": NEAR_M, "address": near.address, "default": [["WORK"]]},
    ]
    raw = read_site(FLAGGER / "site.toml").model_dump(exclude_unset=True)
    return Site.model_validate({**raw, "sign": signs, "signs": {"hold_s": 5.0, "release_s": 2.0}})


def fly(folder: Path, faces: Path | None) -> None:
    """Fly once and print what the signs show."""
    agents = {"far": SignAgent(), "near": SignAgent()}
    port = agents["far"].port
    resolved = site(agents["far"], agents["near"])
    source = parse_source(str(FLAGGER / "flight.mp4"), realtime=True)
    feed = open_feed(str(FLAGGER / "telemetry.csv"), source, resolved)
    run = LiveRun(source, feed, resolved)
    controller = SignController(resolved, folder, environment={})
    controller.arming.arm("benchmark")
    run.subscribe(controller)
    run.start()
    shown: dict[str, Phases] = {}
    ended_s: float | None = None
    latencies: dict[str, list[float]] = {}
    rates: dict[str, list[float]] = {}
    while ended_s is None or monotonic() - ended_s < AFTER_S:
        newest = run.newest()
        t_s = newest.observation.t_s if newest and newest.frame else None
        for name, agent in agents.items():
            if agent.alive and shown.get(name) != agent.phases():
                shown[name] = agent.phases()
                _tell(name, t_s, shown[name])
                if faces is not None:
                    number = len(list(faces.glob("*.png")))
                    (faces / f"{number:02d}-{name}.png").write_bytes(agent.face_png())
        away = t_s is not None and AWAY_S[0] <= t_s < AWAY_S[1]
        if away and agents["far"].alive:
            agents["far"].close()
            print(f"{t_s:6.1f} s  far   dies")
        elif not away and not agents["far"].alive and t_s is not None and t_s >= AWAY_S[1]:
            agents["far"] = SignAgent(port=port)
            shown.pop("far", None)
            print(f"{t_s:6.1f} s  far   is back, without memory")
        if newest and newest.frame:
            key = "while the far sign is dead" if away else "otherwise"
            latencies.setdefault(key, []).append(newest.health.latency_p99_ms or 0.0)
            rates.setdefault(key, []).append(newest.health.frame_rate_hz or 0.0)
        if ended_s is None and run.ended.is_set():
            ended_s = monotonic()
        sleep(0.02)
    run.stop()
    for key, values in latencies.items():
        rate = sum(rates[key]) / len(rates[key])
        print(f"{key}: p99 {max(values):.0f} ms at worst, {rate:.1f} answers/s on average")
    for agent in agents.values():
        agent.close()


def _tell(name: str, t_s: float | None, phases: Phases) -> None:
    when = f"{t_s:6.1f} s" if t_s is not None else "       –"
    end_m = true_end(t_s) if t_s is not None else None
    station_m = FAR_M if name == "far" else NEAR_M
    truth = f"truly {end_m - station_m:.0f} m away" if end_m is not None else "truly no queue"
    print(f"{when}  {name:5} {as_text(phases)}  ({truth})")


def main() -> None:
    """Parse the command line and fly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--faces", type=Path, metavar="DIR", help="write every face there as PNG")
    faces = parser.parse_args().faces
    if faces is not None:
        faces.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        fly(Path(folder), faces)
        rows = [json.loads(r) for r in (Path(folder) / "signs.jsonl").read_text().splitlines()]
    kinds = [row["event"] for row in rows]
    print("log:", ", ".join(f"{kinds.count(k)} {k}" for k in sorted(set(kinds))))
    for row in rows:
        if row["event"] == "decision" and "move_to_station_m" in row:
            print(f"{row['sign']}: {row['placement']}, move to {row['move_to_station_m']:.0f} m")


if __name__ == "__main__":
    main()
