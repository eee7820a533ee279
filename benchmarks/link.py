"""Measure the telemetry link: `link.py [--seconds 60] [--messages 1000000] [--no-radio]`.

First in memory: a million messages of random values at each bit error rate, and whether any wrong
value was accepted.  Then `queuetail onboard --simulate` over a line of two pseudo-terminals that is
paced to the real byte rate and flips bits, and what arrives at the ground's receiver.
"""

from __future__ import annotations

import argparse
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from link_noise import ReadingStream, flip_bits
from queuetail.link.frames import Decoder
from queuetail.link.messages import IDS, Quantity, header_of
from queuetail.link.scheduler import BITS_PER_BYTE
from queuetail.onboard.source import Stamp
from queuetail.telemetry.live_radio import RadioSource

BIT_ERROR_RATES = (0.0, 1e-4, 1e-3)
BATCH = 50
FLAGGER = Path(__file__).resolve().parent.parent / "examples" / "flagger"
PACE_S = 0.005
AGE_PERCENTILES = (50, 95, 99)


@dataclass(frozen=True, slots=True)
class NoiseResult:
    """One bit error rate in memory."""

    sent: int
    sent_bytes: int
    accepted: int
    wrong: int
    bad_frames: int
    wall_s: float


def noise_run(messages: int, bit_error_rate: float, seed: int = 1) -> NoiseResult:
    """Send random messages through noise and count wrong values that were accepted."""
    stream, noise = ReadingStream(random.Random(seed)), random.Random(seed + 1)
    decoder = Decoder()
    wrong = sent_bytes = 0
    started_s = time.perf_counter()
    for _ in range(messages // BATCH):
        sent = b"".join(stream.next_frame() for _ in range(BATCH))
        sent_bytes += len(sent)
        heard = decoder.feed(flip_bits(sent, bit_error_rate, noise))
        wrong += sum(not stream.was_sent(message) for message in heard)
    counts = decoder.counts
    return NoiseResult(
        messages // BATCH * BATCH,
        sent_bytes,
        counts.messages,
        wrong,
        counts.bad_frames,
        time.perf_counter() - started_s,
    )


class PacedLine:
    """Two pseudo-terminals joined by a relay at a baud rate; it flips bits and keeps a record."""

    def __init__(self, baud: int, bit_error_rate: float, seed: int = 1) -> None:
        self._bytes_per_s = baud / BITS_PER_BYTE
        self._rate = bit_error_rate
        self._noise = random.Random(seed)
        self._ends = []
        for _ in range(2):
            master, slave = os.openpty()
            tty.setraw(slave)
            self._ends.append((master, slave))
        self.drone, self.ground = (os.ttyname(slave) for _, slave in self._ends)
        self.sent = bytearray()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._relay, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop the relay and close both ends."""
        self._stopping.set()
        self._thread.join()
        for master, slave in self._ends:
            os.close(master)
            os.close(slave)

    def _relay(self) -> None:
        """Pass on no more bytes than the line carries, each when its last bit would be out."""
        source, sink = self._ends[0][0], self._ends[1][0]
        free_s = time.monotonic()
        while not self._stopping.is_set():
            now_s = time.monotonic()
            free_s = max(free_s, now_s - PACE_S)
            room = int((now_s - free_s) * self._bytes_per_s)
            if room < 1 or not select.select([source], [], [], PACE_S)[0]:
                time.sleep(PACE_S / 5)
                continue
            data = os.read(source, room)
            free_s += len(data) / self._bytes_per_s
            self.sent += data
            os.write(sink, flip_bits(data, self._rate, self._noise))


@dataclass(frozen=True, slots=True)
class LineResult:
    """One bit error rate over the line."""

    seconds: float
    sent: int
    sent_bytes: int
    received: int
    wrong: int
    lost: int
    sent_rates_hz: dict[str, float]
    received_rates_hz: dict[str, float]
    delays_ms: tuple[float, ...]  # of arrival after measurement, at AGE_PERCENTILES
    peak_mb: float  # of the sender's process


def line_run(seconds: float, bit_error_rate: float, baud: int = 9600) -> LineResult:
    """Play a simulated flight over the paced line and compare what arrives with what was sent."""
    line = PacedLine(baud, bit_error_rate)
    heard: list[tuple[Quantity, Stamp]] = []
    receiver = RadioSource(f"{line.ground}:{baud}")
    receiver.start(lambda quantity, stamp: heard.append((quantity, stamp)))
    command = [sys.executable, "-m", "queuetail.cli", "onboard", "--simulate", str(FLAGGER)]
    command += ["--radio", line.drone, "--baud", str(baud)]
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen(command, stdout=told, stderr=told)
        try:
            _wait(lambda: bool(line.sent))
            started_s = time.monotonic()
            time.sleep(seconds)
            peak_kb = Path(f"/proc/{process.pid}/status").read_text().split("VmHWM:")[1].split()[0]
            taken_s = time.monotonic() - started_s
            process.send_signal(signal.SIGTERM)
            process.wait(20)
        finally:
            process.kill()
    time.sleep(0.3)  # for what is still on the line
    receiver.stop()
    line.close()
    sent = Decoder().feed(bytes(line.sent))
    true = Counter((header_of(m.quantity), repr(m.quantity)) for m in sent)
    got = Counter((header_of(q), repr(q)) for q, _ in heard)
    delays = sorted(1e3 * (s.arrived_s - s.measured_s) for _, s in heard)
    return LineResult(
        taken_s,
        len(sent),
        len(line.sent),
        len(heard),
        sum((got - true).values()),
        receiver.losses["lost"],
        _rates([m.quantity for m in sent], taken_s),
        _rates([q for q, _ in heard], taken_s),
        tuple(delays[min(len(delays) * p // 100, len(delays) - 1)] for p in AGE_PERCENTILES),
        int(peak_kb) / 1024,
    )


def _rates(quantities: list[Quantity], seconds: float) -> dict[str, float]:
    counts = Counter(map(header_of, quantities))
    return {header: counts[header] / seconds for header in IDS if counts[header]}


def _wait(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 20
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.01)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="of each run over the line")
    parser.add_argument("--messages", type=int, default=1_000_000, help="of each run in memory")
    parser.add_argument("--baud", type=int, default=9600)
    parser.add_argument("--no-radio", action="store_true", help="only the runs in memory")
    arguments = parser.parse_args()
    print("| bit error rate | messages | bytes | accepted | refused frames | wrong | wall s |")
    print("|---|---|---|---|---|---|---|")
    for rate in BIT_ERROR_RATES:
        n = noise_run(arguments.messages, rate)
        print(f"| {rate:g} | {n.sent} | {n.sent_bytes} | {n.accepted} ({n.accepted / n.sent:.2%}) "
              f"| {n.bad_frames} | {n.wrong} | {n.wall_s:.0f} |", flush=True)  # fmt: skip
    if arguments.no_radio:
        return
    print(f"\n{arguments.baud} baud, {arguments.seconds:g} s each\n")
    print("| bit error rate | sent | bytes/s | received | wrong | counted as lost "
          "| delay ms p50/p95/p99 | sender's memory |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|")
    results = []
    for rate in BIT_ERROR_RATES:
        r = line_run(arguments.seconds, rate, arguments.baud)
        results.append((rate, r))
        delays = "/".join(f"{delay:.0f}" for delay in r.delays_ms)
        print(f"| {rate:g} | {r.sent} | {r.sent_bytes / r.seconds:.0f} "
              f"| {r.received} ({r.received / r.sent:.1%}) "
              f"| {r.wrong} | {r.lost} | {delays} | {r.peak_mb:.0f} MB |", flush=True)  # fmt: skip
    print("\nreceived per second")
    for rate, r in results:
        rates = ", ".join(f"{h} {hz:.1f}" for h, hz in r.received_rates_hz.items())
        print(f"{rate:g}: {rates}")


if __name__ == "__main__":
    main()
