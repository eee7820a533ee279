"""annotated.mp4: the video with what was found drawn over it, at its own timestamps."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.container import OutputContainer
from av.error import FFmpegError
from av.packet import Packet
from av.video.stream import VideoStream

from queuetail.errors import InputError
from queuetail.sinks import RunInfo
from queuetail.sinks.overlay import Overlay
from queuetail.types import Frame, Image, Observation

MAX_SIDE_PX = 1280
TICKS_PER_S = 90_000
NAME = "annotated.mp4"


class AnnotatedVideo:
    """annotated.mp4 in H.264, of the input's size up to MAX_SIDE_PX on its longer side.

    The file is written in fragments, so that a killed run leaves a playable one.
    """

    def __init__(self, info: RunInfo) -> None:
        self._path = info.out / NAME
        self._size = output_size(info.width_px, info.height_px)
        title = f"{info.video_name} · preset {info.preset} · speeds in mph"
        self._overlay = Overlay((info.width_px, info.height_px), self._size, title)
        self._last_pts = -1
        self._closed = False
        self._container, self._stream = _open(self._path, self._size, info.frame_rate_hz)

    def write(self, frame: Frame, observation: Observation) -> None:
        """Draw and encode one frame."""
        image = frame.bgr(*self._size).copy()
        self._overlay.draw(image, observation)
        self._last_pts = max(round(frame.t_s * TICKS_PER_S), self._last_pts + 1)
        self._encode(image)

    def close(self) -> None:
        """Finish the file; without a single frame there is no video, and no file is left."""
        if self._closed:
            return
        self._closed = True
        try:
            if self._last_pts >= 0:
                self._mux(self._stream.encode(None))
            self._container.close()
        except (FFmpegError, OSError) as error:
            raise InputError(f"{self._path} cannot be finished: {error.strerror}") from None
        if self._last_pts < 0:
            self._path.unlink(missing_ok=True)

    def _encode(self, image: Image) -> None:
        planes = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420), np.uint8)
        picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        picture.pts = self._last_pts
        picture.time_base = Fraction(1, TICKS_PER_S)
        try:
            self._mux(self._stream.encode(picture))
        except (FFmpegError, OSError) as error:
            self._closed = True  # FFmpeg must not touch a file again whose header failed
            raise InputError(f"{self._path} cannot be written: {error.strerror}") from None

    def _mux(self, packets: list[Packet[VideoStream]]) -> None:
        for packet in packets:
            self._container.mux(packet)


def output_size(width_px: int, height_px: int) -> tuple[int, int]:
    """Return the drawn size: the input's, at most MAX_SIDE_PX, and even as H.264 needs it."""
    scale = min(1.0, MAX_SIDE_PX / max(width_px, height_px))
    width, height = (max(2 * round(side * scale / 2), 2) for side in (width_px, height_px))
    return width, height


def _open(path: Path, size: tuple[int, int], rate_hz: float) -> tuple[OutputContainer, VideoStream]:
    flags = {"movflags": "hybrid_fragmented", "flush_packets": "1"}
    encoder = {"preset": "veryfast", "crf": "23", "bf": "0"}  # no B-frames: times start at zero
    rate = Fraction(min(max(rate_hz, 1.0), 240.0)).limit_denominator(1001)
    try:
        path.open("wb").close()  # the container itself opens its file at the first packet only
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    container = av.open(path, "w", options=flags)
    stream = container.add_stream("libx264", rate=rate, options=encoder)
    stream.width, stream.height = size
    stream.pix_fmt = "yuv420p"
    stream.gop_size = max(round(2 * rate), 1)
    stream.codec_context.time_base = stream.time_base = Fraction(1, TICKS_PER_S)
    return container, stream
