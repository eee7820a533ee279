"""The companion's main loop: sensors in, frames out, through the loss of each of them."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from link_doubles import PATIENCE_S, Line, Rangefinder, Vehicle, free_port, running, wait_for
from queuetail.cli import main
from queuetail.errors import InputError
from queuetail.link import height
from queuetail.link.frames import Decoder, Message
from queuetail.link.messages import (
    ClockTime,
    Gimbal,
    Height,
    HeightSource,
    Lidar,
    Position,
    Sensors,
    Status,
)
from queuetail.onboard import source, sources
from queuetail.onboard.lidar import LidarSource
from queuetail.onboard.ports import SerialPort
from queuetail.onboard.sender import Sender
from queuetail.onboard.simulated import SimulatedSource, readings_of

HEAVY = ("numpy", "cv2", "av", "pydantic", "matplotlib", "PIL", "stanag4609")


class Ground:
    """Reads the other radio."""

    def __init__(self, line: Line) -> None:
        self.line = line
        self.messages: list[Message] = []
        self._decoder = Decoder()

    def run(self, stopping: threading.Event) -> None:
        while not stopping.is_set():
            self.messages += self._decoder.feed(self.line.read())

    def of(self, kind: type) -> list[Message]:
        return [m for m in self.messages if isinstance(m.quantity, kind)]


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "ttyRADIO")
    yield line
    line.unplug()


@pytest.fixture
def lidar_line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "ttyLIDAR")
    yield line
    line.unplug()


def test_each_part_may_die_and_return(
    radio: Line, lidar_line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(source, "SILENT_S", 0.8)
    monkeypatch.setattr(height, "OTHER_S", 0.5)
    monkeypatch.setattr(height, "FRESH_S", 0.5)
    port = free_port()
    vehicle, rangefinder, ground = Vehicle(port), Rangefinder(lidar_line), Ground(radio)
    said: list[str] = []
    sender = Sender(
        [sources.flight_controller(f"udpin:127.0.0.1:{port}")],
        LidarSource(str(lidar_line.name)),
        lambda: SerialPort(str(radio.name), 9600),
        9600,
        said.append,
    )

    def heard(kind: type, more: int = 3) -> None:
        count = len(ground.of(kind)) + more
        wait_for(lambda: len(ground.of(kind)) >= count, f"{kind.__name__} over the radio")

    with running(ground.run), running(rangefinder.run), running(sender.run):
        with running(vehicle.run):
            for kind in (Position, Gimbal, Height, Lidar, ClockTime, Status):
                heard(kind, 2)
            assert ground.of(Lidar)[-1].quantity == Lidar(61.42)  # not the vehicle's 95 m
            told = ground.of(Height)[-1].quantity
            assert isinstance(told, Height)
            assert told.agl_m == pytest.approx(61.42 * 0.998, abs=0.05)
            lidar_line.unplug()
            wait_for(
                lambda: ground.of(Height)[-1].quantity.source != HeightSource.LIDAR,  # type: ignore[union-attr]
                "the altitude to go on",
            )
            assert ground.of(Height)[-1].quantity.agl_m == pytest.approx(61.3, abs=0.1)  # type: ignore[union-attr]
            lidar_line.plug_in()
            heard(Lidar)
            radio.unplug()
            wait_for(lambda: any("radio is lost" in s for s in said), "the radio's loss")
            radio.plug_in()
            heard(Position)
        wait_for(
            lambda: ground.of(Status)[-1].quantity.sensors == Sensors.LIDAR,  # type: ignore[union-attr]
            "the status without the flight controller",
        )
        with running(Vehicle(port).run):
            heard(Position)
    assert sender.sent.radio_reconnects == 1
    assert any(sentence.endswith("heard") for sentence in said)


def test_a_simulated_flight_over_the_radio(radio: Line, flagger: Path) -> None:
    ground = Ground(radio)
    sender = Sender(
        [SimulatedSource(flagger)], None, lambda: SerialPort(str(radio.name), 9600), 9600
    )
    with running(ground.run):
        sent = sender.run(threading.Event(), 1.5)
        wait_for(lambda: len(ground.messages) >= sent.frames, "all messages")
    assert len(ground.of(Gimbal)) >= 10
    assert ground.of(Position)[0].quantity.lat_deg == pytest.approx(36.11, abs=1e-3)  # type: ignore[union-attr]
    assert sent.refused == 0


def test_a_hover_above_a_site_without_a_log(tmp_path: Path) -> None:
    site = tmp_path / "site.toml"
    site.write_text(
        '[camera]\nhfov_deg = 73.7\n[[approach]]\nname = "NB"\n'
        "axis = [[36.0, -97.0], [36.001, -97.0], [36.002, -97.0]]\n"
    )
    readings = readings_of(site)
    _, first = next(readings)
    _, second = next(readings)
    (place,) = [q for q in first if isinstance(q, Position)]
    assert (place.lat_deg, place.lon_deg) == (pytest.approx(36.0015), -97.0)
    assert [q for q in first if isinstance(q, Gimbal)] == [Gimbal(0.0, -90.0, 0.0)]
    assert first != second


@pytest.mark.parametrize(
    ("name", "text", "why"),
    [
        ("nothing", None, "no flight folder"),
        ("site.toml", "[site]\n", "no \\[\\[approach\\]\\]"),
        ("site.toml", "[[[", "cannot be read"),
        ("empty", "", "no telemetry.csv"),
    ],
)
def test_what_is_no_flight_is_refused(
    tmp_path: Path, name: str, text: str | None, why: str
) -> None:
    path = tmp_path / name
    if text == "":
        path.mkdir()
    elif text is not None:
        path.write_text(text)
    with pytest.raises(InputError, match=why):
        SimulatedSource(path)


@pytest.mark.parametrize(
    "words",
    [
        ["--radio", "/dev/null"],
        ["--radio", "/dev/null", "--simulate", "x", "--lidar", "/dev/y"],
        ["--radio", "/dev/null", "--simulate", "x"],
        ["--radio", "/dev/null", "--flight-controller", "udp:nowhere"],
        ["--radio", "/dev/null", "--lidar", "/dev/ttyUSB1:fast"],
    ],
)
def test_wrong_words_get_one_sentence(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["onboard", *words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("queuetail: ")
    assert told.count("\n") == 1


def test_the_command_needs_no_heavy_library_and_little_memory(radio: Line, flagger: Path) -> None:
    """In its own process, which ends cleanly on SIGTERM."""
    program = (
        "import sys; from queuetail.cli import main\n"
        f"code = main(['onboard', '--radio', {str(radio.name)!r}, '--baud', '9600',\n"
        f"             '--flight-controller', 'udpin:127.0.0.1:{free_port()}', '--lidar', '/x'])\n"
        f"print(sorted({set(HEAVY)!r} & sys.modules.keys()))\n"
        "print(int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]))\n"
        "sys.exit(code)"
    )
    ground = Ground(radio)
    with running(ground.run):
        process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE)
        try:
            wait_for(lambda: ground.of(Status), "the first message")
            process.send_signal(signal.SIGTERM)
            out, _ = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert process.returncode == 0
    summary, heavy, peak_kb = out.decode().strip().splitlines()
    assert "messages" in summary
    assert heavy == "[]"
    assert int(peak_kb) < 60_000


def test_the_library_alone_loads_nothing_heavy() -> None:
    """Also where only pyserial and pymavlink are installed: the others cannot even be imported."""
    program = (
        "import sys\n"
        f"for name in {HEAVY!r}: sys.modules[name] = None\n"
        "import queuetail.onboard.sender, queuetail.onboard.sources, queuetail.onboard.simulated\n"
        "import queuetail.onboard.lidar, queuetail.commands.onboard, queuetail.cli\n"
        "from pymavlink.dialects.v20 import common\n"
        "queuetail.cli.parser((queuetail.commands.onboard,))\n"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, timeout=60, check=False
    )
    assert run.stderr.decode() == ""
