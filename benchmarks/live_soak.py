"""Let `queuetail live` run for long: `live_soak.py --minutes 60 [--picture FILE.png]`.

The bundled flight comes in over UDP at 720p and 30 pictures a second, over and over, with KLV; the
run writes its files, records, and keeps its history.  Every 10 s its health goes to a table.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import matplotlib as mpl

from broadcast import Sender, free_port
from latency import FLAGGER, ROOT, live_flight

EVERY_S = 10.0
COLUMNS = (
    *("t_s", "memory_mb", "latency_p50_ms", "latency_p99_ms", "frame_rate_hz", "frames_captured"),
    *("frames_processed", "frames_dropped", "reconnects", "load"),
)


def ask(port: int) -> dict[str, Any]:
    """Return the run's health, well or not."""
    try:
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/health", timeout=10) as reply:
            return dict(json.load(reply))
    except urllib.error.HTTPError as error:
        return dict(json.load(error))


def soak(minutes: float, table: Path, work: Path, is_recording: bool) -> list[dict[str, float]]:
    """Run for so long and return the rows of the table."""
    place = f"udp://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    command = [sys.executable, "-m", "queuetail.cli", "live", place, "--port", "0"]
    command += ["--site", str(FLAGGER / "site.toml"), "--out", str(work / "out")]
    command += ["--store", str(work / "history.db")]
    if is_recording:
        command += ["--record", str(work / "recordings")]
    clip, rows = live_flight(), []
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        found = re.search(r":(\d+)/health", process.stdout.readline())
        assert found is not None
        telemetry = FLAGGER / "telemetry.csv"
        with (
            Sender(clip, f"{place}?pkt_size=1316", "mpegts", telemetry=telemetry),
            table.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            started_s = monotonic()
            while monotonic() - started_s < 60 * minutes:
                sleep(EVERY_S)
                record = ask(int(found[1]))
                row = {name: record[name] for name in COLUMNS[1:-1]}
                row = {"t_s": round(monotonic() - started_s, 1), **row, "load": os.getloadavg()[0]}
                writer.writerow(row)
                file.flush()
                rows.append(row)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0, process.returncode
    return rows


def draw(rows: list[dict[str, float]], picture: Path) -> None:
    """Draw memory and latency over time."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415 - after the backend is chosen

    minutes = [row["t_s"] / 60 for row in rows]
    figure, (upper, lower) = plt.subplots(2, 1, sharex=True, figsize=(8, 4.5), layout="tight")
    upper.plot(minutes, [row["memory_mb"] for row in rows], color="tab:blue")
    upper.set_ylabel("memory, MB")
    upper.set_ylim(0, 1.1 * max(row["memory_mb"] for row in rows))
    lower.plot(minutes, [row["latency_p50_ms"] for row in rows], label="median")
    lower.plot(minutes, [row["latency_p99_ms"] for row in rows], label="99 %")
    lower.set_ylabel("arrival to answer, ms")
    lower.set_xlabel("minutes")
    lower.set_ylim(bottom=0)
    lower.legend()
    figure.savefig(picture, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--table", type=Path, default=ROOT / "out" / "benchmark" / "live_soak.csv")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--no-record", action="store_true", help="on a small disk")
    arguments = parser.parse_args()
    arguments.table.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix="soak", dir=arguments.table.parent))
    try:
        rows = soak(arguments.minutes, arguments.table, work, not arguments.no_record)
        written_mb = sum(f.stat().st_size for f in work.rglob("*") if f.is_file()) / 1e6
    finally:
        shutil.rmtree(work)
    settled = rows[len(rows) // 5 :]
    print(
        f"{rows[-1]['t_s'] / 60:.1f} min: memory {settled[0]['memory_mb']:.0f} MB at "
        f"{settled[0]['t_s'] / 60:.1f} min, {rows[-1]['memory_mb']:.0f} MB at the end; latency "
        f"median {rows[-1]['latency_p50_ms']:.0f} ms, 99 % {rows[-1]['latency_p99_ms']:.0f} ms; "
        f"{rows[-1]['frames_captured']:.0f} captured, {rows[-1]['frames_dropped']:.0f} dropped, "
        f"{rows[-1]['reconnects']:.0f} reconnects; {written_mb:.0f} MB written"
    )
    if arguments.picture:
        draw(rows, arguments.picture)


if __name__ == "__main__":
    main()
