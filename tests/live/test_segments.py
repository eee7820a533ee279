"""Video segments: remuxed as they came, playable up to where they were cut."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest
from live_run import stream_info

from queuetail.live.outlet import StreamInfo
from queuetail.live.segments import (
    VideoSegments,
    read_packets,
    segment_name,
    segment_paths,
    source_time_s,
)
from queuetail.types import Observation

START = datetime(2026, 5, 14, tzinfo=UTC)
KLV = bytes.fromhex("060e2b34020b01010e01030101000000") + bytes(30)


def written(source: Path, folder: Path, segment_s: float, limit: int = 10**6) -> VideoSegments:
    """Write a file's first packets as if they arrived at their times."""
    segments = VideoSegments(folder, segment_s)
    with av.open(str(source)) as container:
        streams = [*container.streams.video, *container.streams.data]
        infos = {s.index: info_of(s) for s in streams}
        for count, packet in enumerate(container.demux(streams)):
            if count == limit:
                break
            if packet.size:
                at_s = float((packet.dts or 0) * (packet.time_base or 0))
                segments.write(packet, infos[packet.stream_index], START + timedelta(seconds=at_s))
    return segments


def info_of(stream: av.stream.Stream) -> StreamInfo:
    if isinstance(stream, av.VideoStream):
        return stream_info(stream, 0)
    keeper = av.open("/dev/null", "w", format="mpegts")
    assert stream.time_base is not None
    template = keeper.add_stream_from_template(stream)
    return StreamInfo(0, stream.index, "data", "klv", stream.time_base, template)


def make_video(path: Path, codec: str, pix_fmt: str, *, with_klv: bool = False) -> None:
    """Write two seconds of a moving picture, perhaps with a KLV packet every half second."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=30, width=64, height=48, pix_fmt=pix_fmt)
        assert isinstance(stream, av.VideoStream)
        stream.codec_context.gop_size = 15
        data = container.add_data_stream("klv") if with_klv else None
        for k in range(60):
            picture = np.full((48, 64, 3), 4 * k, np.uint8)
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format=pix_fmt)
            frame.pts = k
            if data is not None and k % 15 == 0:
                packet = av.Packet(KLV)
                packet.stream, packet.time_base = data, Fraction(1, 30)
                packet.pts = packet.dts = k
                container.mux(packet)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def pictures(path: Path) -> list[bytes]:
    with av.open(str(path)) as container:
        return [f.to_ndarray(format="gray").tobytes() for f in container.decode(video=0)]


@pytest.mark.parametrize(
    ("codec", "pix_fmt", "suffix", "kind"),
    [
        ("libx264", "yuv420p", ".mp4", "ts"),
        ("mpeg4", "yuv420p", ".mp4", "nut"),
        ("mjpeg", "yuvj422p", ".mkv", "nut"),
        ("rawvideo", "yuyv422", ".nut", "nut"),
    ],
)
def test_pictures_and_their_times_come_back(
    tmp_path: Path, codec: str, pix_fmt: str, suffix: str, kind: str
) -> None:
    source = tmp_path / f"source{suffix}"
    make_video(source, codec, pix_fmt)
    written(source, tmp_path, 100.0).close()
    (path,) = segment_paths(tmp_path)[0]
    assert path.name == segment_name(0, 1, kind)
    assert pictures(path) == pictures(source)
    with av.open(str(path)) as container, av.open(str(source)) as original:
        times = [source_time_s(f.time or 0.0) for f in container.decode(video=0)]
        np.testing.assert_allclose(times, [f.time for f in original.decode(video=0)], atol=0.6e-3)


def test_klv_stays_beside_the_picture(tmp_path: Path) -> None:
    source = tmp_path / "source.ts"
    make_video(source, "libx264", "yuv420p", with_klv=True)
    written(source, tmp_path, 100.0).close()
    (path,) = segment_paths(tmp_path)[0]
    with av.open(str(path)) as container:
        packets = [bytes(p) for p in container.demux(container.streams.data[0]) if p.size]
    assert packets == [KLV] * 4


def test_segments_begin_with_key_pictures(recorded: tuple[Path, list[Observation]]) -> None:
    sessions = segment_paths(recorded[0])
    assert sorted(sessions) == [0, 1]
    for path in [p for found in sessions.values() for p in found]:
        first = next(read_packets(path))
        assert first.is_keyframe


def test_a_cut_segment_plays_up_to_the_cut(
    recorded: tuple[Path, list[Observation]], tmp_path: Path
) -> None:
    whole = segment_paths(recorded[0])[0][0].read_bytes()
    counts = []
    for share in (0.0, 0.001, 0.31, 0.62, 0.93):
        path = tmp_path / "cut.ts"
        path.write_bytes(whole[: int(share * len(whole))])
        counts.append(len(list(read_packets(path))))
    assert counts[0] == 0
    assert counts == sorted(counts)
    assert counts[-1] > 0.8 * 60


def test_a_clock_that_jumps_back_begins_a_new_segment(tmp_path: Path) -> None:
    source = tmp_path / "source.mp4"
    make_video(source, "libx264", "yuv420p")
    segments = VideoSegments(tmp_path, 100.0)
    for lap in range(2):
        with av.open(str(source)) as container:
            stream = container.streams.video[0]
            info = stream_info(stream, 0)
            for packet in container.demux(stream):
                if packet.size:
                    segments.write(packet, info, START + timedelta(seconds=lap))
    segments.close()
    assert segments.skipped == 0
    assert [len(list(read_packets(p))) for p in segment_paths(tmp_path)[0]] == [60, 60]


def test_what_was_flushed_plays_while_writing_goes_on(flagger: Path, tmp_path: Path) -> None:
    segments = written(flagger / "flight.mp4", tmp_path, 100.0, limit=120)
    segments.flush()
    (path,) = segment_paths(tmp_path)[0]
    assert len(list(read_packets(path))) >= 118
    segments.abandon()
