"""A recording read back: its messages, and its pictures with the times that the run gave them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

from av.codec.context import CodecContext
from av.error import FFmpegError
from av.packet import Packet
from av.video.codeccontext import VideoCodecContext
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from queuetail.config import Site, parse_settings
from queuetail.errors import InputError
from queuetail.live.mcap_file import is_finished, read_mcap
from queuetail.live.mcap_records import FORMAT, Record
from queuetail.live.segments import CLOCK_WRAP_S, read_packets, segment_paths, source_time_s
from queuetail.types import Frame, TelemetrySample
from queuetail.video.capture import frame_of

DATA_FILES = "data-*.mcap"


@dataclass(frozen=True, slots=True)
class RecordedFrame:
    """A processed frame: which picture of the video it is, and what the pipeline was given."""

    number: int
    session: int
    pts_s: float
    index: int
    t_s: float
    utc: datetime
    telemetry: TelemetrySample


@dataclass(slots=True)
class Recording:
    """All messages of a recording that a replay needs."""

    folder: Path
    preset: str
    site: Site
    source: str
    started_utc: datetime
    version: str
    size_px: tuple[int, int] = (0, 0)
    frames: list[RecordedFrame] = field(default_factory=list)
    states: dict[int, list[Record]] = field(default_factory=dict)  # by the answer's number
    doubts: dict[int, tuple[str, ...]] = field(default_factory=dict)  # of those answers
    answers: int = 0  # also those that were given without a picture
    was_cut: bool = False
    missing: int = 0  # processed frames that the video does not hold; those after its end apart
    notes: list[str] = field(default_factory=list)

    def pictures(self) -> Iterator[Frame]:
        """Yield the frames that were processed, with the recorded times, in order.

        Those that the video does not hold are left out, counted, and said in ``notes``.
        """
        last_s = -math.inf
        expected: dict[tuple[int, int], RecordedFrame] = {}
        for frame in self.frames:
            expected[frame.session, _millisecond(frame.pts_s)] = frame
        for session, paths in segment_paths(self.folder).items():
            for picture, time_s in _decoded(paths):
                found = _matched(expected, session, time_s)
                if found is not None:
                    turns = round(picture.rotation) % 360
                    last_s = max(last_s, found.t_s)
                    yield frame_of(found.index, found.t_s, picture, turns)
        self.missing = sum(f.t_s < last_s for f in expected.values())
        if expected:
            first_s = min(f.t_s for f in expected.values())
            self.notes.append(
                f"{len(expected)} of {len(self.frames)} processed frames are not in the recorded "
                f"video, the first at {first_s:.3f} s"
            )


def find_recording(folder: Path) -> Path:
    """Return the folder of one recording: `folder` itself, or the only one in it."""
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder; give the folder of a recording")
    if any(folder.glob(DATA_FILES)):
        return folder
    inside = sorted(p for p in folder.iterdir() if p.is_dir() and any(p.glob(DATA_FILES)))
    if not inside:
        raise InputError(
            f"{folder} holds no recording: there is no {DATA_FILES} in it; "
            "give the folder that --record wrote"
        )
    if len(inside) > 1:
        names = ", ".join(p.name for p in inside[-5:])
        raise InputError(f"{folder} holds {len(inside)} recordings; name one of them: … {names}")
    return inside[0]


def read_recording(folder: Path) -> Recording:
    """Read all messages of a recording; raises InputError where it cannot be replayed."""
    recording: Recording | None = None
    files = sorted(folder.glob(DATA_FILES))
    for path in files:
        for message in read_mcap(path):
            if message.topic == "/run" and recording is None:
                recording = _begun(folder, message.record)
            elif message.topic == "/frame" and recording is not None:
                _add_frame(recording, message.record)
            elif message.topic == "/answer" and recording is not None:
                recording.answers += 1
                if message.record["of_frame"]:
                    number = int(message.record["number"])
                    recording.states[number] = message.record["states"]
                    recording.doubts[number] = tuple(message.record["doubts"])
    if recording is None:
        raise InputError(
            f"{folder}: nothing of the recording was written before it was cut off; "
            "there is nothing to replay"
        )
    recording.was_cut = not is_finished(files[-1])
    return recording


def _begun(folder: Path, run: Record) -> Recording:
    if int(run["format"]) > FORMAT:
        raise InputError(
            f"{folder} was recorded by queuetail {run['queuetail_version']}, whose recordings this "
            "version cannot read; update queuetail"
        )
    return Recording(
        folder=folder,
        preset=str(run["preset"]),
        site=parse_settings(Site, run["site"], f"{folder}: the recorded site"),
        source=str(run["source"]),
        started_utc=datetime.fromisoformat(run["started_utc"]),
        version=str(run["queuetail_version"]),
    )


def _add_frame(recording: Recording, record: Record) -> None:
    if record["pts_s"] is None:
        return
    if recording.size_px == (0, 0):
        width_px, height_px = record["size_px"]
        recording.size_px = (int(width_px), int(height_px))
    recording.frames.append(
        RecordedFrame(
            number=int(record["number"]),
            session=int(record["session"]),
            pts_s=float(record["pts_s"]),
            index=int(record["index"]),
            t_s=float(record["t_s"]),
            utc=datetime.fromisoformat(record["utc"]),
            telemetry=_sample(record),
        )
    )


def _sample(record: Record) -> TelemetrySample:
    values: dict[str, Any] = record["telemetry"] or {}
    t_s = record["telemetry_t_s"]
    return TelemetrySample(record["t_s"] if t_s is None else t_s, **values)


def _decoded(paths: list[Path]) -> Iterator[tuple[VideoFrame, float]]:
    """Yield a session's pictures and their own times; one decoder reads all its segments."""
    decoder: VideoCodecContext | None = None
    base = Fraction(1, 90_000)
    for path in paths:
        for packet in read_packets(path):
            base = packet.time_base or base
            decoder = decoder or _decoder(packet.stream.codec_context)
            yield from _pictures(decoder, packet, base)
    if decoder is not None:
        yield from _pictures(decoder, None, base)


def _decoder(like: VideoCodecContext) -> VideoCodecContext:
    decoder = CodecContext.create(like.codec.name, "r")
    assert isinstance(decoder, VideoCodecContext)
    decoder.extradata = like.extradata
    if like.width and like.height:  # raw pictures do not tell these themselves
        decoder.width, decoder.height = like.width, like.height
        if like.pix_fmt:
            decoder.pix_fmt = like.pix_fmt
    return decoder


def _pictures(
    decoder: VideoCodecContext, packet: Packet[VideoStream] | None, base: Fraction
) -> Iterator[tuple[VideoFrame, float]]:
    try:
        pictures = decoder.decode(packet)
    except FFmpegError:
        return  # as the live run did
    for picture in pictures:
        if picture.pts is not None:
            yield picture, source_time_s(float(picture.pts * base))


def _matched(
    expected: dict[tuple[int, int], RecordedFrame], session: int, time_s: float
) -> RecordedFrame | None:
    """Take the frame of this time out of `expected`; containers round to a millisecond."""
    near = _millisecond(time_s)
    for key in (near, near - 1, near + 1):
        found = expected.pop((session, key), None)
        if found is not None:
            return found
    return None


def _millisecond(time_s: float) -> int:
    """Return a time on the container's clock, one lap of it, as a whole number to look up by."""
    return round(time_s % CLOCK_WRAP_S * 1000)
