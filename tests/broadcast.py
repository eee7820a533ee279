"""A camera for tests of live video: pushes a clip in real time to wherever FFmpeg can write.

It is a program of its own, so that it can be stopped, continued and killed like a real one:
``python tests/broadcast.py CLIP URL FORMAT``; it prints each picture's time and when it was sent.
"""

from __future__ import annotations

import argparse
import csv
import signal
import socket
import subprocess
import sys
from bisect import bisect_right
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path
from time import monotonic, sleep

import av
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream

TICKS = Fraction(1, 90_000)
HEAD_START_S = 0.1  # the first picture's PTS
LIVE_ENCODER = {"preset": "ultrafast", "tune": "zerolatency", "x264-params": "log-level=none"}


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port that is free on the loopback now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def write_live_clip(
    path: Path,
    seconds: float = 2.0,
    rate_hz: int = 30,
    size: tuple[int, int] = (160, 96),
    group: int = 10,
) -> Path:
    """Encode a clip as a camera does: no B-frames, a key frame every `group` pictures.

    The level of its bottom right quarter tells the picture's index, modulo 25.
    """
    generator = np.random.default_rng(1)
    texture = generator.integers(0, 255, (size[1], size[0]), np.uint8)
    with av.open(str(path), "w", format="mpegts") as container:
        stream = container.add_stream("libx264", rate=rate_hz)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        stream.options = {**LIVE_ENCODER, "g": str(group)}
        for index in range(round(seconds * rate_hz)):
            image = texture.copy()
            image[size[1] // 2 :, size[0] // 2 :] = 32 + 8 * (index % 25)
            frame = VideoFrame.from_ndarray(image, format="gray").reformat(format="yuv420p")
            frame.pts, frame.time_base = index, Fraction(1, rate_hz)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


class Sender:
    """A camera process; stop it cleanly, kill it, or let it pause and go on."""

    def __init__(
        self,
        clip: Path,
        url: str,
        container_format: str,
        *,
        speed: float = 1.0,
        telemetry: Path | None = None,
    ) -> None:
        """Start sending at once, over and over; `telemetry` goes along as KLV."""
        command = [sys.executable, __file__, str(clip), url, container_format]
        command += ["--speed", str(speed)]
        if telemetry is not None:
            command += ["--telemetry", str(telemetry)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def pause(self) -> None:
        """Stop in mid-stream, with the connection open."""
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Continue after a pause."""
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> dict[float, float]:
        """Kill it and return when each picture was sent: its time, and the monotonic clock."""
        self._process.kill()
        lines = self._process.communicate(timeout=10)[0].splitlines()
        pairs = (line.split() for line in lines[:-1])
        return {float(media_s): float(sent_s) for media_s, sent_s in pairs}

    def __enter__(self) -> Sender:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self.kill()


def klv_packets(telemetry: Path, start: datetime) -> tuple[list[float], list[bytes]]:
    """Return one ST 0601 packet for each line of our own telemetry CSV, and their times."""
    from stanag4609.st0601 import encode_uas_local_set  # noqa: PLC0415 - only where it is sent

    times, packets = [], []
    with telemetry.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            t_s = float(row["t_s"])
            values = {
                2: start + timedelta(seconds=t_s),
                **{5: float(row["heading_deg"]) % 360.0, 6: 0.0, 7: 0.0},
                **{13: float(row["lat"]), 14: float(row["lon"])},
                **{15: 300.0 + float(row["height_agl_m"]), 16: float(row["hfov_deg"])},
                **{18: 0.0, 19: float(row["gimbal_pitch_deg"]), 20: 0.0, 25: 300.0, 65: 19},
            }
            times.append(t_s)
            packets.append(encode_uas_local_set(values))
    return times, packets


def push(arguments: argparse.Namespace) -> None:
    """Send the clip once or more, until killed or disconnected."""
    is_rtsp = arguments.format == "rtsp"
    options = (
        {"rtsp_transport": "tcp"}
        if is_rtsp
        else {"flush_packets": "1", "max_interleave_delta": "1"}
    )
    with (
        av.open(arguments.clip) as clip,
        av.open(arguments.url, "w", format=arguments.format, options=options) as out,
    ):
        video = clip.streams.video[0]
        copy = out.add_stream_from_template(video)
        times, metadata = [], []
        if arguments.telemetry:
            times, metadata = klv_packets(arguments.telemetry, datetime.now(UTC))
            data = out.add_data_stream("klv")
        packets = [p for p in clip.demux(video) if p.dts is not None]
        assert video.time_base is not None
        loop = packets[-1].dts - packets[0].dts + packets[1].dts - packets[0].dts
        start_s, first, turn, sent = monotonic(), packets[0].dts, 0, -1
        while True:
            for packet in packets:
                ticks = packet.dts - first + turn * loop
                media_s = float(ticks * video.time_base)
                sleep(max(start_s + media_s / arguments.speed - monotonic(), 0.0))
                copied = av.Packet(bytes(packet))
                copied.stream, copied.time_base = copy, video.time_base
                copied.dts = ticks + round(HEAD_START_S / video.time_base)
                copied.pts = copied.dts + packet.pts - packet.dts
                copied.is_keyframe = packet.is_keyframe
                print(f"{media_s:.4f} {monotonic():.5f}", flush=True)
                out.mux(copied)
                due = bisect_right(times, media_s) - 1
                if due > sent:
                    sent = due
                    body = av.Packet(metadata[due])
                    body.stream, body.time_base = data, TICKS
                    body.pts = body.dts = round((times[due] + HEAD_START_S) / TICKS)
                    out.mux(body)
            turn += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clip")
    parser.add_argument("url")
    parser.add_argument("format")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--telemetry", type=Path)
    arguments = parser.parse_args()
    while True:
        try:
            push(arguments)
        except (FFmpegError, OSError):
            sleep(0.05)


if __name__ == "__main__":
    main()
