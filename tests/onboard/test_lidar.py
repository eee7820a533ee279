"""The LW20/C: polled by its own manual's words, woken up, silent, unplugged, back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from link_doubles import Heard, Line, Rangefinder, running, wait_for
from queuetail.link.messages import Lidar
from queuetail.onboard import lidar
from queuetail.onboard.lidar import LidarSource, range_of


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "ttyLIDAR")
    yield line
    line.unplug()


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (b"ldf,0:61.42\r", Lidar(61.42)),
        (b"ldl,2:100.5", Lidar(100.5)),
        (b"\x00\xffLDF,1: 3.07", Lidar(3.07)),
        (b"ldf,0:130.00", Lidar(None)),
        (b"ldf,0:160.00", Lidar(None)),
        (b"ldf,0:230.00", Lidar(None)),
        (b"ldf,0:250.00", Lidar(None)),
        (b"ldf,0:-1.00", Lidar(None)),
        (b"ldf,0:0.00", Lidar(None)),
        (b"ldf,0:", None),
        (b"p:LW20,1.0,1.0", None),
        (b"?", None),
        (b"", None),
    ],
)
def test_answers(answer: bytes, expected: Lidar | None) -> None:
    assert range_of(answer) == expected


def test_it_is_woken_and_polled(line: Line) -> None:
    device, heard = Rangefinder(line), Heard()
    source = LidarSource(str(line.name))
    with running(device.run):
        source.start(heard)
        wait_for(lambda: len(heard.pairs) >= 5, "five ranges")
        device.range_text = b"230.00"
        wait_for(lambda: heard.of(Lidar)[-1].range_m is None, "the lost signal")
        source.stop()
    assert heard.of(Lidar)[0] == Lidar(61.42)
    assert device.asked[:2] == [b"www", b"?P"]
    assert device.asked[2] == b"?LDL,2"
    assert source.product == "LW20,1.2,1.5"
    assert source.state.is_heard


def test_the_first_return_is_asked_where_the_last_is_not_known(line: Line) -> None:
    device, heard = Rangefinder(line, {b"?LDF,0": b"ldf,0:12.00\r\n"}), Heard()
    source = LidarSource(str(line.name))
    with running(device.run):
        source.start(heard)
        wait_for(lambda: heard.pairs, "a range by the other query")
        source.stop()
    assert heard.of(Lidar)[0] == Lidar(12.0)


def test_it_comes_back_after_it_was_unplugged(line: Line) -> None:
    heard = Heard()
    device = Rangefinder(line)
    source = LidarSource(str(line.name))
    with running(device.run):
        source.start(heard)
        wait_for(lambda: heard.pairs, "a range")
        line.unplug()
        wait_for(lambda: source.state.error, "the loss to be seen")
        count = len(heard.pairs)
        line.plug_in()
        wait_for(lambda: len(heard.pairs) > count, "a range after it came back")
        source.stop()
    assert source.state.reconnects >= 1


def test_a_device_that_falls_silent_is_opened_anew(
    line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lidar, "GIVE_UP_S", 0.5)
    device, heard = Rangefinder(line), Heard()
    source = LidarSource(str(line.name))
    with running(device.run):
        source.start(heard)
        wait_for(lambda: heard.pairs, "a range")
        device.is_mute = True
        wait_for(lambda: "does not answer" in source.state.error, "the silence to be said")
        device.is_mute = False
        count = len(heard.pairs)
        wait_for(lambda: len(heard.pairs) > count, "a range after the silence")
        source.stop()


def test_no_device_is_no_end(tmp_path: Path) -> None:
    source = LidarSource(str(tmp_path / "nothing"))
    source.start(Heard())
    wait_for(lambda: source.state.error, "the missing device to be said")
    assert not source.has_ended
    source.stop()
    assert not source.state.is_heard
