"""A live run: the newest picture, unknown with its reason when anything fails, and back again."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from threading import Event, Lock
from time import monotonic, sleep
from typing import Any, cast

import pytest

from broadcast import Sender, free_port, write_live_clip
from queuetail.config import Site, parse_settings
from queuetail.errors import InputError
from queuetail.live import feed as feed_module
from queuetail.live.blind import blind_observation
from queuetail.live.feed import LiveFeed, NoFeed, RecordedFeed, TelemetryFeed, needs_telemetry
from queuetail.live.outlet import LiveSink
from queuetail.live.records import OutletHealth, OutletState, Published
from queuetail.live.runtime import LiveRun
from queuetail.presets import Build
from queuetail.types import Frame, Observation, QueueStatus, TelemetrySample
from queuetail.video.stream_source import parse_source

LIMIT_S = 20.0
PLACE = {"lat_deg": 36.1, "lon_deg": -97.0, "height_agl_m": 100.0, "heading_deg": 75.0}
POSE = {**PLACE, "gimbal_pitch_deg": -55.0, "hfov_deg": 84.0}


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_live_clip(tmp_path_factory.mktemp("clip") / "clip.ts", seconds=1)


class Seen:
    """A sink that keeps what was published, and when."""

    def __init__(self) -> None:
        self.got: list[Published] = []
        self.at_s: list[float] = []
        self.is_closed = False

    def offer(self, published: Published) -> None:
        self.at_s.append(monotonic())
        self.got.append(published)

    def health(self) -> OutletHealth:
        return OutletHealth("seen", OutletState.OK, len(self.got))

    def close(self) -> None:
        self.is_closed = True

    def wait(self, condition: Callable[[Published], bool], since: int = 0) -> Published:
        """Return the first answer, from number `since` on, for which the condition holds."""
        end_s, next_one = monotonic() + LIMIT_S, since
        while monotonic() < end_s:
            while next_one < len(self.got):
                if condition(self.got[next_one]):
                    return self.got[next_one]
                next_one += 1
            sleep(0.005)
        raise AssertionError(self.got[-1:])


class FakePipeline:
    """Answers "clear" after `step` has done what it likes."""

    longest_s = 0.0

    def __init__(self, step: Callable[[Frame], None]) -> None:
        self._step = step

    def step(self, frame: Frame, telemetry: TelemetrySample) -> Observation:
        self._step(frame)
        observation = blind_observation((), ("NB",), frame.t_s, "")
        states = tuple(type(s)(s.approach, QueueStatus.CLEAR, None, ()) for s in observation.states)
        return Observation(
            frame.index,
            frame.t_s,
            observation.mapping,
            observation.registration,
            observation.detections_px,
            (),
            observation.vehicles,
            states,
        )


def building(step: Callable[[Frame], None] = lambda frame: None) -> Build:
    return cast(Build, lambda *_: FakePipeline(step))


def told() -> RecordedFeed:
    return RecordedFeed(lambda t_s: TelemetrySample(t_s, **POSE), "test")


@contextmanager
def running(
    address: str, build: Build, feed: TelemetryFeed | None = None, **more: Any
) -> Iterator[tuple[LiveRun, Seen]]:
    source = parse_source(address, realtime=True, loop="://" not in address)
    source = replace(source, read_s=0.5, open_s=1.5)  # ends sooner
    run = LiveRun(source, feed or told(), build=build, **more)
    seen = Seen()
    run.subscribe(cast(LiveSink, seen))
    run.start()
    try:
        yield run, seen
    finally:
        run.stop()
    assert seen.is_closed


def status(published: Published) -> QueueStatus:
    return published.observation.states[0].status


def reasons(published: Published) -> str:
    return "; ".join(published.observation.states[0].reasons)


def test_sixty_pictures_a_second_into_thirty(tmp_path: Path) -> None:
    """Latency stays flat, and what was left out is counted."""
    clip = write_live_clip(tmp_path / "clip.ts", seconds=1, rate_hz=60)
    with running(str(clip), building(lambda frame: sleep(1 / 30))) as (run, seen):
        seen.wait(lambda p: p.observation.t_s > 2)
        health = run.health()
    assert health.frames_dropped > 25
    assert health.frames_processed + health.frames_dropped <= health.frames_captured + 2
    delays = [
        at_s - p.observation.t_s
        for p, at_s in zip(seen.got, seen.at_s, strict=True)
        if p.frame is not None
    ]
    quarter = len(delays) // 4
    assert min(delays[-quarter:]) - min(delays[:quarter]) < 0.25
    assert health.latency_p50_ms is not None
    assert health.latency_p50_ms < 500
    times = [p.observation.t_s for p in seen.got]
    assert all(b > a for a, b in pairwise(times))
    assert [p.number for p in seen.got] == list(range(1, len(seen.got) + 1))


def test_processing_that_hangs_is_noticed_and_goes_on(clip: Path) -> None:
    let_go, hung = Event(), Event()

    def step(frame: Frame) -> None:
        if frame.t_s > 0.3 and not let_go.is_set():
            hung.set()
            let_go.wait(LIMIT_S)

    with running(str(clip), building(step)) as (run, seen):
        assert hung.wait(LIMIT_S)
        stuck = seen.wait(lambda p: "processing has been stuck for" in reasons(p))
        assert status(stuck) is QueueStatus.UNKNOWN
        assert stuck.frame is None
        assert any("stuck" in w for w in run.health().warnings)
        let_go.set()
        seen.wait(lambda p: status(p) is QueueStatus.CLEAR, since=stuck.number)
        times = [p.observation.t_s for p in seen.got]
        assert times == sorted(times)


def test_answers_that_take_too_long_are_not_believed(clip: Path) -> None:
    with running(str(clip), building(lambda frame: sleep(1.2))) as (_, seen):
        seen.wait(lambda p: "processing is too slow" in reasons(p) or "too long" in reasons(p))
        assert {status(p) for p in seen.got} == {QueueStatus.UNKNOWN}


def test_a_fault_in_one_picture_ends_nothing(clip: Path) -> None:
    faults = []

    def step(frame: Frame) -> None:
        if not faults:
            faults.append(frame.index)
            raise RuntimeError("matrix is singular")

    with running(str(clip), building(step)) as (_, seen):
        answer = seen.wait(lambda p: p.frame is not None)
    assert status(answer) is QueueStatus.CLEAR
    assert any("matrix is singular" in w for w in answer.health.warnings)


def test_a_lost_stream_is_unknown_and_recovers(clip: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    site = parse_settings(
        Site, {"approach": [{"name": "NB", "axis": [(36, -97), (36.01, -97)]}]}, ""
    )
    with running(f"udp://127.0.0.1:{port}", building(), site=site) as (_, seen):
        first = seen.wait(lambda p: p.frame is None)
        assert first.observation.states[0].approach == "NB"
        assert "no picture yet" in reasons(first)
        with Sender(clip, url, "mpegts"):
            clear = seen.wait(lambda p: status(p) is QueueStatus.CLEAR)
            assert clear.session == 1
        lost = seen.wait(lambda p: "no picture for" in reasons(p))
        seen.wait(lambda p: p.number >= lost.number + 2)
        with Sender(clip, url, "mpegts") as sender:
            back = seen.wait(lambda p: p.frame is not None, since=lost.number)
            sent_s = min(sender.kill().values())
    assert back.observation.t_s > lost.observation.t_s
    assert seen.at_s[back.number - 1] - sent_s < 5  # 2 s on an idle machine: docs/live.md
    blind_s = [t for p, t in zip(seen.got, seen.at_s, strict=True) if p.frame is None]
    between = [b - a for a, b in pairwise(blind_s)]
    assert 0.3 < sorted(between)[len(between) // 2] < 1.0
    assert seen.at_s[lost.number - 1] - seen.at_s[lost.number - 2] < 3


class FakeSource:
    """A telemetry source that says what the test wants."""

    name = "fake"

    def __init__(self) -> None:
        self.say: Callable[[TelemetrySample, datetime | None, float], None] = lambda *_: None
        self.state = type("State", (), {"error": ""})

    def start(self, on_sample: Callable[[TelemetrySample, datetime | None, float], None]) -> None:
        self.say = on_sample

    def stop(self) -> None:
        pass


def test_telemetry_that_stops_makes_the_state_unknown(
    clip: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feed_module, "LIMIT_S", 0.5)
    source, heard, lock = FakeSource(), [], Lock()
    given: list[TelemetrySample] = []
    feed = LiveFeed(cast(Any, source), Site())

    def say() -> None:
        with lock:
            source.say(TelemetrySample(monotonic(), **POSE), None, monotonic())

    with running(
        str(clip),
        building(),
        feed,
        telemetry_sinks=(lambda sample, utc, name: heard.append(name),),
    ) as (run, seen):
        nowhere = seen.wait(lambda p: p.frame is not None)
        assert "has not told yet where the drone is" in reasons(nowhere)
        say()
        clear = seen.wait(lambda p: status(p) is QueueStatus.CLEAR)
        assert clear.telemetry is not None
        given.append(clear.telemetry)
        old = seen.wait(lambda p: "telemetry is" in reasons(p), since=clear.number)
        assert old.frame is not None
        assert any("has not been heard for" in w for w in run.health().warnings)
        say()
        seen.wait(lambda p: status(p) is QueueStatus.CLEAR, since=old.number)
    assert given[0].lat_deg == 36.1
    assert given[0].t_s == clear.observation.t_s
    assert heard[0] == "fake"


def test_telemetry_that_jumps_or_runs_backwards_is_not_followed(clip: Path) -> None:
    source = FakeSource()
    feed = LiveFeed(cast(Any, source), Site())
    with running(str(clip), building(), feed) as (_, seen):
        for step in range(60):
            now_s = monotonic()
            lat = 36.1 if step % 10 else 35.0  # 120 km away for one sample
            back_s = 5.0 if step % 7 == 6 else 0.0
            sample = TelemetrySample(now_s - back_s, **{**POSE, "lat_deg": lat})
            if step:
                source.say(sample, None, now_s)
            sleep(0.02)
        seen.wait(lambda p: status(p) is QueueStatus.CLEAR)
    places = {p.telemetry.lat_deg for p in seen.got if p.telemetry is not None}
    assert places <= {36.1, None}


def test_a_site_file_of_another_place_is_named(clip: Path) -> None:
    axis = [[41.1, -97.0], [41.2, -97.0]]
    site = parse_settings(Site, {"approach": [{"name": "NB", "axis": axis}]}, "")
    with running(str(clip), building(), told(), site=site) as (_, seen):
        answer = seen.wait(lambda p: p.frame is not None)
    assert status(answer) is QueueStatus.UNKNOWN
    assert "km from the site file's road: is it the file of another place?" in reasons(answer)


def test_a_sink_that_fails_harms_nobody(clip: Path) -> None:
    class Broken(Seen):
        def offer(self, published: Published) -> None:
            raise OSError("gone")

        def close(self) -> None:
            super().close()
            raise OSError("still gone")

    broken = Broken()
    source = parse_source(str(clip), realtime=True)
    run, seen = LiveRun(source, told(), build=building()), Seen()
    run.subscribe(cast(LiveSink, broken))
    run.subscribe(cast(LiveSink, seen))
    run.start()
    assert run.ended.wait(LIMIT_S)  # at the end of the file
    run.stop()
    run.stop()
    assert seen.is_closed
    assert broken.is_closed
    assert len(seen.got) > 10


def test_a_site_that_does_not_fit_is_refused(clip: Path) -> None:
    def build(*_: object) -> Any:
        raise InputError("[[control_point]]: all in one line")

    source = parse_source(str(clip), realtime=True)
    run = LiveRun(source, told(), build=cast(Build, build))
    run.start()
    assert run.ended.wait(LIMIT_S)
    run.stop()
    assert "all in one line" in str(run.refused)


def test_what_a_site_leaves_to_telemetry() -> None:
    assert needs_telemetry(Site())
    fixed = {"telemetry": {k: v for k, v in POSE.items() if k != "hfov_deg"}}
    assert not needs_telemetry(parse_settings(Site, {**fixed, "camera": {"hfov_deg": 84}}, ""))
    assert NoFeed().too_old(cast(Any, None)) == ()
