"""The incoming video written as it is, in segments that play up to the byte where they were cut.

MPEG-TS where the codec allows: it has no index, needs no end, and carries KLV beside the picture.
NUT for the rest (a webcam's MJPEG or raw pictures), which takes every codec and finds its way back
after damage.  Nothing is encoded anew.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import av
from av.error import FFmpegError
from av.video.stream import VideoStream

from queuetail.live.mcap_records import TIME_SHIFT_S

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.packet import Packet
    from av.stream import Stream

    from queuetail.live.outlet import StreamInfo

TRANSPORT_CODECS = {"h264", "hevc", "mpeg2video"}  # whose headers come with the pictures
OPTIONS = {
    "avoid_negative_ts": "disabled",
    "flush_packets": "1",
    # The muxer waits for every stream to have a packet; KLV comes late or not at all.
    "max_interleave_delta": "100000",
}
TRANSPORT_OPTIONS = {**OPTIONS, "mpegts_copyts": "1"}
# How webcams lay out raw pictures, and the four letters by which a file says so (fourcc.org).
RAW_TAGS = {
    "yuyv422": "YUY2",
    "uyvy422": "UYVY",
    "nv12": "NV12",
    "nv21": "NV21",
    "yuv420p": "I420",
    "gray": "Y800",
}
CLOCK_WRAP_S = 2**33 / 90_000  # of MPEG-TS
GATHER_S = 0.4  # in which a new session shows which streams it has
GATHER_PACKETS = 400


class VideoSegments:
    """Writes packets into `folder`; a new file for every session and every `segment_s` seconds."""

    def __init__(self, folder: Path, segment_s: float) -> None:
        self._folder = folder
        self._segment_s = segment_s
        self._number = 0
        self._session: int | None = None
        self._streams: dict[int, StreamInfo] = {}
        self._gathered: list[tuple[Packet[Stream], StreamInfo, datetime]] = []
        self._segment: _Segment | None = None
        self.skipped = 0  # packets that no segment could take

    def write(self, packet: Packet[Stream], stream: StreamInfo, utc: datetime) -> None:
        """Add a packet that arrived at `utc`; raises OSError where the disk refuses."""
        if stream.session != self._session:
            self._next_session(stream.session)
        if stream.index not in self._streams:
            self._streams[stream.index] = stream
        if self._segment is None:
            self._gathered.append((packet, stream, utc))
            waited_s = (utc - self._gathered[0][2]).total_seconds()
            if waited_s >= GATHER_S or len(self._gathered) >= GATHER_PACKETS:
                self._write_gathered()
        else:
            self._place(packet, stream, utc)

    def flush(self) -> None:
        """See to it that all is on the disk."""
        if self._segment is not None:
            self._segment.flush()

    def close(self) -> None:
        """Finish the last segment."""
        if self._gathered:
            self._write_gathered()
        segment, self._segment = self._segment, None
        if segment is not None:
            segment.close()

    def abandon(self) -> None:
        """Let go of the last segment after a disk error; it plays up to where it ends."""
        segment, self._segment, self._gathered = self._segment, None, []
        if segment is not None:
            with contextlib.suppress(OSError, FFmpegError):
                segment.close()

    def _next_session(self, session: int) -> None:
        self.close()
        self._session, self._streams = session, {}

    def _write_gathered(self) -> None:
        gathered, self._gathered = self._gathered, []
        self._segment = self._open(gathered[0][2])
        for packet, stream, utc in gathered:
            self._place(packet, stream, utc)

    def _place(self, packet: Packet[Stream], stream: StreamInfo, utc: datetime) -> None:
        """Write into the present segment, or into a new one where it is time or the clock jumps."""
        assert self._segment is not None
        is_key = stream.kind == "video" and packet.is_keyframe
        due = (utc - self._segment.started).total_seconds() >= self._segment_s
        if (is_key and due) or not self._segment.takes(packet, stream):
            self._segment.close()
            self._segment = self._open(utc)
        if not self._segment.write(packet, stream):
            self.skipped += 1

    def _open(self, utc: datetime) -> _Segment:
        self._number += 1
        codecs = {s.codec for s in self._streams.values() if s.kind == "video"}
        is_transport = codecs <= TRANSPORT_CODECS
        name = segment_name(self._session or 0, self._number, "ts" if is_transport else "nut")
        kept = [s for s in self._streams.values() if is_transport or s.kind == "video"]
        return _Segment(self._folder / name, kept, is_transport, utc)


class UnwritableError(Exception):
    """No container takes a stream as it is."""


class _Segment:
    """One file; times are shifted by a constant, as no container holds times before zero."""

    def __init__(
        self, path: Path, streams: list[StreamInfo], is_transport: bool, started: datetime
    ) -> None:
        self.started = started
        self._file = path.open("xb")
        kind, options = ("mpegts", TRANSPORT_OPTIONS) if is_transport else ("nut", OPTIONS)
        self._container = av.open(self._file, "w", format=kind, options=options)
        try:
            self._out = {s.index: _copied(self._container, s.template) for s in streams}
            self._container.start_encoding()  # a container whose header failed must not be used
        except (FFmpegError, ValueError) as error:
            self._file.close()
            codecs = ", ".join(s.codec or s.kind for s in streams)
            raise UnwritableError(f"streams of the kind {codecs} cannot be recorded") from error
        self._last_dts: dict[int, int] = {}
        self._last_s: float | None = None  # of the packets that carry a time

    def takes(self, packet: Packet[Stream], stream: StreamInfo) -> bool:
        """Return whether the packet's time goes on where the last one ended."""
        last = self._last_dts.get(stream.index)
        return packet.dts is None or last is None or packet.dts > last

    def write(self, packet: Packet[Stream], stream: StreamInfo) -> bool:
        """Write a packet; False where the container cannot hold it."""
        out = self._out.get(stream.index)
        base = packet.time_base or stream.time_base
        if out is None or not base:
            return False
        dts = packet.dts if packet.dts is not None else packet.pts
        if dts is None:  # asynchronous KLV carries no time of its own: that of its neighbour
            if self._last_s is None:
                return False
            dts = round(self._last_s / base)
        pts = packet.pts if packet.pts is not None else dts
        copy = av.Packet(bytes(packet))
        copy.time_base = base
        copy.dts = dts + round(TIME_SHIFT_S / base)
        copy.pts = max(pts, dts) + round(TIME_SHIFT_S / base)
        copy.is_keyframe = packet.is_keyframe
        if packet.duration:
            copy.duration = packet.duration
        copy.stream = out
        try:
            self._container.mux_one(copy)
        except FFmpegError:
            return False
        self._last_dts[stream.index] = dts
        self._last_s = float(dts * base)
        return True

    def flush(self) -> None:
        self._file.flush()
        os.fsync(self._file.fileno())

    def close(self) -> None:
        if self._file.closed:
            return
        try:
            self._container.close()
            self.flush()
        finally:
            self._file.close()


def segment_name(session: int, number: int, suffix: str) -> str:
    """Return a segment's file name: sessions and segments sort by it."""
    return f"video-{session:03d}-{number:05d}.{suffix}"


def segment_paths(folder: Path) -> dict[int, list[Path]]:
    """Return the video segments of a recording, in order, by session."""
    sessions: dict[int, list[Path]] = {}
    for path in sorted(folder.glob("video-*-*.*")):
        if path.suffix in (".ts", ".nut"):
            sessions.setdefault(int(path.name.split("-")[1]), []).append(path)
    return sessions


def read_packets(path: Path) -> Iterator[Packet[VideoStream]]:
    """Yield the video packets of a segment, up to where it was cut; none where nothing is left."""
    try:
        container = av.open(str(path))
    except FFmpegError:
        return
    with container:
        if not container.streams.video:
            return
        packets = container.demux(container.streams.video[0])
        while True:
            try:
                packet = next(packets, None)
            except FFmpegError:
                return
            if packet is None:
                return
            if packet.size:
                yield packet


def source_time_s(file_time_s: float) -> float:
    """Return the source's own time of a picture whose time in a segment is given, on one lap."""
    return (file_time_s - TIME_SHIFT_S) % CLOCK_WRAP_S


def _copied(container: OutputContainer, template: Stream) -> Stream:
    copy = container.add_stream_from_template(template, opaque=True)
    if isinstance(copy, VideoStream) and copy.codec_context.name == "rawvideo":
        layout = copy.codec_context.pix_fmt or ""
        if layout not in RAW_TAGS:
            raise ValueError(f"raw pictures of the layout {layout}")
        copy.codec_context.codec_tag = RAW_TAGS[layout]
    return copy
