"""A camera for tests and figures of live video: pushes a clip to wherever FFmpeg can write.

It is a program of its own, so that it can be stopped, continued and killed like a real one:
``python benchmarks/broadcast.py CLIP URL FORMAT``; it prints each picture's time, and when that was
sent on the monotonic clock.
"""

from __future__ import annotations

import argparse
import csv
import signal
import socket
import subprocess
import sys
import tempfile
from bisect import bisect_right
from datetime import UTC, datetime
from fractions import Fraction
from pathlib import Path
from time import monotonic, sleep, time

import av
import numpy as np
from av.error import FFmpegError
from av.video.frame import VideoFrame
from av.video.stream import VideoStream
from stanag4609.st0601 import encode_uas_local_set
from stanag4609.st0604 import encode_avc_timestamp_sei

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


def write_live_flight(source: Path, path: Path, group: int = 30) -> Path:
    """Encode a recording anew as a camera sends it: no B-frames, a key frame every second."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(source)) as flight, av.open(str(path), "w") as out:
        video = flight.streams.video[0]
        stream = out.add_stream("libx264", rate=video.average_rate)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height, stream.pix_fmt = video.width, video.height, "yuv420p"
        stream.options = {"preset": "veryfast", "tune": "zerolatency", "crf": "23"}
        stream.options |= {"g": str(group), "x264-params": "log-level=none"}
        for frame in flight.decode(video):
            frame.pict_type = 0  # the encoder decides
            out.mux(stream.encode(frame))
        out.mux(stream.encode(None))
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
        stamp: bool = False,
        begin_at_s: float | None = None,
    ) -> None:
        """Start sending at once, over and over; `telemetry` goes along as KLV.

        `stamp` puts into every picture when it was sent, as MISB ST 0604 has it; the first picture
        waits until `begin_at_s` of the monotonic clock.
        """
        command = [sys.executable, __file__, str(clip), url, container_format]
        command += ["--speed", str(speed)]
        if telemetry is not None:
            command += ["--telemetry", str(telemetry)]
        if stamp:
            command += ["--stamp"]
        if begin_at_s is not None:
            command += ["--begin-at", str(begin_at_s)]
        self._log = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115 - until killed
        self._process = subprocess.Popen(command, stdout=self._log, stderr=subprocess.DEVNULL)

    def pause(self) -> None:
        """Stop in mid-stream, with the connection open."""
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """Continue after a pause."""
        self._process.send_signal(signal.SIGCONT)

    def kill(self) -> dict[float, float]:
        """Kill it and return when each picture was sent: its time, and the monotonic clock."""
        self._process.kill()
        self._process.wait(10)
        with self._log as log:
            log.seek(0)
            pairs = [line.split() for line in log.read().splitlines()[:-1]]
        return {float(media_s): float(sent_s) for media_s, sent_s in pairs}

    def __enter__(self) -> Sender:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self.kill()


def klv_values(telemetry: Path) -> tuple[list[float], list[dict[int, float]]]:
    """Return the values of an ST 0601 packet for each line of our own table, and their times."""
    times, values = [], []
    with telemetry.open(encoding="utf-8") as file:
        for row in csv.DictReader(file):
            times.append(float(row["t_s"]))
            values.append(
                {
                    **{5: float(row["heading_deg"]) % 360.0, 6: 0.0, 7: 0.0},
                    **{13: float(row["lat"]), 14: float(row["lon"])},
                    **{15: 300.0 + float(row["height_agl_m"]), 16: float(row["hfov_deg"])},
                    **{18: 0.0, 19: float(row["gimbal_pitch_deg"]), 20: 0.0, 25: 300.0, 65: 19},
                }
            )
    return times, values


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
        times, values = klv_values(arguments.telemetry) if arguments.telemetry else ([], [])
        if arguments.telemetry:
            data = out.add_data_stream("klv")
        packets = [p for p in clip.demux(video) if p.dts is not None]
        assert video.time_base is not None
        loop = packets[-1].dts - packets[0].dts + packets[1].dts - packets[0].dts
        start_s, first, turn, sent = monotonic(), packets[0].dts, 0, (-1, -1)
        start_s = max(start_s, arguments.begin_at or start_s)
        while True:
            for packet in packets:
                ticks = packet.dts - first + turn * loop
                media_s = float(ticks * video.time_base)
                sleep(max(start_s + media_s / arguments.speed - monotonic(), 0.0))
                body = bytes(packet)
                if arguments.stamp:
                    body = encode_avc_timestamp_sei(round(1e6 * time())) + body
                copied = av.Packet(body)
                copied.stream, copied.time_base = copy, video.time_base
                copied.dts = ticks + round(HEAD_START_S / video.time_base)
                copied.pts = copied.dts + packet.pts - packet.dts
                copied.is_keyframe = packet.is_keyframe
                print(f"{media_s:.4f} {monotonic():.5f}", flush=True)
                out.mux(copied)
                turn_s = float(turn * loop * video.time_base)
                due = bisect_right(times, media_s - turn_s) - 1
                if due >= 0 and (turn, due) != sent:
                    sent = turn, due
                    beside = av.Packet(encode_uas_local_set({2: datetime.now(UTC), **values[due]}))
                    beside.stream, beside.time_base = data, TICKS
                    beside.pts = beside.dts = round((turn_s + times[due] + HEAD_START_S) / TICKS)
                    out.mux(beside)
            turn += 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clip")
    parser.add_argument("url")
    parser.add_argument("format")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--telemetry", type=Path)
    parser.add_argument("--stamp", action="store_true")
    parser.add_argument("--begin-at", type=float)
    arguments = parser.parse_args()
    while True:
        try:
            push(arguments)
        except (FFmpegError, OSError):
            sleep(0.05)


if __name__ == "__main__":
    main()
