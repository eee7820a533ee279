"""A real `queuetail live` or `open` in a process of its own, and a camera for it."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from time import monotonic, sleep
from types import TracebackType
from typing import Any

import av
from av.video.stream import VideoStream
from playwright.sync_api import Error

PATIENCE_S = 20.0
FROM_S, UNTIL_S = 23.0, 37.0  # a queue forms three seconds later
SIZE = (640, 360)


class Served:
    """A queuetail process that serves a console; `address` is the one for operators."""

    def __init__(self, *words: str) -> None:
        """Start it, and wait until it has said where it is."""
        command = [sys.executable, "-m", "queuetail.cli", *words, "--port", "0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.said = self.process.stdout.readline()
        self.tokens: dict[str, str] = {}
        while self.said.rstrip().endswith("token:") and len(self.tokens) < 2:
            line = self.process.stdout.readline()
            role, token = re.findall(r"(\w+)s: \S+token=(\S+)", line)[0]
            self.tokens[role] = token
        found = re.search(r"http://[^/]+:(\d+)/", self.said)
        assert found is not None, self.said
        self.port = int(found[1])
        self.address = f"http://127.0.0.1:{self.port}/"

    def __enter__(self) -> Served:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.process.terminate()
        try:
            self.process.communicate(timeout=20)
        finally:
            self.process.kill()


def visit(page: Any, address: str) -> Any:
    """Open a page and return the reply; a closed network may refuse a new browser for a moment."""
    end_s = monotonic() + PATIENCE_S
    while True:
        try:
            return page.goto(address)
        except Error as error:
            if "ERR_CONNECTION_REFUSED" not in error.message or monotonic() > end_s:
                raise
            sleep(0.2)


def write_scene(flagger: Path, folder: Path) -> tuple[Path, Path]:
    """Encode a small clip of the bundled flight's queue as a camera sends it, and its log."""
    clip, log = folder / "scene.ts", folder / "scene.csv"
    with av.open(str(flagger / "flight.mp4")) as flight, av.open(str(clip), "w") as out:
        video = flight.streams.video[0]
        stream = out.add_stream("libx264", rate=15)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        stream.options = {"preset": "ultrafast", "tune": "zerolatency", "g": "15", "crf": "20"}
        flight.seek(int(FROM_S * av.time_base))
        for index, frame in enumerate(flight.decode(video)):
            assert frame.time is not None
            if frame.time >= UNTIL_S:
                break
            if frame.time < FROM_S or index % 2:
                continue
            small = frame.reformat(*SIZE)
            small.pict_type = 0  # the encoder decides
            small.pts = round((frame.time - FROM_S) * 90_000)
            small.time_base = Fraction(1, 90_000)
            out.mux(stream.encode(small))
        out.mux(stream.encode(None))
    with (flagger / "telemetry.csv").open(encoding="utf-8", newline="") as whole:
        rows = list(csv.DictReader(whole))
    with log.open("w", encoding="utf-8", newline="") as part:
        writer = csv.DictWriter(part, rows[0])
        writer.writeheader()
        for row in rows:
            t_s = float(row["t_s"]) - FROM_S
            if 0 <= t_s <= UNTIL_S - FROM_S:
                writer.writerow(row | {"t_s": f"{t_s:.3f}"})
    return clip, log
