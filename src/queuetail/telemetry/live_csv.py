"""queuetail's own telemetry table as a live source: played in real time, then followed."""

from __future__ import annotations

import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

from queuetail.errors import InputError
from queuetail.link.messages import (
    ClockSource,
    ClockTime,
    Gimbal,
    Height,
    HeightSource,
    Lens,
    Position,
    Quantity,
)
from queuetail.onboard.source import POLL_S, Source
from queuetail.telemetry.own_csv import COLUMNS, is_own_csv, read_own_csv
from queuetail.types import TelemetrySample

BLOCK_BYTES = 65_536


class CsvSource(Source):
    """Plays FILE's lines at their own times; at its end it waits for more to be written.

    The first line is played at once.  A line that is written late is played late, as it came.
    """

    def __init__(self, spec: str) -> None:
        self._path = Path(spec)
        super().__init__(f"table {self._path}")
        try:
            head = self._path.read_text("utf-8-sig", errors="replace")[:BLOCK_BYTES]
        except OSError as error:
            raise InputError(f"{spec}: the table cannot be read ({error.strerror})") from None
        if not is_own_csv(head):
            raise InputError(
                f"{spec}: this is not queuetail's telemetry table; its header must have t_s or utc "
                f"and some of {', '.join(COLUMNS)}"
            )

    def _session(self) -> bool:
        started_s: float | None = None
        for sample, utc in self._samples():
            if started_s is None:
                started_s = time.monotonic() - sample.t_s
            due_s = started_s + sample.t_s
            if self._stopping.wait(max(due_s - time.monotonic(), 0.0)):
                break
            now_s = time.monotonic()
            self._tick(sample.t_s, now_s)
            if utc is not None:
                self._hear(ClockTime(utc.timestamp(), ClockSource.GPS), now_s, sample.t_s)
            for quantity in _quantities(sample):
                self._hear(quantity, now_s, sample.t_s)
        return True

    def _samples(self) -> Iterator[tuple[TelemetrySample, datetime | None]]:
        """Yield each line's sample and UTC, waiting for whole lines at the end of the file."""
        header = ""
        first_utc: datetime | None = None
        for line in self._lines():
            if not header:
                header = line
                continue
            reading = read_own_csv(f"{header}\n{line}\n", str(self._path))
            for sample in reading.samples:
                utc = reading.first_utc
                if utc is None:
                    yield sample, None
                    continue
                first_utc = first_utc or utc
                t_s = (utc - first_utc).total_seconds()
                yield _at(sample, t_s), utc

    def _lines(self) -> Iterator[str]:
        pending = b""
        with self._path.open("rb") as file:
            while not self._stopping.is_set():
                block = file.read(BLOCK_BYTES)
                if not block:
                    self._stopping.wait(POLL_S)
                    continue
                *lines, pending = (pending + block).split(b"\n")
                for line in lines:
                    text = line.decode("utf-8-sig", errors="replace").strip()
                    if text:
                        yield text


def _at(sample: TelemetrySample, t_s: float) -> TelemetrySample:
    values = (getattr(sample, name) for name in COLUMNS.values())
    return TelemetrySample(t_s, *values)


def _quantities(sample: TelemetrySample) -> list[Quantity]:
    found: list[Quantity] = []
    if sample.lat_deg is not None and sample.lon_deg is not None:
        found.append(Position(sample.lat_deg, sample.lon_deg))
    if sample.height_agl_m is not None:
        found.append(Height(sample.height_agl_m, HeightSource.LIDAR))
    gimbal = Gimbal(sample.heading_deg, sample.gimbal_pitch_deg, sample.gimbal_roll_deg)
    if gimbal != Gimbal():
        found.append(gimbal)
    if sample.hfov_deg is not None:
        found.append(Lens(sample.hfov_deg))
    return found
