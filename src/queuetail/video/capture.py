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
from av.stream import Disposition
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

from queuetail.errors import InputError
from queuetail.types import Frame, Image

# Formats of 8-bit planes, luma at full size first and then chroma, if any, so that they can be used
# where they lie.
LUMA_FIRST = {
    *("yuv420p", "yuvj420p", "yuv422p", "yuvj422p", "yuv444p", "yuvj444p", "yuv440p", "yuvj440p"),
    *("yuv411p", "yuv410p", "yuva420p", "yuva422p", "yuva444p", "nv12", "nv21", "nv16", "gray"),
}
TEXT_ART = {"ansi", "bintext", "xbin", "idf"}  # what FFmpeg takes any .txt and .bin file for
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
        try:
            self._stream = _video_stream(self._container, path)
        except InputError:
            self._container.close()
            raise
        self._stream.thread_type = "AUTO"
        self._pictures: Iterator[VideoFrame] = self._decoded()
        first = next(self._pictures, None)
        if first is None:
            self._container.close()
            raise InputError(f"{path}: no picture could be decoded; the file is damaged or empty")
        self._is_avi = self._container.format.name == "avi"
        self._size, self._resized = (first.width, first.height), 0
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
            seconds = self._seconds(picture)
            if seconds is None:
                guessed += not self._is_avi  # whose last packets have none, harmlessly
                seconds = (
                    start_s + last_s + 1 / self.info.frame_rate_hz if start_s is not None else 0.0
                )
            start_s = seconds if start_s is None else start_s
            t_s = seconds - start_s
            if t_s > last_s:
                yield frame_of(index, t_s, self._in_first_size(picture), self.info.rotation_deg)
                last_s, index = t_s, index + 1
            else:
                repeated += 1
        self._note_problems(last_s, repeated, guessed)

    def _seconds(self, picture: VideoFrame) -> float | None:
        """Return the picture's own time; AVI has none but that of its packet, in decoding order."""
        if not self._is_avi:
            return picture.time
        if picture.dts is None or picture.time_base is None:
            return None
        return float(picture.dts * picture.time_base)

    def _in_first_size(self, picture: VideoFrame) -> VideoFrame:
        """Scale a picture of another size to the first one's, which every other part relies on."""
        if (picture.width, picture.height) == self._size:
            return picture
        self._resized += 1
        return picture.reformat(*self._size, interpolation="AREA")

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
        elif _ends_in_mid_data(name, self._container.format.name):
            self.notes.append(
                f"{name} is truncated: it ends in the middle of its data, "
                f"{max(last_s, 0):.1f} s were readable and processed"
            )
        if self._resized:
            self.notes.append(f"{name}: {self._resized} frames of another size were scaled")
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
        rate = stream.average_rate or stream.guessed_rate
        return VideoInfo(
            name=self.path.name,
            width_px=width,
            height_px=height,
            rotation_deg=rotation,
            frame_rate_hz=float(rate) if rate else DEFAULT_RATE_HZ,
            duration_s=_duration_s(self._container, stream),
            codec=stream.codec_context.name,
            start_utc=_creation_time(self._container),
        )


def _open(path: Path) -> InputContainer:
    try:
        if path.is_dir():
            raise InputError(f"{path} is a folder, not a video file")
        if path.stat().st_size == 0:
            raise InputError(f"{path} is empty (0 bytes); copy the recording again")
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{path}: there is no such file") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror})") from None
    try:
        return av.open(str(path))
    except PermissionError:
        raise InputError(f"{path} cannot be read: permission denied") from None
    except FFmpegError as error:
        raise InputError(
            f"{path} is not a video that FFmpeg can read, or it is cut off before its index "
            f"({error.strerror}); check that the recording was closed and copied whole"
        ) from None


def _video_stream(container: InputContainer, path: Path) -> VideoStream:
    """Return the first stream that moves: cover pictures of sound files and text do not."""
    streams = container.streams.video
    if any(s.codec_context.name in TEXT_ART for s in streams):
        raise InputError(f"{path} is not a video: FFmpeg takes it for text")
    moving = [s for s in streams if not s.disposition & Disposition.attached_pic]
    if not moving:
        raise InputError(f"{path} has no video stream (it holds {_contents(container)})")
    return moving[0]


def _duration_s(container: InputContainer, stream: VideoStream) -> float | None:
    """Return how long the header says that the video stream runs, from its first picture."""
    if stream.time_base is None:
        return None
    if stream.duration:
        return float(stream.duration * stream.time_base)
    end_s = _tagged_s(stream.metadata.get("DURATION"))
    if end_s is None and container.duration:
        end_s = container.duration / av.time_base
    if end_s is not None and container.format.name.startswith(("matroska", "nut")):
        # These say when they end, counted from time zero, not from their first picture.
        end_s -= float((stream.start_time or 0) * stream.time_base)
    return end_s if end_s is not None and end_s > 0 else None


def _tagged_s(text: str | None) -> float | None:
    """Parse the 00:01:30.040000000 that Matroska writers tag each stream with."""
    try:
        hours, minutes, seconds = (float(part) for part in (text or "").split(":"))
    except ValueError:
        return None
    return 3600 * hours + 60 * minutes + seconds


def _ends_in_mid_data(path: Path, format_name: str) -> bool:
    """Return whether a file without a usable promise of its length was cut off."""
    size = path.stat().st_size
    if format_name == "mpegts":
        return all(size % packet for packet in (188, 192, 204))
    if format_name == "avi":
        with path.open("rb") as file:
            promised = int.from_bytes(file.read(8)[4:], "little") + 8
        return size < promised < 1 << 32
    return False


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


def frame_of(index: int, t_s: float, picture: VideoFrame, rotation_deg: int) -> Frame:
    """Return a decoded picture as a frame: its luma where it lies, its colours on demand."""
    turns = rotation_deg // 90

    def bgr(width_px: int, height_px: int) -> Image:
        size = (height_px, width_px) if turns % 2 else (width_px, height_px)
        scaled = picture.reformat(*size, format="bgr24", interpolation="AREA").to_ndarray()
        turned = np.rot90(scaled, turns) if turns else scaled
        return np.ascontiguousarray(turned, np.uint8)

    is_plain = picture.format.name in LUMA_FIRST
    coded = picture if is_plain else picture.reformat(format="yuvj420p")
    planes = [_plane(coded, 0), *_chroma(coded)]
    luma, *chroma = (np.rot90(plane, turns) if turns else plane for plane in planes)
    return Frame(index, t_s, luma, bgr, tuple(chroma))


def _plane(picture: VideoFrame, number: int, samples: int = 1) -> Image:
    """Return a plane where it lies, with so many samples side by side in each pixel."""
    plane = picture.planes[number]
    rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
    return rows[: plane.height, : samples * plane.width]


def _chroma(picture: VideoFrame) -> tuple[Image, ...]:
    """Return the two colour planes where they lie, none of a grey picture."""
    count = len(picture.planes)
    if count == 1:
        return ()
    if count == 2:
        both = _plane(picture, 1, samples=2)
        return both[:, ::2], both[:, 1::2]
    return _plane(picture, 1), _plane(picture, 2)
