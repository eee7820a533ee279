"""Stand-ins for what hangs on the telemetry link: lines, a rangefinder, a vehicle, a broker."""

from __future__ import annotations

import math
import os
import select
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common

from queuetail.link.messages import Quantity
from queuetail.onboard.source import Stamp

PATIENCE_S = 20.0  # for a loaded machine; nothing here takes a tenth of it on an idle one


def wait_for(condition: Callable[[], Any], what: str) -> Any:
    """Return the condition's value as soon as it is true."""
    end_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < end_s:
        if value := condition():
            return value
        time.sleep(0.005)
    raise AssertionError(f"waited in vain: {what}")


class Heard:
    """Keeps what a source delivers."""

    def __init__(self) -> None:
        self.pairs: list[tuple[Quantity, Stamp]] = []

    def __call__(self, quantity: Quantity, stamp: Stamp) -> None:
        self.pairs.append((quantity, stamp))

    def of(self, kind: type) -> list[Any]:
        return [quantity for quantity, _ in self.pairs if isinstance(quantity, kind)]


class Line:
    """A serial line behind a fixed name, which can be unplugged and plugged in again."""

    def __init__(self, name: Path) -> None:
        self.name = name
        self.master = -1
        self._slave = -1
        self.plug_in()

    def plug_in(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.name.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        if self.master < 0:
            return
        self.name.unlink()
        master, self.master = self.master, -1
        os.close(master)
        os.close(self._slave)

    def read(self, timeout_s: float = 0.02) -> bytes:
        """Return what was written to the device within a moment."""
        master = self.master
        try:
            if master >= 0 and select.select([master], [], [], timeout_s)[0]:
                return os.read(master, 4096)
        except (OSError, ValueError):
            pass
        return b""

    def write(self, data: bytes) -> None:
        """Let the device say something."""
        if self.master >= 0:
            os.write(self.master, data)


@contextmanager
def running(loop: Callable[[threading.Event], None]) -> Iterator[None]:
    """Run a loop in a thread until the block ends."""
    stopping = threading.Event()
    thread = threading.Thread(target=loop, args=(stopping,), daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join(PATIENCE_S)


class Rangefinder:
    """An LW20/C by its manual: the first command after power-up gets no answer."""

    def __init__(self, line: Line, answers: dict[bytes, bytes] | None = None) -> None:
        self.line = line
        self.range_text = b"61.42"
        self.is_mute = False
        self.asked: list[bytes] = []
        self._is_awake = False
        self._answers = answers

    def run(self, stopping: threading.Event) -> None:
        pending = b""
        while not stopping.is_set():
            *commands, pending = (pending + self.line.read()).split(b"\r\n")
            for command in commands:
                self.asked.append(command)
                if not self._is_awake:
                    self._is_awake = True
                    continue
                if not self.is_mute:
                    self.line.write(self._answer(command))

    def _answer(self, command: bytes) -> bytes:
        if command == b"?P":
            return b"p:LW20,1.2,1.5\r\n"
        if command.startswith((b"?LDF,", b"?LDL,")):
            if self._answers is not None:
                return self._answers.get(command, b"")
            return command[1:].lower() + b":" + self.range_text + b"\r\n"
        return b"?\r\n"


class Vehicle:
    """A small MAVLink vehicle that hovers and turns, and sends over UDP."""

    def __init__(self, port: int, system: int = 1) -> None:
        self.dialect = common
        self.mav = common.MAVLink(self, system, 1)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.settimeout(0.001)
        self.port = port
        self.started_s = time.monotonic() - 7.0  # it was switched on before
        self.requests: list[int] = []
        self.beats = 0
        self.messages = 0
        self.yaw_deg, self.pitch_deg = 75.0, -55.0
        self.gimbal_flags = common.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        self.is_mute = False

    def write(self, data: bytes) -> None:
        self.socket.sendto(data, ("127.0.0.1", self.port))

    def run(self, stopping: threading.Event) -> None:
        while not stopping.wait(0.02):
            if not self.is_mute:
                self.send()
            self.listen()
        self.socket.close()

    def send(self) -> None:
        boot_ms = int((time.monotonic() - self.started_s) * 1000)
        mav, d = self.mav, self.dialect
        roll, pitch, yaw = math.radians(2), math.radians(-3), math.radians(self.yaw_deg)
        mav.heartbeat_send(d.MAV_TYPE_QUADROTOR, d.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 0)
        mav.attitude_send(boot_ms, roll, pitch, yaw, 0, 0, 0)
        mav.global_position_int_send(
            boot_ms, 361101897, -970575359, 402_500, 110_250, 0, 0, 0, int(self.yaw_deg * 100)
        )
        half = math.radians(self.pitch_deg) / 2
        q = [math.cos(half), 0.0, math.sin(half), 0.0]
        mav.gimbal_device_attitude_status_send(
            0, 0, boot_ms, self.gimbal_flags, q, 0, 0, 0, 0, math.nan, math.nan, 0
        )
        mav.distance_sensor_send(boot_ms, 20, 10_000, 9_500, 0, 0, 25, 0)
        mav.distance_sensor_send(boot_ms, 20, 10_000, 300, 0, 1, 0, 0)  # looks ahead
        mav.system_time_send(int(time.time() * 1e6), boot_ms)
        mav.camera_fov_status_send(boot_ms, 0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 84.0, 53.0)
        self.messages += 8

    def listen(self) -> None:
        try:
            data = self.socket.recv(4096)
        except OSError:
            return
        for message in self.mav.parse_buffer(data) or ():
            if message.get_type() == "COMMAND_LONG":
                self.requests.append(int(message.param1))
            elif message.get_type() == "HEARTBEAT":
                self.beats += 1


def free_port(kind: int = socket.SOCK_DGRAM) -> int:
    """Return a port of the loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def broker(program: str, folder: Path, port: int) -> Iterator[None]:
    """Run mosquitto on a port of the loopback."""
    settings = folder / "mosquitto.conf"
    settings.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n")
    process = subprocess.Popen(
        [program, "-c", str(settings)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    try:
        wait_for(lambda: _answers(port), "mosquitto to listen")
        yield
    finally:
        process.terminate()
        process.wait(PATIENCE_S)


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), timeout=1).close()
    except OSError:
        return False
    return True
