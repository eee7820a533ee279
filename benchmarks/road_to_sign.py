"""From the road to the sign, with real parts that die on the way: road_to_sign.py [--only …].

A simulated flight (`road_to_sign.toml` beside this file) goes live through `queuetail live` with
two simulated signs (SNMP agents), a Mosquitto and a webhook receiver (a process).  The queue forms,
its end passes the near sign, and it dissolves.  The far sign, the broker and the receiver are
killed in mid-flight and come back.  In a second flight queuetail itself dies by `kill -9` while a
sign shows a distance.  Printed are what the signs show beside the truth, and what the outage did.
"""

from __future__ import annotations

import argparse
import csv
import http.server
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic, sleep
from typing import Any

from broadcast import free_port
from live_soak import ask
from queuetail.signs.agent import SignAgent
from queuetail.signs.arming import ask as switch
from queuetail.signs.records import Phases, as_text

ROOT = Path(__file__).resolve().parent.parent
CLI = (sys.executable, "-m", "queuetail.cli")
SCENARIO = Path(__file__).with_suffix(".toml")
STATIONS_M = {"far": 480.0, "near": 885.0}
AWAY_S = (30.0, 45.0)  # of the flight
KILL_CLOCK = 20.0  # the killed run's sign lives so much faster: its minute lasts 3 s
FEET = {"500 FT": 152.4, "1000 FT": 304.8, "1/4 MILE": 402.3, "1/2 MILE": 804.7}
SIGN = """
[[sign]]
name = "{name}"
station_m = {station_m}
address = "{address}"
"""
FEEDS = """
[signs]
refresh_s = {refresh_s}
[feeds.mqtt]
host = "127.0.0.1"
port = {broker}
[[feeds.webhook]]
url = "http://127.0.0.1:{hook}/"
allow_private = true
"""


class Truth:
    """Where the queue truly ends."""

    def __init__(self, path: Path) -> None:
        with path.open(encoding="utf-8", newline="") as file:
            self._rows = [
                (float(row["t_s"]), float(row["eoq_station_m"]) if row["eoq_station_m"] else None)
                for row in csv.DictReader(file)
            ]
        ends = [t_s for t_s, end_m in self._rows if end_m is not None]
        self.first_s, self.last_s = ends[0], ends[-1]

    def end_m(self, t_s: float) -> float | None:
        """Return the true station at a time, None without a queue."""
        return min(self._rows, key=lambda row: abs(row[0] - t_s))[1]

    def passes_s(self, station_m: float) -> float:
        """Return when the queue first reaches a station."""
        return next(t for t, end_m in self._rows if end_m is not None and end_m <= station_m)


@dataclass
class Heard:
    """What the receivers got: on the wall clock, with the record."""

    hooks: Path
    events: list[tuple[float, dict[str, Any]]] = field(default_factory=list)
    states: list[tuple[float, dict[str, Any]]] = field(default_factory=list)

    def posted(self) -> list[tuple[float, dict[str, Any]]]:
        """Return what the webhook's receiver wrote down."""
        if not self.hooks.exists():
            return []
        lines = self.hooks.read_text("utf-8").splitlines()
        return [(row["at"], row["body"]) for row in map(json.loads, lines)]


def receive(port: int, path: Path) -> None:
    """Be a webhook's receiver: write every body down with its time."""

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
            with path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"at": datetime.now(UTC).timestamp(), "body": body}) + "\n")
            self.send_response(204)
            self.end_headers()

        def log_message(self, format: str, *words: object) -> None:
            """Say nothing."""

    http.server.ThreadingHTTPServer(("127.0.0.1", port), Handler).serve_forever()


class Killable:
    """A program that can be killed as a power cut would, and started again."""

    def __init__(self, *command: str) -> None:
        self._command = command
        self.start()

    def start(self) -> None:
        """Start it."""
        null = subprocess.DEVNULL
        self._process = subprocess.Popen(self._command, stdout=null, stderr=null)

    def kill(self) -> None:
        """Kill it."""
        self._process.kill()
        self._process.wait()


@contextmanager
def receivers(work: Path) -> Iterator[tuple[int, int, list[Killable], Heard]]:
    """Start the broker, its listener and the webhook's receiver."""
    import paho.mqtt.client as mqtt  # noqa: PLC0415 - comes with aiomqtt

    broker = shutil.which("mosquitto", path=f"{os.environ['PATH']}:/usr/sbin")
    if broker is None:
        raise SystemExit("mosquitto is not installed (apt-get install mosquitto)")
    broker_port, hook_port = free_port(), free_port()
    heard = Heard(work / "hooks.jsonl")
    listener = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2)
    listener.reconnect_delay_set(0.1, 0.5)
    listener.on_connect = lambda client, *_: client.subscribe("queuetail/#", 1)

    def note(client: object, data: object, message: Any) -> None:
        record = json.loads(message.payload)
        kept = heard.events if message.topic.endswith("/event") else heard.states
        kept.append((datetime.now(UTC).timestamp(), record))

    listener.on_message = note
    programs = [
        Killable(broker, "-p", str(broker_port)),
        Killable(sys.executable, __file__, "--receive", str(hook_port), str(heard.hooks)),
    ]
    listener.connect_async("127.0.0.1", broker_port)
    listener.loop_start()
    try:
        yield broker_port, hook_port, programs, heard
    finally:
        listener.loop_stop()
        for program in programs:
            program.kill()


@contextmanager
def live(work: Path, flight: Path, site: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """Run `queuetail live` on the flight in real time, armed; give its process and port."""
    file = work / "site.toml"
    file.write_text((flight / "site.toml").read_text("utf-8") + site, encoding="utf-8")
    command = [*CLI, "live", str(flight / "flight.mp4"), "--realtime", "--no-store"]
    command += ["--telemetry", str(flight / "telemetry.csv"), "--site", str(file)]
    command += ["--out", str(work / "out"), "--port", "0"]
    secret = {"QUEUETAIL_WEBHOOK_SECRET": os.urandom(24).hex()}
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, env={**os.environ, **secret}
    )
    try:
        assert process.stdout is not None
        found = re.search(r":(\d+)/", process.stdout.readline())
        assert found is not None
        switch(work / "out", True, "benchmark")
        yield process, int(found[1])
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
            process.wait(30)
        elif process.returncode not in (0, -signal.SIGKILL):
            print(f"queuetail live ended with {process.returncode}")


def flight_zero_s(port: int) -> float:
    """Return when the flight's first picture came, on the monotonic clock."""
    while True:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/api/v1/state", timeout=10) as reply:
            state = json.load(reply)
        if state["t_s"]:
            return float(monotonic() - state["t_s"] - state["age_s"])
        sleep(0.05)


@dataclass
class Row:
    """One change of one sign."""

    t_s: float
    sign: str
    phases: Phases


def fly(work: Path, flight: Path, truth: Truth) -> None:
    """Fly once with everything, kill and restart the parts, print the tables."""
    agents = {name: SignAgent() for name in STATIONS_M}
    port_far = agents["far"].port
    rows: list[Row] = []
    health: list[tuple[float, float]] = []
    with receivers(work) as (broker, hook, programs, heard):
        site = FEEDS.format(broker=broker, hook=hook, refresh_s=20)
        for name, station_m in STATIONS_M.items():
            address = agents[name].address
            site += SIGN.format(name=name, station_m=station_m, address=address)
        with live(work, flight, site) as (process, port):
            zero_s = flight_zero_s(port)
            zero_utc = datetime.now(UTC).timestamp() - (monotonic() - zero_s)
            asked_s, state = 0.0, "before"
            while process.poll() is None:
                t_s = monotonic() - zero_s
                for name, agent in agents.items():
                    last = next((r.phases for r in reversed(rows) if r.sign == name), ())
                    if agent.alive and agent.phases() != last:
                        rows.append(Row(t_s, name, agent.phases()))
                if state == "before" and t_s >= AWAY_S[0]:
                    state = "away"
                    agents["far"].close()
                    rows.append(Row(t_s, "far", (("(killed)",),)))
                    for program in programs:
                        program.kill()
                elif state == "away" and t_s >= AWAY_S[1]:
                    state = "back"
                    agents["far"] = SignAgent(port=port_far)
                    rows.append(Row(t_s, "far", ()))
                    for program in programs:
                        program.start()
                if t_s - asked_s >= 1.0 and process.poll() is None:
                    asked_s = t_s
                    health.append((t_s, _p99_ms(port)))
                sleep(0.02)
        print_signs(rows, truth)
        print_advice(work / "out" / "signs.jsonl", zero_utc, truth)
        print_outage(work, health, heard, zero_utc)
    for agent in agents.values():
        agent.close()


def _p99_ms(port: int) -> float:
    try:
        return float(ask(port)["latency_p99_ms"] or 0.0)
    except (OSError, KeyError):  # it has just ended
        return 0.0


def print_signs(rows: list[Row], truth: Truth) -> None:
    """Print what each sign showed beside the truth."""
    print(f"the queue truly stands from {truth.first_s:.1f} s to {truth.last_s:.1f} s")
    print(f"it truly passes the near sign at {truth.passes_s(STATIONS_M['near']):.1f} s")
    print("| flight, s | sign | shows | truly |\n|---|---|---|---|")
    for row in rows:
        end_m = truth.end_m(row.t_s)
        away = "no queue" if end_m is None else f"{end_m - STATIONS_M[row.sign]:.0f} m away"
        print(f"| {row.t_s:.1f} | {row.sign} | {in_table(as_text(row.phases))} | {away} |")
    distances = [(r, shown_m(r.phases)) for r in rows]
    first = next((r.t_s for r, shown in distances if shown is not None), None)
    late = "never" if first is None else f"{first - truth.first_s:+.1f} s after the truth"
    print(f"first distance: {late}")
    over = [
        shown - (end_m - STATIONS_M[r.sign])
        for r, shown in distances
        if shown is not None and (end_m := truth.end_m(r.t_s)) is not None
    ]
    print(f"a shown distance longer than the true one, at most: {max(over, default=0):.0f} m")
    blank = [r.t_s for r in rows if r.t_s > truth.last_s and not r.phases]
    if blank:
        print(f"blank {blank[-1] - truth.last_s:.1f} s after the queue had gone")


def print_advice(log: Path, zero_utc: float, truth: Truth) -> None:
    """Print how the advice for each sign went, from the run's own log."""
    print("| flight, s | sign | advice | truly | stands | move it to station, m |")
    print("|---|---|---|---|---|---|")
    for row in map(json.loads, log.read_text("utf-8").splitlines()):
        if row["event"] != "decision":
            continue
        t_s = _utc(row["utc"]) - zero_utc
        end_m = truth.end_m(t_s)
        away = "no queue" if end_m is None else f"{end_m - STATIONS_M[row['sign']]:.0f} m away"
        to_m = row.get("move_to_station_m")
        print(
            f"| {t_s:.1f} | {row['sign']} | {row['state']}: {in_table(row['text'])} | {away} | "
            f"{row.get('placement', '–')} | {'–' if to_m is None else f'{to_m:.0f}'} |"
        )


def in_table(text: str) -> str:
    """Return phases on one line for a table, whose own bars would part them."""
    return text.replace(" | ", ", ")


def shown_m(phases: Phases) -> float | None:
    """Return the distance that phases tell, in metres."""
    words = " ".join(line for lines in phases for line in lines)
    return next((metres for text, metres in FEET.items() if text in words), None)


def print_outage(
    work: Path, health: list[tuple[float, float]], heard: Heard, zero_utc: float
) -> None:
    """Print what detection and the receivers had of the outage."""
    with (work / "out" / "queue.csv").open(encoding="utf-8", newline="") as file:
        times = sorted({float(row["t_s"]) for row in csv.DictReader(file)})
    spans = {
        "before": (AWAY_S[0] - 15.0, AWAY_S[0]),
        "while they are dead": AWAY_S,
        "after": (AWAY_S[1], AWAY_S[1] + 15.0),
    }
    print("| | answers/s | p99 at worst, ms |\n|---|---|---|")
    for name, (from_s, to_s) in spans.items():
        rate = sum(from_s <= t < to_s for t in times) / (to_s - from_s)
        worst = max((p99 for t, p99 in health if from_s <= t < to_s), default=0.0)
        print(f"| {name} | {rate:.1f} | {worst:.0f} |")
    back_utc = zero_utc + AWAY_S[1]
    for name, got in (("MQTT events", heard.events), ("webhook", heard.posted())):
        numbers = [record["sequence"] for _, record in got]
        order = "in order" if numbers == sorted(numbers) else "NOT in order"
        old = sum(at > _utc(record["valid_until"]) for at, record in got)
        after = [at - back_utc for at, _ in got if at > back_utc]
        first = f"{after[0]:.1f} s" if after else "never"
        print(
            f"{name}: {len(got)} received, {order}, {old} after the time that they say they hold, "
            f"first {first} after the restart"
        )
    states = [
        (at, approach) for at, state in heard.states for approach in state.get("approaches", [])
    ]
    stale = sum(at > _utc(a["valid_until"]) for at, a in states if a.get("valid_until"))
    after = [at - back_utc for at, _ in states if at > back_utc]
    first = f"{after[0]:.1f} s" if after else "never"
    print(f"MQTT state: {len(states)} received, {stale} stale, first {first} after the restart")


def _utc(text: str) -> float:
    return datetime.fromisoformat(text).timestamp()


def kill(work: Path, flight: Path, truth: Truth) -> None:
    """Kill queuetail itself while a sign shows a distance."""
    agent = SignAgent(clock_factor=KILL_CLOCK)
    site = SIGN.format(name="far", station_m=STATIONS_M["far"], address=agent.address)
    try:
        with live(work, flight, f"[signs]\nrefresh_s = 1\n{site}") as (process, _):
            wait_until(lambda: shown_m(agent.phases()) is not None, truth.first_s + 30.0)
            shown = as_text(agent.phases())
            process.kill()
            process.wait()
            died_s = monotonic()
            wait_until(lambda: agent.phases() == (), 120.0 / KILL_CLOCK)
            late_s = KILL_CLOCK * (monotonic() - died_s)
        print(f"kill -9 while the sign shows {shown}: it blanks itself after {late_s:.0f} s of its")
        print(f"own clock, which runs {KILL_CLOCK:.0f} times as fast; the duration is 60 s")
    finally:
        agent.close()


def wait_until(done: Callable[[], bool], seconds: float) -> None:
    """Wait for something to come true; ends the benchmark when it does not."""
    end_s = monotonic() + seconds
    while not done():
        if monotonic() > end_s:
            raise SystemExit("it did not come true")
        sleep(0.02)


def main() -> None:
    """Make the flight where it is not there yet, and fly it twice."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=("fly", "kill"))
    parser.add_argument("--receive", nargs=2, metavar=("PORT", "FILE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.receive:
        receive(int(arguments.receive[0]), Path(arguments.receive[1]))
        return
    flight = ROOT / "out" / "road_to_sign" / "flight"
    if not (flight / "truth.csv").exists():
        subprocess.run([*CLI, "simulate", str(SCENARIO), "--out", str(flight)], check=True)
    truth = Truth(flight / "truth.csv")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before the start")
    for name, part in (("fly", fly), ("kill", kill)):
        if arguments.only in (None, name):
            with tempfile.TemporaryDirectory() as folder:
                part(Path(folder), flight, truth)


if __name__ == "__main__":
    main()
