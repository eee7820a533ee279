"""What every telemetry adapter hands over, and how its clock meets the video's."""

from __future__ import annotations

import re
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from queuetail.types import TelemetrySample

STAMP = re.compile(
    r"(\d{4})[-./](\d{1,2})[-./](\d{1,2})[ T](\d{1,2}):(\d{2}):(\d{2})(?:[.,](\d{1,6}))?"
)
STRAY_S = 86_400.0  # no flight lasts a day: such a time is a clock that was not set yet


@dataclass(frozen=True, slots=True)
class VideoClock:
    """What is known of the video that a log belongs to; a naive `start_utc` is taken as UTC."""

    start_utc: datetime | None = None
    duration_s: float | None = None


@dataclass(frozen=True, slots=True)
class Reading:
    """Samples as one format gave them.

    ``first_utc`` is the wall-clock time of ``t_s`` = 0 where only a clock, not the video, gave the
    samples their times; it is None where ``t_s`` already counts from the video's first frame.
    """

    samples: Sequence[TelemetrySample]
    notes: tuple[str, ...] = ()
    first_utc: datetime | None = None


def as_utc(when: datetime) -> datetime:
    """Return `when` in UTC; a time without a zone is taken as UTC."""
    return when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)


def stamp_of(text: str) -> datetime | None:
    """Return the first date and time in `text`, in UTC unless it names a zone; None without any.

    Reads ISO 8601 and DJI's 2017.08.05 14:11:51,393,525 (milliseconds, then microseconds).
    """
    try:
        return as_utc(datetime.fromisoformat(text.strip()))
    except ValueError:
        match = STAMP.search(text)
    if match is None:
        return None
    *parts, fraction = match.groups()
    year, month, day, hour, minute, second = map(int, parts)
    microsecond = int((fraction or "0").ljust(6, "0"))
    try:
        return datetime(year, month, day, hour, minute, second, microsecond, tzinfo=UTC)
    except ValueError:
        return None


def without_strays(reading: Reading) -> Reading:
    """Drop the samples whose clock is over a day away from the others'."""
    if not reading.samples:
        return reading
    middle_s = statistics.median_low([sample.t_s for sample in reading.samples])
    kept = [sample for sample in reading.samples if abs(sample.t_s - middle_s) <= STRAY_S]
    strays = len(reading.samples) - len(kept)
    if not strays:
        return reading
    note = f"{strays} of {len(reading.samples)} samples: dropped (clock over a day off the others)"
    return replace(reading, samples=kept, notes=(*reading.notes, note))


def align(reading: Reading, video: VideoClock) -> Reading:
    """Return the reading with its clock times moved to seconds after the video's first frame.

    The video's start decides where it lies within the log; otherwise the log's first sample is
    taken as the first frame.  The notes say which was done.
    """
    if reading.first_utc is None or not reading.samples:
        return reading
    reading = without_strays(reading)
    times = [sample.t_s for sample in reading.samples]
    first, last = min(times), max(times)
    if video.start_utc is not None and reading.first_utc is not None:
        start_s = (as_utc(video.start_utc) - as_utc(reading.first_utc)).total_seconds()
        if first <= start_s <= last:
            return _moved(reading, -start_s, "times follow the video's own start time in UTC")
        why = "the video's start time lies outside the log"
    else:
        why = "the video does not say when it started"
    return _moved(
        reading,
        -first,
        f"{why}, so the log's first sample is taken as the video's first frame "
        "(set offset_s in the site file's [telemetry] where it is not)",
    )


def _moved(reading: Reading, offset_s: float, note: str) -> Reading:
    samples = [replace(sample, t_s=sample.t_s + offset_s) for sample in reading.samples]
    return Reading(samples, (*reading.notes, note))
