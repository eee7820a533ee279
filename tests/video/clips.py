"""Tiny videos written with PyAV, so that no sample needs to be in the repository."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

MILLISECONDS = Fraction(1, 1000)
STEP = 8  # grey levels from one frame to the next


def picture(index: int, width: int = 64, height: int = 48) -> np.ndarray:  # type: ignore[type-arg]
    """Return a grey picture that tells its index, with a bright top left corner (RGB)."""
    image = np.full((height, width, 3), 32 + STEP * (index % 25), np.uint8)
    image[: height // 4, : width // 4] = 255
    return image


def index_of(luma: np.ndarray) -> int:  # type: ignore[type-arg]
    """Return the index that a decoded picture tells by its bottom right quarter."""
    height, width = luma.shape
    level = float(luma[height // 2 :, width // 2 :].mean())
    full_range = (level - 16) * 255 / 219  # encoders get limited range
    return round((full_range - 32) / STEP)


def write_clip(
    path: Path,
    times_ms: Sequence[int] = tuple(range(0, 800, 40)),
    *,
    size: tuple[int, int] = (64, 48),
    codec: str = "mpeg4",
    pixel_format: str = "yuv420p",
    options: dict[str, str] | None = None,
    container_options: dict[str, str] | None = None,
    container_format: str | None = None,
    noise: bool = False,
) -> Path:
    """Write frames at the given times; each tells its index by its grey level."""
    generator = np.random.default_rng(0)
    with av.open(
        str(path), "w", format=container_format, options=container_options or {}
    ) as container:
        stream = container.add_stream(codec, rate=25)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = size
        stream.pix_fmt = pixel_format
        stream.time_base = stream.codec_context.time_base = MILLISECONDS
        stream.options = options or {}
        for index, time_ms in enumerate(times_ms):
            image = picture(index, *size)
            if noise:
                image = generator.integers(0, 255, image.shape, np.uint8)
            frame = VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts, frame.time_base = time_ms, MILLISECONDS
            for packet in stream.encode(frame.reformat(format=pixel_format)):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def write_sound(path: Path, codec: str = "aac", seconds: float = 0.5) -> Path:
    """Write a file that holds sound and nothing else."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=16_000)
        for start in range(0, int(seconds * 16_000), 1024):
            samples = np.zeros((1, 1024), np.float32)
            frame = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
            frame.sample_rate, frame.pts = 16_000, start
            container.mux(stream.encode(frame))  # type: ignore[attr-defined]
        container.mux(stream.encode(None))  # type: ignore[attr-defined]
    return path


def turn(path: Path, clockwise_deg: int) -> Path:
    """Write a rotation into an MP4's track header, as a phone held upright does."""
    matrices = {
        90: (0, 1, -1, 0),
        180: (-1, 0, 0, -1),
        270: (0, -1, 1, 0),
    }
    a, b, c, d = (v * 65_536 for v in matrices[clockwise_deg])
    data = bytearray(path.read_bytes())
    header = data.index(b"tkhd") + 4
    at = header + (40 if data[header] == 0 else 52)  # version 1 has 64-bit times
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    return path


def cut(path: Path, share: float) -> Path:
    """Leave only the first part of a file."""
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    return path
