"""One connection to a live source: its packets decoded, all of them, without falling behind."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from time import monotonic
from typing import Any

import av
from av.container import InputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.sidedata.sidedata import Type
from av.stream import Disposition, Stream
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from stanag4609.errors import Stanag4609Error
from stanag4609.st0604 import (
    MISP_HEVC_MICROSECOND_UUID,
    MISP_HEVC_NANOSECOND_UUID,
    MISP_MICROSECOND_IDENTIFIER,
    TimestampResolution,
    decode_timestamp_payload,
)

from queuetail.live.outlet import StreamInfo
from queuetail.telemetry import klv
from queuetail.types import Frame, Image
from queuetail.video.capture import frame_of
from queuetail.video.stream_clock import FAR_BEHIND_S, Stamp, StreamClock

WAITED_S = 0.005  # a packet that took longer to get was not there yet
SHOW_EVERY_S = 0.5  # even while behind
UTC_MARKS = (MISP_MICROSECOND_IDENTIFIER, MISP_HEVC_MICROSECOND_UUID, MISP_HEVC_NANOSECOND_UUID)
SEI_TYPES = {"h264": 0x1B, "hevc": 0x24, "mpeg2video": 0x02}  # as in the TS's program map
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


@dataclass(frozen=True, slots=True)
class Captured:
    """One picture of a live stream and its times; ``_s`` without more is `time.monotonic()`."""

    frame: Frame
    captured_s: float  # when it was taken, as well as arrivals tell
    arrived_s: float
    utc: datetime  # when it was taken: embedded time, else from the arrival
    has_embedded_utc: bool
    session: int  # counts the connections of the run
    pts_s: float  # its own time in the connection's stream
    media_s: float  # the same after the connection's first picture


@dataclass(frozen=True, slots=True)
class Metadata:
    """KLV packets that came within the stream, and when the pictures beside them were taken."""

    packets: tuple[klv.Packet, ...]
    captured_s: float


@dataclass(slots=True)
class Counts:
    """What happened to the packets of a run."""

    decoded: int = 0
    shown: int = 0
    skipped: int = 0  # not decoded or not shown, to keep up
    damaged: int = 0
    out_of_order: int = 0


class Session:
    """Reads one open container; ``items`` yields pictures and metadata as they come."""

    def __init__(
        self,
        container: InputContainer,
        number: int,
        clock: StreamClock,
        counts: Counts,
        packet_sinks: tuple[Callable[[Packet[Stream], StreamInfo, datetime], None], ...] = (),
        pace: Callable[[float], None] | None = None,
    ) -> None:
        """Take an open container; raises ValueError where it has no video."""
        moving = [
            s for s in container.streams.video if not s.disposition & Disposition.attached_pic
        ]
        if not moving:
            raise ValueError("there is no video in it")
        self._container, self._number = container, number
        self._clock, self._counts = clock, counts
        self._sinks, self._pace = packet_sinks, pace
        self._video: VideoStream = moving[0]
        # Threads by slices only: threads by frames would hold back one picture each.
        self._video.thread_type = "SLICE"
        self._streams: list[Stream] = [self._video, *container.streams.data]
        self._infos = self._templates() if packet_sinks else {}
        self._losses = klv.Losses()
        self._tells_utc = False  # in its pictures, as MISB ST 0604 has it
        self._klv_utc_s: float | None = None  # UTC − PTS, as the newest KLV packet has it
        self._first_pts_s: float | None = None
        self._first_dts_s: float | None = None
        self._shown_s = -1e9

    def items(self) -> Iterator[Captured | Metadata]:
        """Yield until the source ends; raises FFmpegError when it breaks or is silent too long."""
        packets = self._container.demux(self._streams)
        while True:
            asked_s = monotonic()
            packet = next(packets, None)
            if packet is None:
                return
            arrived_s = monotonic()
            waited = arrived_s - asked_s > WAITED_S
            if packet.stream is self._video:
                yield from self._pictures(packet, arrived_s, waited)
            elif packet.size:
                yield from self._metadata(packet, arrived_s)
            if packet.size:
                self._hand_on(packet)

    def _pictures(
        self, packet: Packet[Stream], arrived_s: float, waited: bool
    ) -> Iterator[Captured]:
        dts_s, pts_s = _seconds(packet, packet.dts), _seconds(packet, packet.pts)
        if self._pace is not None and dts_s is not None:
            self._first_dts_s = dts_s if self._first_dts_s is None else self._first_dts_s
            self._pace(dts_s - self._first_dts_s)
            arrived_s, waited = monotonic(), True
        if packet.size:
            if not self._tells_utc:
                coded = bytes(packet)
                self._tells_utc = any(mark in coded for mark in UTC_MARKS)
            known_s = next((s for s in (pts_s, dts_s) if s is not None), arrived_s)
            self._clock.packet(known_s if dts_s is None else dts_s, known_s, arrived_s, waited)
        self._keep_up(packet, arrived_s)
        try:
            pictures = self._video.decode(packet)
        except FFmpegError:
            self._counts.damaged += 1
            return
        if not pictures and self._video.codec_context.skip_frame != "DEFAULT":
            self._counts.skipped += 1
        for picture in pictures:
            captured = self._captured(picture, arrived_s)
            if captured is not None:
                yield captured

    def _keep_up(self, packet: Packet[Stream], now_s: float) -> None:
        """Decode less while behind: first leave out what no other picture needs, then more."""
        lag_s = self._clock.lag_s(now_s)
        context = self._video.codec_context
        if lag_s > FAR_BEHIND_S:
            context.skip_frame = "NONKEY"
        elif lag_s > 0 and context.skip_frame == "DEFAULT":
            context.skip_frame = "NONREF"
        elif lag_s == 0 and (context.skip_frame == "NONREF" or packet.is_keyframe):
            context.skip_frame = "DEFAULT"

    def _captured(self, picture: VideoFrame, arrived_s: float) -> Captured | None:
        """Return the picture with its times; ``None`` where it is not to be shown."""
        if picture.is_corrupt:
            self._counts.damaged += 1
            return None
        self._counts.decoded += 1
        if self._clock.lag_s(arrived_s) > 0 and arrived_s - self._shown_s < SHOW_EVERY_S:
            self._counts.skipped += 1
            return None
        pts_s = arrived_s if picture.time is None else picture.time
        stamp = self._clock.picture(pts_s, arrived_s)
        if stamp is None:
            self._counts.out_of_order += 1
            return None
        self._shown_s = arrived_s
        self._first_pts_s = pts_s if self._first_pts_s is None else self._first_pts_s
        utc_s = self._embedded_utc_s(picture, pts_s)
        rotation_deg = round(picture.rotation / 90.0) * 90 % 360
        frame = locked(frame_of(self._counts.shown, stamp.t_s, picture, rotation_deg))
        self._counts.shown += 1
        return Captured(
            frame=frame,
            captured_s=stamp.captured_s,
            arrived_s=arrived_s,
            utc=utc_of(stamp) if utc_s is None else EPOCH + timedelta(seconds=utc_s),
            has_embedded_utc=utc_s is not None,
            session=self._number,
            pts_s=pts_s,
            media_s=pts_s - self._first_pts_s,
        )

    def _embedded_utc_s(self, picture: VideoFrame, pts_s: float) -> float | None:
        """Return the time that the picture itself or the KLV beside it tells, since 1970."""
        stream_type = SEI_TYPES.get(self._video.codec_context.name)
        # Who asks a picture for side data ties it to that in a circle, which keeps its memory for
        # seconds: so only pictures of a stream that has such times are asked.
        extras: list[Any] = list(picture.side_data) if self._tells_utc else []
        for data in extras:
            if stream_type is None or data.type is not Type.SEI_UNREGISTERED:
                continue
            try:
                stamp = decode_timestamp_payload(bytes(data), stream_type=stream_type)
            except (Stanag4609Error, ValueError):
                continue
            per_s = 1e9 if stamp.resolution is TimestampResolution.NANOSECONDS else 1e6
            return float(stamp.value / per_s)
        return None if self._klv_utc_s is None else self._klv_utc_s + pts_s

    def _metadata(self, packet: Packet[Stream], arrived_s: float) -> Iterator[Metadata]:
        body = bytes(packet)
        if klv.KEY_START not in body:
            return
        found = tuple(klv.decode(body, self._losses))
        pts_s = _seconds(packet, packet.pts)
        stamps = [p.stamp_s for p in found if p.stamp_s is not None]
        if pts_s is not None and stamps:
            self._klv_utc_s = stamps[-1] - pts_s
        if found:
            yield Metadata(found, self._clock.captured_s(pts_s, arrived_s))

    def _hand_on(self, packet: Packet[Stream]) -> None:
        """Give the packet away, as it came; it is not touched here afterwards."""
        info = self._infos.get(packet.stream_index)
        if info is not None:
            utc = datetime.now(UTC)
            for sink in self._sinks:
                sink(packet, info, utc)

    def _templates(self) -> dict[int, StreamInfo]:
        """Describe the streams by copies that stay valid when the container is closed."""
        keeper = av.open(io.BytesIO(), "w", format="mpegts")
        infos = {}
        for stream in self._streams:
            try:
                template = keeper.add_stream_from_template(stream)
            except (FFmpegError, ValueError):
                continue  # of a kind that no container can hold
            context = stream.codec_context
            infos[stream.index] = StreamInfo(
                session=self._number,
                index=stream.index,
                kind=stream.type,
                codec=context.name if context is not None else "",
                time_base=stream.time_base or Fraction(1, 90_000),
                template=template,
            )
        return infos


def _seconds(packet: Packet[Stream], ticks: int | None) -> float | None:
    return None if ticks is None or packet.time_base is None else float(ticks * packet.time_base)


def utc_of(stamp: Stamp) -> datetime:
    """Return when a picture was taken by this machine's clocks."""
    return datetime.now(UTC) - timedelta(seconds=monotonic() - stamp.captured_s)


def locked(frame: Frame) -> Frame:
    """Return a frame whose colours several threads may ask for at once."""
    lock, convert = threading.Lock(), frame.bgr

    def bgr(width_px: int, height_px: int) -> Image:
        with lock:
            return convert(width_px, height_px)

    return replace(frame, bgr=bgr)
