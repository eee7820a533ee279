"""Measure live delays: from a camera to the published answer, and until answers are back after a
kill: `latency.py [--seconds 40]`.

The bundled flight goes out at 720p and 30 pictures a second over UDP and RTSP, with and without
other work on every core.  Every picture carries when it was sent (MISB ST 0604), so that the figure
has all in it: transport, demuxing, decoding, waiting, processing, publishing.
"""

from __future__ import annotations

import argparse
import json
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic, sleep

import numpy as np

from broadcast import Sender, free_port, write_live_flight
from queuetail.config import read_site
from queuetail.flight import open_flight
from queuetail.live.feed import LiveFeed, RecordedFeed, TelemetryFeed
from queuetail.live.records import OutletHealth, OutletState, Published
from queuetail.live.runtime import LiveRun
from queuetail.types import QueueStatus
from queuetail.video.stream_source import parse_source

ROOT = Path(__file__).resolve().parent.parent
FLAGGER = ROOT / "examples" / "flagger"
CLIP = ROOT / "out" / "benchmark" / "live" / "flagger_live.ts"
SETTLE_S = 5.0
GAPS_S = (1.5, 5.0)
BUSY = "while True: sum(range(10000))"


@dataclass(frozen=True, slots=True)
class Result:
    """One way and one load."""

    transport: str
    busy_processes: int
    answers: int
    p50_ms: float
    p99_ms: float
    from_arrival_p50_ms: float | None
    from_arrival_p99_ms: float | None
    captured: int
    processed: int
    dropped: int


class Delays:
    """A sink that notes when each answer comes, and how long after its picture was sent."""

    def __init__(self) -> None:
        self.delays_ms: list[float] = []
        self.is_counting = False
        self.answers: list[tuple[float, Published]] = []

    def offer(self, published: Published) -> None:
        """Note one answer."""
        self.answers.append((monotonic(), replace(published, frame=None)))
        if self.is_counting and published.frame is not None:
            delay = datetime.now(UTC) - published.utc
            self.delays_ms.append(1000 * delay.total_seconds())

    def health(self) -> OutletHealth:
        """Return nothing of interest."""
        return OutletHealth("delays", OutletState.OK)

    def close(self) -> None:
        """Do nothing."""


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep cores busy with as many processes."""
    started = [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


@contextmanager
def way(transport: str) -> Iterator[tuple[str, str, str]]:
    """Yield where to watch, where to send, and in which format."""
    if transport == "udp":
        place = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
        yield place, f"{place}?pkt_size=1316", "mpegts"
        return
    from tstrans.rtp import RtspServer, RtspServerConfig  # noqa: PLC0415 - only for RTSP

    config = RtspServerConfig(bind_addr="127.0.0.1:0", accept_unregistered_publishers=True)
    server = RtspServer.start(config)
    server.add_publish_mount("/live")
    url = f"rtsp://{server.local_addr()}/live"
    yield url, url, "rtsp"
    server.stop(drain_ms=0)


def live_flight() -> Path:
    """Return the bundled flight as a camera sends it, encoded at the first call."""
    return CLIP if CLIP.is_file() else write_live_flight(FLAGGER / "flight.mp4", CLIP)


def feed_for(transport: str) -> TelemetryFeed:
    """Return KLV beside the pictures over UDP; over RTSP, the flight's log."""
    site = read_site(FLAGGER / "site.toml")
    if transport == "udp":
        return LiveFeed(None, site)
    with open_flight(FLAGGER / "flight.mp4", FLAGGER / "telemetry.csv", site) as flight:
        duration_s = flight.video.duration_s or 80.0
        return RecordedFeed(lambda t_s: flight.telemetry_at(t_s % duration_s), "telemetry.csv")


def measure(transport: str, busy_processes: int, seconds: float) -> Result:
    """Watch the flight for so long."""
    clip, sink = live_flight(), Delays()
    with way(transport) as (watched, sent_to, container_format), busy(busy_processes):
        run = LiveRun(parse_source(watched), feed_for(transport), read_site(FLAGGER / "site.toml"))
        run.subscribe(sink)
        run.start()
        telemetry = FLAGGER / "telemetry.csv" if transport == "udp" else None
        with Sender(clip, sent_to, container_format, telemetry=telemetry, stamp=True):
            sleep(SETTLE_S)
            sink.is_counting = True
            sleep(seconds)
            sink.is_counting = False
            health = run.health()
        run.stop()
    p50_ms, p99_ms = np.percentile(sink.delays_ms, [50, 99]).tolist()
    return Result(
        transport,
        busy_processes,
        len(sink.delays_ms),
        round(p50_ms, 1),
        round(p99_ms, 1),
        health.latency_p50_ms and round(health.latency_p50_ms, 1),
        health.latency_p99_ms and round(health.latency_p99_ms, 1),
        health.frames_captured,
        health.frames_processed,
        health.frames_dropped,
    )


def recovery(transport: str, gap_s: float) -> tuple[float, float]:
    """Kill the camera, start it anew after the gap; return the delays until it is known again.

    The first is to the first answer to a picture, the second to the first that is not unknown, both
    from when the camera sent its first picture.
    """
    clip, sink = live_flight(), Delays()
    telemetry = FLAGGER / "telemetry.csv" if transport == "udp" else None
    with way(transport) as (watched, sent_to, container_format):
        run = LiveRun(parse_source(watched), feed_for(transport), read_site(FLAGGER / "site.toml"))
        run.subscribe(sink)
        run.start()
        with Sender(clip, sent_to, container_format, telemetry=telemetry):
            sleep(SETTLE_S)
        sleep(gap_s)
        before = len(sink.answers)
        with Sender(clip, sent_to, container_format, telemetry=telemetry) as sender:
            sleep(SETTLE_S)
            sent_s = min(sender.kill().values())
        run.stop()
    after = [(at_s - sent_s, p) for at_s, p in sink.answers[before:] if p.pts_s is not None]
    known = (d for d, p in after if p.observation.states[0].status is not QueueStatus.UNKNOWN)
    return after[0][0], next(known)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    cores = os.cpu_count() or 1
    print(f"{cores} cores, load {os.getloadavg()[0]:.1f} before the start")
    print(
        "| way | busy processes | answers | sent to answer, ms: p50 | p99 "
        "| arrival to answer, ms: p50 | p99 | dropped |"
    )
    print("|---|---|---|---|---|---|---|---|")
    results = []
    for transport in ("udp", "rtsp"):
        for busy_processes in (0, 2 * cores):
            r = measure(transport, busy_processes, arguments.seconds)
            results.append(asdict(r))
            print(
                f"| {r.transport} | {r.busy_processes} | {r.answers} | {r.p50_ms} | {r.p99_ms} "
                f"| {r.from_arrival_p50_ms} | {r.from_arrival_p99_ms} | {r.dropped} |",
                flush=True,
            )
    print("| way | gone for, s | first answer after, s | first known state after, s |")
    print("|---|---|---|---|")
    for transport in ("udp", "rtsp"):
        for gap_s in GAPS_S:
            first_s, known_s = recovery(transport, gap_s)
            print(f"| {transport} | {gap_s} | {first_s:.2f} | {known_s:.2f} |", flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
