"""How much detection slows down while browsers watch: one live run, with viewers and without.

``python benchmarks/console_load.py [--viewers 2] [--seconds 20] [--turns 3] [--light]`` plays the
bundled flight over and over into `queuetail live`, and lets real browsers come and go, in turns, so
that what else the machine does falls on both.  It needs Debian's chromium; with ``--light`` the
viewers are programs that take the pictures and draw nothing, as if the browsers ran elsewhere.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import urllib.request
from contextlib import ExitStack
from pathlib import Path
from statistics import mean
from threading import Thread
from time import monotonic, sleep
from typing import Any

from playwright.sync_api import sync_playwright
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

FLIGHT = Path(__file__).resolve().parent.parent / "examples" / "flagger"
CHROMIUM = "/usr/bin/chromium"
SETTLE_S = 5.0
CPU_CLOCK_HZ = os.sysconf("SC_CLK_TCK")


def main() -> int:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--viewers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each turn")
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--light", action="store_true", help="viewers that draw nothing")
    arguments = parser.parse_args()
    command = [sys.executable, "-m", "queuetail.cli", "live", str(FLIGHT / "flight.mp4")]
    command += ["--realtime", "--loop", "--telemetry", str(FLIGHT / "telemetry.csv")]
    command += ["--site", str(FLIGHT / "site.toml"), "--no-store", "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        found = re.search(r"http://\S+?:\d+/", process.stdout.readline())
        assert found is not None
        sleep(SETTLE_S)
        alone, watched = turns(found[0], process.pid, arguments)
    finally:
        process.terminate()
        process.wait(30)
    heads = ("viewers", 8), ("answers/s", 10), ("median ms", 10), ("cores", 6), ("pictures/s", 11)
    print(" ".join(f"{head:>{width}}" for head, width in heads))
    for name, rows in ((0, alone), (arguments.viewers, watched)):
        rate, latency, cpu, pictures = (mean(column) for column in zip(*rows, strict=True))
        print(f"{name:>8} {rate:>10.2f} {latency:>10.1f} {cpu:>6.2f} {pictures:>11.1f}")
    rates = mean(r[0] for r in alone), mean(r[0] for r in watched)
    print(f"detection falls by {100 * (1 - rates[1] / rates[0]):.1f} %")
    return 0


class Page:
    """A browser's page that watches."""

    def __init__(self, browser: Any, address: str) -> None:
        self._page = browser.new_page()
        self._page.goto(address)
        self._page.wait_for_function("window.qtDrawn > 5", timeout=60_000)

    def pictures(self) -> int:
        """Return how many pictures it has drawn."""
        return int(self._page.evaluate("window.qtDrawn"))


class Taker:
    """A program that takes pictures as a page does."""

    def __init__(self, closing: ExitStack, address: str) -> None:
        socket = closing.enter_context(connect(f"ws{address[4:]}console/pictures", max_size=None))
        self._count = 0
        self._thread = Thread(target=self._take, args=(socket,), daemon=True)
        self._thread.start()

    def pictures(self) -> int:
        """Return how many pictures it has got."""
        return self._count

    def _take(self, socket: Any) -> None:
        try:
            while True:
                socket.send("next")
                self._count += bool(socket.recv())
        except ConnectionClosed:
            return


def turns(address: str, pid: int, arguments: argparse.Namespace) -> tuple[list[Any], list[Any]]:
    """Measure with and without viewers in turns."""
    alone, watched = [], []
    for _ in range(arguments.turns):
        alone.append(measure(address, pid, arguments.seconds, []))
        with ExitStack() as closing:
            if arguments.light:
                viewers: list[Any] = [Taker(closing, address) for _ in range(arguments.viewers)]
            else:
                playwright = closing.enter_context(sync_playwright())
                flags = ["--no-sandbox", "--disable-gpu"]
                browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
                closing.callback(browser.close)
                viewers = [Page(browser, address) for _ in range(arguments.viewers)]
            sleep(SETTLE_S)
            watched.append(measure(address, pid, arguments.seconds, viewers))
        sleep(SETTLE_S)
    return alone, watched


def measure(address: str, pid: int, seconds: float, viewers: list[Any]) -> tuple[float, ...]:
    """Return answers per second, latency, cores used, and pictures per second and viewer."""
    drawn = [viewer.pictures() for viewer in viewers]
    before, cpu_s, began_s = health(address), cpu_seconds(pid), monotonic()
    sleep(seconds)
    after, span_s = health(address), monotonic() - began_s
    shown = [viewer.pictures() - n for viewer, n in zip(viewers, drawn, strict=True)]
    return (
        (after["frames_processed"] - before["frames_processed"]) / span_s,
        after["latency_p50_ms"],
        (cpu_seconds(pid) - cpu_s) / span_s,
        mean(shown) / span_s if shown else 0.0,
    )


def health(address: str) -> dict[str, Any]:
    """Return what the run says of itself."""
    with urllib.request.urlopen(f"{address}api/v1/health", timeout=10) as reply:
        return dict(json.load(reply))


def cpu_seconds(pid: int) -> float:
    """Return the processor time that a process has used (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text("ascii").rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / CPU_CLOCK_HZ


if __name__ == "__main__":
    raise SystemExit(main())
