"""Video files through PyAV: whatever FFmpeg reads, true timestamps, luma untouched."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from queuetail.errors import InputError
from queuetail.types import Frame, Image

# Formats whose first plane is 8-bit luma at full size, so that it can be used where it lies.
LUMA_FIRST = {
    *("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "yuv440p", "yuvj440p"),
    *("yuv411p", "yuv410p", "yuva420p", "yuva422p", "yuva444p", "nv12", "nv21", "nv16", "gray"),
}
SHORTFALL_S = 0.5  # a file that ends this much before its header says is reported as truncated
DEFAULT_RATE_HZ = 25.0  # for elementary streams, which carry no time at all


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """What a video's header says; size as a viewer sees it, after rotation."""

    name: str
    width_px: int
    height_px: int
    rotation_deg: int
    frame_rate_hz: float
    duration_s: float | None
    codec: str
    start_utc: datetime | None


class VideoFile:
    """An opened video file: ``info`` at once, ``frames()`` once, ``notes`` on what was wrong."""

    def __init__(self, path: Path) -> None:
        """Open `path`; raises InputError when it is missing or holds no video."""
        self.path = path
        self.notes: list[str] = []
        self._container = _open(path)
        if not self._container.streams.video:
            contents = _contents(self._container)
            self._container.close()
            raise InputError(f"{path} has no video stream (it holds {contents})")
        self._stream: VideoStream = self._container.streams.video[0]
        self._stream.thread_type = "AUTO"
        self._pictures: Iterator[VideoFrame] = self._decoded()
        first = next(self._pictures, None)
        if first is None:
            self._container.close()
            raise InputError(f"{path}: no picture could be decoded; the file is damaged or empty")
        self.info = self._read_info(first)
        self._pictures = chain([first], self._pictures)

    def __enter__(self) -> VideoFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Release the file."""
        self._container.close()

    def frames(self) -> Iterator[Frame]:
        """Yield every picture in order of time; its `t_s` is its timestamp, never a count.

        What cannot be decoded is skipped and said in ``notes`` at the end.
        """
        start_s: float | None = None
        last_s, index, repeated, guessed = -1.0, 0, 0, 0
        for picture in self._pictures:
            seconds = picture.time
            if seconds is None:
                guessed += 1
                seconds = (start_s or 0.0) + index / self.info.frame_rate_hz
            start_s = seconds if start_s is None else start_s
            t_s = seconds - start_s
            if t_s > last_s:
                yield _frame(index, t_s, picture, self.info.rotation_deg)
                last_s, index = t_s, index + 1
            else:
                repeated += 1
        self._note_problems(last_s, repeated, guessed)

    def _decoded(self) -> Iterator[VideoFrame]:
        """Yield what can be decoded of the first video stream; damaged packets are skipped."""
        damaged = 0
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets, None)
            except FFmpegError as error:
                self.notes.append(f"{self.path}: reading stopped early ({error.strerror})")
                break
            if packet is None:
                break
            try:
                yield from packet.decode()
            except FFmpegError:
                damaged += 1
        if damaged:
            self.notes.append(f"{self.path}: {damaged} damaged packets were skipped")

    def _note_problems(self, last_s: float, repeated: int, guessed: int) -> None:
        promised_s, name = self.info.duration_s, self.path
        if (
            promised_s is not None
            and promised_s - last_s > SHORTFALL_S + 2 / self.info.frame_rate_hz
        ):
            self.notes.append(
                f"{name} is truncated: its header promises {promised_s:.1f} s, "
                f"{max(last_s, 0):.1f} s were readable and processed"
            )
        if repeated:
            self.notes.append(f"{name}: {repeated} frames with repeated or backward times left out")
        if guessed:
            self.notes.append(
                f"{name}: {guessed} frames carry no time; "
                f"{self.info.frame_rate_hz:g} frames/s was assumed for them"
            )

    def _read_info(self, first: VideoFrame) -> VideoInfo:
        stream = self._stream
        rotation = round(first.rotation / 90.0) * 90 % 360
        width, height = first.width, first.height
        if rotation in (90, 270):
            width, height = height, width
        duration = stream.duration
        seconds = float(duration * stream.time_base) if duration and stream.time_base else None
        if seconds is None and self._container.duration:
            seconds = self._container.duration / av.time_base
        rate = stream.average_rate or stream.guessed_rate
        return VideoInfo(
            name=self.path.name,
            width_px=width,
            height_px=height,
            rotation_deg=rotation,
            frame_rate_hz=float(rate) if rate else DEFAULT_RATE_HZ,
            duration_s=seconds,
            codec=stream.codec_context.name,
            start_utc=_creation_time(self._container),
        )


def _open(path: Path) -> InputContainer:
    if path.is_dir():
        raise InputError(f"{path} is a folder, not a video file")
    if not path.exists():
        raise InputError(f"{path}: there is no such file")
    if path.stat().st_size == 0:
        raise InputError(f"{path} is empty (0 bytes); copy the recording again")
    try:
        return av.open(str(path))
    except PermissionError:
        raise InputError(f"{path} cannot be read: permission denied") from None
    except FFmpegError as error:
        raise InputError(
            f"{path} is not a video that FFmpeg can read, or it is cut off before its index "
            f"({error.strerror}); check that the recording was closed and copied whole"
        ) from None


def _contents(container: InputContainer) -> str:
    kinds = sorted({s.type for s in container.streams})
    return ", ".join(kinds) if kinds else "no streams"


def _creation_time(container: InputContainer) -> datetime | None:
    text = container.metadata.get("creation_time")
    try:
        moment = datetime.fromisoformat(text) if text else None
    except ValueError:
        return None
    if moment is not None and moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return moment


def _frame(index: int, t_s: float, picture: VideoFrame, rotation_deg: int) -> Frame:
    turns = rotation_deg // 90

    def bgr(width_px: int, height_px: int) -> Image:
        size = (height_px, width_px) if turns % 2 else (width_px, height_px)
        scaled = picture.reformat(*size, format="bgr24", interpolation="AREA").to_ndarray()
        turned = np.rot90(scaled, turns) if turns else scaled
        return np.ascontiguousarray(turned, np.uint8)

    luma = _luma(picture)
    return Frame(index, t_s, np.rot90(luma, turns) if turns else luma, bgr)


def _luma(picture: VideoFrame) -> Image:
    if picture.format.name not in LUMA_FIRST:
        picture = picture.reformat(format="gray")
    plane = picture.planes[0]
    rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
    return rows[: picture.height, : picture.width]
