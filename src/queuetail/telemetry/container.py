"""Telemetry inside a video: KLV data streams and DJI's subtitle stream, read through PyAV."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import av
from av.container import InputContainer

from queuetail.errors import InputError
from queuetail.telemetry.dji_srt import Cue, reading_from_cues
from queuetail.telemetry.klv import (
    KEY_START,
    Losses,
    Packet,
    decode,
    reading_by_stamps,
    reading_of,
    refuse_without,
)
from queuetail.telemetry.reading import Reading, VideoClock, without_strays

LENGTH_BYTES = 2  # before the text of a mov_text packet (3GPP TS 26.245)


class NoTelemetryError(InputError):
    """A file without any telemetry that is known, which is no fault of a video."""


def is_container(path: Path) -> bool:
    """Tell whether FFmpeg reads the file."""
    try:
        with av.open(str(path)):
            return True
    except (av.FFmpegError, OSError, ValueError):
        return False


def read_container(path: Path, clock: VideoClock) -> Reading:
    """Read the telemetry of a video: MISB ST 0601 KLV, else DJI subtitles.

    Times are relative to the first video frame's PTS.  Raises InputError when there is none.
    """
    try:
        with av.open(str(path)) as container:
            found = _demux(container)
    except (av.FFmpegError, OSError) as error:
        raise InputError(f"{path}: the video cannot be read ({error})") from None
    source = str(path)
    if found.losses.packets:
        refuse_without(found.packets, source, found.losses)
        reading = _klv_reading(found, source)
    elif found.cues:
        first_s = found.first_frame_s or 0.0
        cues = [Cue(None if c.start_s is None else c.start_s - first_s, c.text) for c in found.cues]
        reading = reading_from_cues(cues, source, clock)
    else:
        raise NoTelemetryError(
            f"{path}: there is no telemetry stream (KLV or DJI subtitles) in this video; "
            "give the flight log as a file"
        )
    if found.is_cut:
        note = "the video is damaged; telemetry was read up to there"
        return Reading(reading.samples, (*reading.notes, note), reading.first_utc)
    return reading


@dataclass(slots=True)
class _Found:
    """What demuxing a video brought: packets with their PTS, cues, and the first frame's time."""

    packets: list[tuple[float | None, Packet]] = field(default_factory=list)
    cues: list[Cue] = field(default_factory=list)
    losses: Losses = field(default_factory=Losses)
    first_frame_s: float | None = None
    video_before_klv_s: float | None = None  # the picture that lay before the first KLV packet
    is_cut: bool = False


def _demux(container: InputContainer) -> _Found:
    found = _Found()
    last_video_s: float | None = None
    try:
        for packet in container.demux():
            time_s = None
            if packet.pts is not None and packet.time_base is not None:
                time_s = float(packet.pts * packet.time_base)
            kind = packet.stream.type
            if kind == "video" and time_s is not None:
                # Frames may be stored out of order: the earliest PTS is that of the first frame.
                first_s = found.first_frame_s
                found.first_frame_s = time_s if first_s is None else min(first_s, time_s)
                last_video_s = time_s
            elif kind == "data" and packet.size and KEY_START in (body := bytes(packet)):
                if not found.packets:
                    found.video_before_klv_s = last_video_s
                found.packets += [(time_s, one) for one in decode(body, found.losses)]
            elif kind == "subtitle" and packet.size:
                found.cues.append(Cue(time_s, subtitle_text(bytes(packet))))
    except av.FFmpegError:
        found.is_cut = True
    return found


def _klv_reading(found: _Found, source: str) -> Reading:
    first_s = found.first_frame_s or 0.0
    timed = [(time_s - first_s, packet) for time_s, packet in found.packets if time_s is not None]
    if timed:
        return reading_of(timed, found.losses)
    # Synchronous KLV may come without PTS: its own clock, from the picture it was stored beside.
    packets = [packet for _, packet in found.packets]
    reading = without_strays(reading_by_stamps(packets, source, found.losses))
    start_s = min(sample.t_s for sample in reading.samples)
    beside_s = found.video_before_klv_s
    shift_s = (0.0 if beside_s is None else beside_s - first_s) - start_s
    samples = [replace(sample, t_s=sample.t_s + shift_s) for sample in reading.samples]
    note = "KLV packets carry no presentation time; their own time stamps were used"
    return Reading(samples, (*reading.notes, note))


def subtitle_text(body: bytes) -> str:
    """Return the text of a subtitle packet, with or without mov_text's length in front."""
    length = int.from_bytes(body[:LENGTH_BYTES], "big")
    has_length = LENGTH_BYTES + length <= len(body) and body[:1] < b" "
    text = body[LENGTH_BYTES : LENGTH_BYTES + length] if has_length else body
    return text.decode("utf-8", errors="replace") + "\n"
