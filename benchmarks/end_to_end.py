"""The whole chain on one machine, against the recording: `end_to_end.py [--seconds 80]`.

The bundled flight goes out twice: its pictures to an RTSP server, and its telemetry by
`queuetail onboard --simulate` over a line of two pseudo-terminals, paced to 9600 baud.
`queuetail live` hears and sees both.  Its queue.csv is compared with that of `queuetail run` on the
same video and log, picture by picture: every picture carries when it was sent (MISB ST 0604), which
the recording keeps beside the run's own time.  How much of the difference is the method's own is
told by the recording alone, looked at from its second picture on.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic, sleep, time

import numpy as np

from broadcast import Sender
from latency import FLAGGER, ROOT, live_flight, way
from link import PacedLine
from live_soak import ask
from queuetail.config import read_site
from queuetail.evaluate.eoq import tolerant_errors
from queuetail.flight import open_flight
from queuetail.live.recording import RecordedFrame, find_recording, read_recording
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.types import Floats

BAUD = 9600
METRES_PER_DEGREE = 111_320.0
LEAD_S = 6.0  # the drone hovers before the first picture, as long as everything needs to start
SAME_M = 1.0
BESIDE_S = 0.035  # the next picture at 30 a second is as good as the same
NEAR_S = 1.0  # a change of mind so much earlier or later is no other answer
PATIENCE_S = 120.0
CLI = (sys.executable, "-m", "queuetail.cli")


@dataclass(frozen=True, slots=True)
class Row:
    """One row of queue.csv; `t_s` after the video's first picture."""

    t_s: float
    status: str
    station_m: float  # NaN without an end of queue


@dataclass(frozen=True, slots=True)
class Far:
    """An interval in which both name an end of queue, but not the same one."""

    from_s: float
    to_s: float
    live_m: float
    offline_m: float
    off_by_s: float | None  # to the nearest offline answer that is the same, None beyond 1 s


@dataclass(frozen=True, slots=True)
class Result:
    """How near the live answers are to the offline ones."""

    pictures: int  # that both have answered
    same_status: float  # share
    both_queued: int
    median_m: float
    p95_m: float
    max_m: float
    within_1_m: float  # share
    within_1_m_and_1_s: float  # share, where an offline answer within a second counts
    far: tuple[Far, ...]
    error_m: float  # median against the truth within −1.5 … +0.5 s, as `queuetail evaluate` has it
    error_p95_m: float


@dataclass(frozen=True, slots=True)
class Flown:
    """What came of the live run."""

    rows: list[Row]
    dropped: int
    place_off_m: float  # root mean square of live telemetry less the log, over all pictures
    heading_off_deg: float


def run_live(work: Path, clip: Path, seconds: float, lead_s: float = LEAD_S) -> Flown:
    """Send and watch the flight; telemetry begins so much earlier than the pictures."""
    line = PacedLine(BAUD, 0.0)
    site = FLAGGER / "site.toml"
    try:
        with way("rtsp") as (watched, sent_to, container_format):
            watch = [*CLI, "live", watched, "--telemetry", f"radio:{line.ground}:{BAUD}"]
            watch += ["--site", str(site), "--out", str(work / "live"), "--port", "0"]
            watch += ["--record", str(work / "recordings"), "--no-store"]
            with process(watch, work / "live.log") as live:
                port = said(work / "live.log", r":(\d+)")
                fly = [*CLI, "onboard", "--simulate", str(with_lead(work, lead_s))]
                fly += ["--radio", line.drone, "--baud", str(BAUD)]
                with process(fly, work / "onboard.log"):
                    begin_s = first_byte_s(line) + lead_s
                    with Sender(
                        clip, sent_to, container_format, stamp=True, begin_at_s=begin_s
                    ) as camera:
                        sleep(max(begin_s + seconds + 0.5 - monotonic(), 0.0))
                        dropped = ask(int(port))["frames_dropped"]
                        sent = camera.kill()
                live.send_signal(signal.SIGTERM)
                if live.wait(PATIENCE_S):
                    raise SystemExit((work / "live.log").read_text())
    finally:
        line.close()
    frames = read_recording(find_recording(work / "recordings")).frames
    times_s = media_times_s(frames, sent)
    rows = [r for r in read_rows(work / "live" / "queue.csv", times_s) if r.t_s < seconds]
    return Flown(rows, dropped, *telemetry_off(frames, times_s, clip))


def run_offline(work: Path, clip: Path) -> list[Row]:
    """Return what `queuetail run` says of the same video and log."""
    command = [*CLI, "run", str(clip), "--telemetry", str(FLAGGER / "telemetry.csv")]
    command += ["--site", str(FLAGGER / "site.toml"), "--out", str(work / "run"), "--no-video"]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return read_rows(work / "run" / "queue.csv")


@contextmanager
def process(command: list[str], log: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Keep a program running, its words in `log`."""
    with log.open("wb") as told:
        started = subprocess.Popen(command, stdout=told, stderr=told)
        try:
            yield started
        finally:
            started.kill()
            started.wait()


def said(log: Path, pattern: str) -> str:
    """Wait until a program has said something, and return the pattern's group."""
    end_s = monotonic() + PATIENCE_S
    while (found := re.search(pattern, log.read_text())) is None:
        if monotonic() > end_s:
            raise SystemExit(f"{log.name}: {log.read_text()}")
        sleep(0.05)
    return found[1]


def with_lead(work: Path, lead_s: float) -> Path:
    """Write the flight's telemetry with a hover before it, as `queuetail onboard` plays it."""
    folder = work / "flight"
    folder.mkdir()
    with (FLAGGER / "telemetry.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    lead = [{**rows[0], "t_s": f"{tick / 10:.3f}"} for tick in range(round(10 * lead_s))]
    late = [{**row, "t_s": f"{float(row['t_s']) + lead_s:.3f}"} for row in rows]
    with (folder / "telemetry.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows([*lead, *late])
    return folder


def first_byte_s(line: PacedLine) -> float:
    """Return when the drone's first byte went over the line, on the monotonic clock."""
    end_s = monotonic() + PATIENCE_S
    while not line.sent:
        if monotonic() > end_s:
            raise SystemExit("queuetail onboard sends nothing")
        sleep(0.002)
    return monotonic()


def begun_later(clip: Path) -> list[Row]:
    """Return the answers of the method itself where it begins one picture later."""
    rows = []
    site = read_site(FLAGGER / "site.toml")
    with open_flight(clip, FLAGGER / "telemetry.csv", site) as flight:
        size_px = flight.video.width_px, flight.video.height_px
        pipeline = PRESETS["road"](site, flight.origin, *size_px, lambda stage: None)
        frames = flight.frames()
        next(frames)
        pace = Pace(pipeline.longest_s)
        for frame in frames:
            if not pace.takes(frame.t_s):
                continue
            state = pipeline.step(frame, flight.telemetry_at(frame.t_s)).states[0]
            station_m = math.nan if state.eoq is None else state.eoq.station_m
            rows.append(Row(frame.t_s, state.status, station_m))
    return rows


def telemetry_off(
    frames: list[RecordedFrame], times_s: dict[float, float], clip: Path
) -> tuple[float, float]:
    """Return how far what the run was told is from the log (RMS): metres, degrees."""
    off = []
    site = read_site(FLAGGER / "site.toml")
    with open_flight(clip, FLAGGER / "telemetry.csv", site) as flight:
        for frame in frames:
            told, true = frame.telemetry, flight.telemetry_at(times_s[round(frame.t_s, 3)])
            if None in (told.lat_deg, told.lon_deg, told.heading_deg) or true.lat_deg is None:
                continue
            north_m = METRES_PER_DEGREE * (told.lat_deg - true.lat_deg)
            per_degree_m = METRES_PER_DEGREE * math.cos(math.radians(true.lat_deg))
            east_m = per_degree_m * (told.lon_deg - true.lon_deg)
            off.append((math.hypot(north_m, east_m), told.heading_deg - true.heading_deg))
    place_m, heading_deg = np.sqrt(np.mean(np.square(off), axis=0))
    return float(place_m), float(heading_deg)


def media_times_s(frames: list[RecordedFrame], sent: dict[float, float]) -> dict[float, float]:
    """Return the video's time of each picture by the run's time.

    Between pictures the stream's own times count; where they begin is told by when pictures were
    sent, which each of them carries.
    """
    to_monotonic_s = monotonic() - time()
    media_s, sent_s = np.array(sorted(sent.items())).T
    moments_s = np.array([frame.utc.timestamp() for frame in frames]) + to_monotonic_s
    nearest = np.abs(sent_s - moments_s[:, None]).argmin(axis=1)
    offset_s = float(np.median(media_s[nearest] - np.array([frame.pts_s for frame in frames])))
    return {round(frame.t_s, 3): frame.pts_s + offset_s for frame in frames}


def read_rows(path: Path, times_s: dict[float, float] | None = None) -> list[Row]:
    """Read the rows of a queue.csv that belong to pictures, with the video's times."""
    with path.open(newline="") as file:
        rows = [
            Row(float(r["t_s"]), r["status"], float(r["eoq_station_m"] or "nan"))
            for r in csv.DictReader(file)
        ]
    if times_s is None:
        return rows
    return [replace(row, t_s=times_s[row.t_s]) for row in rows if row.t_s in times_s]


def compare(live: list[Row], offline: list[Row]) -> Result:
    """Compare the answers to the same pictures."""
    pairs = [(row, beside) for row in live if (beside := nearest_row(offline, row.t_s)) is not None]
    named = [(a, b) for a, b in pairs if np.isfinite(a.station_m) and np.isfinite(b.station_m)]
    apart_m = np.array([abs(a.station_m - b.station_m) for a, b in named])
    off_by = [off_by_s(a, offline) for a, _ in named]
    far = [
        Far(a.t_s, a.t_s, a.station_m, b.station_m, late_s)
        for (a, b), m, late_s in zip(named, apart_m, off_by, strict=True)
        if m > SAME_M
    ]
    errors_m = truth_errors_m(live)
    return Result(
        pictures=len(pairs),
        same_status=float(np.mean([a.status == b.status for a, b in pairs])),
        both_queued=len(named),
        median_m=float(np.median(apart_m)),
        p95_m=float(np.percentile(apart_m, 95)),
        max_m=float(apart_m.max()),
        within_1_m=float(np.mean(apart_m <= SAME_M)),
        within_1_m_and_1_s=float(np.mean([late_s is not None for late_s in off_by])),
        far=tuple(joined(far)),
        error_m=float(np.nanmedian(errors_m)),
        error_p95_m=float(np.nanpercentile(errors_m, 95)),
    )


def nearest_row(rows: list[Row], t_s: float) -> Row | None:
    """Return the row of the same picture."""
    best = min(rows, key=lambda row: abs(row.t_s - t_s))
    return best if abs(best.t_s - t_s) <= BESIDE_S else None


def off_by_s(row: Row, offline: list[Row]) -> float | None:
    """Return how far in time the nearest offline answer is that names the same place."""
    near = (
        abs(other.t_s - row.t_s)
        for other in offline
        if abs(other.t_s - row.t_s) <= NEAR_S and abs(other.station_m - row.station_m) <= SAME_M
    )
    return min(near, default=None)


def joined(far: list[Far]) -> Iterator[Far]:
    """Join neighbours into intervals, with the places at their worst."""
    begun: Far | None = None
    for one in far:
        if begun is not None and one.from_s - begun.to_s < 0.2:
            worst = max((begun, one), key=lambda f: abs(f.live_m - f.offline_m))
            lates = begun.off_by_s, one.off_by_s
            late_s = None if None in lates else max(s for s in lates if s is not None)
            begun = Far(begun.from_s, one.to_s, worst.live_m, worst.offline_m, late_s)
            continue
        if begun is not None:
            yield begun
        begun = one
    if begun is not None:
        yield begun


def truth_errors_m(rows: list[Row]) -> Floats:
    """Return the distances from the truth, NaN where either has no end of queue."""
    with (FLAGGER / "truth.csv").open(newline="") as file:
        read = list(csv.DictReader(file))
    truth = np.array([(float(r["t_s"]), float(r["eoq_station_m"] or "nan")) for r in read])
    mine = np.array([(row.t_s, row.station_m) for row in rows])
    return np.abs(tolerant_errors(*mine.T, *truth.T))


def main() -> None:
    """Print the figures and where the answers differ."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=80.0)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    clip = live_flight()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f} before the start")
    work = Path(tempfile.mkdtemp(prefix="end_to_end", dir=ROOT / "out"))
    try:
        flown = run_live(work, clip, arguments.seconds)
        offline = run_offline(work, clip)
    finally:
        shutil.rmtree(work)
    print(
        f"{flown.dropped} pictures dropped; telemetry as used is off by {flown.place_off_m:.3f} m "
        f"and {flown.heading_off_deg:.3f}° (root mean square)"
    )
    print(
        "| against the offline run | same status | both name one | median, m | 95 %, m | most, m "
        "| within 1 m | of an answer within 1 s | error: median, m | 95 %, m |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    results = {
        "live": compare(flown.rows, offline),
        "offline, begun one picture later": compare(begun_later(clip), offline),
        "offline": compare(offline, offline),
    }
    for name, r in results.items():
        print(
            f"| {name} | {r.same_status:.1%} | {r.both_queued} of {r.pictures} | {r.median_m:.2f} "
            f"| {r.p95_m:.1f} | {r.max_m:.1f} | {r.within_1_m:.1%} | {r.within_1_m_and_1_s:.1%} "
            f"| {r.error_m:.2f} | {r.error_p95_m:.1f} |"
        )
    for name, r in results.items():
        spans = ", ".join(f"{f.from_s:.1f}-{f.to_s:.1f}" for f in r.far)
        print(f"farther than 1 m, {name}, s: {spans or 'never'}")
    if arguments.json:
        records = {name: asdict(result) for name, result in results.items()}
        arguments.json.write_text(json.dumps(records, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
