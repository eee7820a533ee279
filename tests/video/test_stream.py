"""Live video from real senders: whatever happens to them, the newest picture comes through."""

from __future__ import annotations

import gc
import os
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from threading import Event, Thread
from time import monotonic
from typing import Any

import av
import pytest
from av.sidedata.sidedata import SideDataContainer

from broadcast import HEAD_START_S, Sender, free_port, write_live_clip
from queuetail.live.outlet import StreamInfo
from queuetail.video.stream import Link, LiveVideo
from queuetail.video.stream_session import Captured, Metadata
from queuetail.video.stream_source import parse_source

LIMIT_S = 20.0
TELEMETRY = """t_s,lat,lon,height_agl_m,heading_deg,gimbal_pitch_deg,gimbal_roll_deg,hfov_deg
0.0,36.1,-97.0,100.0,75.0,-55.0,0.0,84.0
0.1,36.1,-97.0,100.0,75.0,-55.0,0.0,84.0
0.2,36.1,-97.0,100.0,75.0,-55.0,0.0,84.0
"""


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_live_clip(tmp_path_factory.mktemp("clip") / "clip.ts", seconds=1)


class Viewer:
    """Keeps what a stream delivers."""

    def __init__(
        self, address: str, slow_s: float = 0.0, read_s: float = 0.5, **settings: object
    ) -> None:
        self.got: list[Captured] = []
        self.at_s: list[float] = []
        self.metadata: list[Metadata] = []
        self._slow_s = slow_s
        self._never = Event()
        source = parse_source(address, realtime=True, loop=bool(settings.pop("loop", False)))
        source = replace(source, read_s=read_s, open_s=min(source.open_s, 1.5))  # ends sooner
        self.video = LiveVideo(source, self._take, self.metadata.append, **settings)  # type: ignore[arg-type]

    def _take(self, captured: Captured) -> None:
        self.at_s.append(monotonic())
        self.got.append(captured)
        if self._slow_s:
            self._never.wait(self._slow_s)

    def wait(self, condition: Callable[[], bool]) -> None:
        end_s = monotonic() + LIMIT_S
        while not condition():
            assert monotonic() < end_s, self.video.status()
            self._never.wait(0.005)

    def wait_for(self, count: int) -> None:
        self.wait(lambda: len(self.got) >= count)


@contextmanager
def viewing(address: str, **settings: object) -> Iterator[Viewer]:
    viewer = Viewer(address, **settings)  # type: ignore[arg-type]
    viewer.video.start()
    try:
        yield viewer
    finally:
        viewer.video.close()


def udp_port() -> int:
    return free_port(socket.SOCK_DGRAM)


def test_udp_with_klv_gives_pictures_metadata_and_their_utc(clip: Path, tmp_path: Path) -> None:
    table = tmp_path / "telemetry.csv"
    table.write_text(TELEMETRY)
    port = udp_port()
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    with viewing(f"udp://127.0.0.1:{port}") as viewer:
        with Sender(clip, url, "mpegts", telemetry=table):
            viewer.wait_for(30)
            viewer.wait(lambda: bool(viewer.metadata))
        late = [c for c in viewer.got if c.has_embedded_utc]
        assert late
        assert abs((late[-1].utc - datetime.now(UTC)).total_seconds()) < 30
    assert viewer.metadata[0].packets[0].values[13] == pytest.approx(36.1)
    steps = [b.frame.t_s - a.frame.t_s for a, b in pairwise(viewer.got)]
    assert all(abs(step * 30 - round(step * 30)) < 0.01 for step in steps)  # whole pictures apart
    assert viewer.got[0].frame.size == (160, 96)
    assert all(c.captured_s <= c.arrived_s for c in viewer.got)


def test_the_time_inside_the_pictures_counts(clip: Path) -> None:
    port = udp_port()
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    with viewing(f"udp://127.0.0.1:{port}") as viewer, Sender(clip, url, "mpegts", stamp=True):
        viewer.wait_for(10)
        now = datetime.now(UTC)
    assert all(c.has_embedded_utc for c in viewer.got)
    assert abs((viewer.got[9].utc - now).total_seconds()) < 5
    times = [c.utc for c in viewer.got]
    assert times == sorted(set(times))


def test_pictures_are_let_go_without_the_garbage_collector(clip: Path) -> None:
    port = udp_port()
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    gc.collect()
    before = sum(isinstance(o, SideDataContainer) for o in gc.get_objects())
    gc.disable()
    try:
        with viewing(f"udp://127.0.0.1:{port}") as viewer, Sender(clip, url, "mpegts"):
            viewer.wait_for(20)
        after = sum(isinstance(o, SideDataContainer) for o in gc.get_objects())
    finally:
        gc.enable()
    assert after == before


def test_rtmp_is_waited_for(clip: Path) -> None:
    url = f"rtmp://127.0.0.1:{free_port()}/live/drone"
    with viewing(f"{url}?listen") as viewer, Sender(clip, url, "flv"):
        viewer.wait_for(10)
        assert viewer.video.status().link is Link.OPEN


def test_tcp_keeps_up_when_its_reader_is_slow(tmp_path: Path) -> None:
    """60 pictures a second to one who takes 25 ms for each: it leaves some out, and stays live."""
    clip = write_live_clip(tmp_path / "clip.ts", rate_hz=60)
    url = f"tcp://127.0.0.1:{free_port()}"
    with viewing(f"{url}?listen", slow_s=0.025) as viewer, Sender(clip, url, "mpegts") as sender:
        viewer.wait(lambda: viewer.video.status().skipped > 40)
        sent = sender.kill()
    delays = []
    for captured, at_s in zip(viewer.got, viewer.at_s, strict=True):
        media_s = captured.pts_s - HEAD_START_S
        delays += [at_s - sent_s for m, sent_s in sent.items() if abs(m - media_s) < 0.004]
    assert len(delays) > 30
    assert min(delays[-10:]) < 2.0  # it would grow by 0.3 s every second


def test_a_camera_and_its_server_come_back_after_a_kill(clip: Path) -> None:
    rtp = pytest.importorskip("tstrans.rtp")
    place = f"127.0.0.1:{free_port()}"
    url = f"rtsp://{place}/live"
    config = rtp.RtspServerConfig(bind_addr=place, accept_unregistered_publishers=True)

    def serve() -> Any:
        server = rtp.RtspServer.start(config)
        server.add_publish_mount("/live")
        return server

    server = serve()
    with viewing(url) as viewer:
        with Sender(clip, url, "rtsp"):
            viewer.wait_for(15)
        server.stop(drain_ms=0)
        viewer.wait(lambda: bool(viewer.video.status().reason))
        count, server = len(viewer.got), serve()
        with Sender(clip, url, "rtsp") as sender:
            viewer.wait_for(count + 5)
            first_sent_s = min(sender.kill().values())
    last, again = viewer.got[count - 1], viewer.got[count]
    assert again.session > last.session
    assert viewer.at_s[count] - first_sent_s < 5  # 2 s on an idle machine: docs/live.md
    real_s = viewer.at_s[count] - viewer.at_s[count - 1]
    assert again.frame.t_s - last.frame.t_s == pytest.approx(real_s, abs=0.8)
    Thread(target=server.stop, daemon=True).start()  # it takes its three seconds


def test_after_a_pause_time_is_real_time(clip: Path) -> None:
    port = udp_port()
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    with (
        viewing(f"udp://127.0.0.1:{port}", read_s=2.0) as viewer,
        Sender(clip, url, "mpegts") as sender,
    ):
        viewer.wait_for(15)
        sender.pause()
        viewer.wait(lambda: monotonic() - viewer.at_s[-1] > 1.2)
        count = len(viewer.got)
        sender.go_on()
        viewer.wait_for(count + 35)
    times = [c.frame.t_s for c in viewer.got]
    assert times == sorted(times)
    real_s = viewer.at_s[-1] - viewer.at_s[0]
    assert times[-1] - times[0] == pytest.approx(real_s, abs=1.0)


def test_the_packets_can_be_written_again_as_they_came(clip: Path, tmp_path: Path) -> None:
    kept: list[tuple[av.Packet, StreamInfo, datetime]] = []
    with viewing(
        str(clip), packet_sinks=(lambda packet, info, utc: kept.append((packet, info, utc)),)
    ) as viewer:
        viewer.wait(lambda: viewer.video.status().link is Link.ENDED)
    assert kept[0][1].kind == "video"
    assert kept[0][1].codec == "h264"
    copy_path = tmp_path / "copy.ts"
    with av.open(str(copy_path), "w") as container:
        stream = container.add_stream_from_template(kept[0][1].template)
        for packet, _, _ in kept:
            packet.stream = stream
            container.mux(packet)
    with av.open(str(copy_path)) as copy, av.open(str(clip)) as whole:
        pairs = zip(copy.decode(video=0), whole.decode(video=0), strict=True)
        assert all(bytes(a.planes[0]) == bytes(b.planes[0]) for a, b in pairs)


def test_a_file_is_paced_and_loops(clip: Path) -> None:
    with viewing(str(clip), loop=True) as viewer:
        viewer.wait_for(40)
    sessions = [c.session for c in viewer.got]
    assert sessions[0] == 1
    assert sessions[-1] == 2
    assert viewer.got[30].media_s == 0
    times = [c.frame.t_s for c in viewer.got]
    assert times == sorted(set(times))
    assert [c.frame.index for c in viewer.got] == list(range(len(viewer.got)))
    assert viewer.at_s[29] - viewer.at_s[0] == pytest.approx(29 / 30, abs=0.8)


def test_srt_comes_through_a_process_that_ends_with_us(
    clip: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plumbing only: a stand-in for ffmpeg passes a clip on and then waits."""
    program, told = tmp_path / "ffmpeg", tmp_path / "told"
    program.write_text(f'#!/bin/sh\necho "$$ $@" > {told}\ncat {clip}\nexec sleep 60\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with viewing("srt://127.0.0.1:9000?mode=listener") as viewer:
        viewer.wait_for(20)
    process_id, *words = told.read_text().split()
    assert "srt://127.0.0.1:9000?mode=listener" in words
    assert not Path(f"/proc/{process_id}").exists()


def test_nobody_there_is_said_and_tried_again() -> None:
    address = f"rtsp://127.0.0.1:{free_port()}/live"
    with viewing(address) as viewer:
        viewer.wait(lambda: "Connection refused" in viewer.video.status().reason)
        assert viewer.video.status().link is Link.CONNECTING


def test_frames_outlive_their_stream(clip: Path) -> None:
    with viewing(str(clip)) as viewer:
        viewer.wait_for(5)
        before = [c.frame.luma.copy() for c in viewer.got[:5]]
    for captured, luma in zip(viewer.got, before, strict=False):
        assert (captured.frame.luma == luma).all()
        assert captured.frame.bgr(80, 48).shape == (48, 80, 3)
