"""Reading telemetry of any known format: what a file is, its content decides, not its name."""

from __future__ import annotations

from pathlib import Path

from queuetail.errors import InputError
from queuetail.telemetry.airdata import is_airdata, read_airdata
from queuetail.telemetry.clean import clean
from queuetail.telemetry.container import NoTelemetryError, is_container, read_container
from queuetail.telemetry.dji_csv import is_dji_csv, read_dji_csv
from queuetail.telemetry.dji_srt import is_dji_srt, read_dji_srt
from queuetail.telemetry.flightlog import FlightLog
from queuetail.telemetry.klv import is_klv, read_klv
from queuetail.telemetry.own_csv import is_own_csv, read_own_csv
from queuetail.telemetry.reading import Reading, VideoClock, align
from queuetail.telemetry.text import decode_text

__all__ = ["VideoClock", "read_telemetry"]

FORMATS = (
    "queuetail's CSV, DJI SRT, AirData CSV, DJI frame CSV, and MISB ST 0601 KLV "
    "as raw packets or inside a video"
)
HEAD_BYTES = 65_536
MAX_TEXT_BYTES = 512 * 1024 * 1024  # an hour of per-frame SRT has about 70 MB


def read_telemetry(path: Path, video: VideoClock | None = None) -> FlightLog:
    """Read the flight log at `path`, or the log inside the video at `path`.

    `video` is what is known of the recording, for logs that tell only the time of day.
    Raises InputError with one sentence when the file cannot be read or says nothing of the flight.
    """
    clock = video or VideoClock()
    reading = align(_read(path, clock), clock)
    if not reading.samples:
        raise InputError(f"{path}: there is no telemetry in it")
    samples, notes = clean(reading.samples, str(path))
    return FlightLog(samples, str(path), (*reading.notes, *notes))


def _read(path: Path, clock: VideoClock) -> Reading:
    source = str(path)
    head = _bytes_of(path, HEAD_BYTES)
    if not head.strip():
        raise InputError(f"{path}: the telemetry file is empty")
    if is_klv(head):
        return read_klv(_bytes_of(path), source)
    if decode_text(head) is None:
        if is_container(path):
            return read_container(path, clock)
        raise _unknown(source)
    data = _bytes_of(path, MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise InputError(f"{path}: a text of over {MAX_TEXT_BYTES >> 20} MB is no flight log")
    text = decode_text(data)
    if text is None:
        raise _unknown(source)
    return _read_text(text, source, clock)


def _read_text(text: str, source: str, clock: VideoClock) -> Reading:
    if is_own_csv(text):
        return read_own_csv(text, source)
    if is_airdata(text):
        return read_airdata(text, source, clock)
    if is_dji_csv(text):
        return read_dji_csv(text, source)
    if is_dji_srt(text):
        return read_dji_srt(text, source, clock)
    raise _unknown(source)


def _unknown(source: str) -> InputError:
    return NoTelemetryError(f"{source} is no telemetry that queuetail knows; it reads {FORMATS}")


def _bytes_of(path: Path, count: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(count)
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such telemetry file") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder, not a telemetry file") from None
    except OSError as error:
        raise InputError(f"{path}: the telemetry file cannot be read ({error.strerror})") from None
