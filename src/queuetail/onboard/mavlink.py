"""A flight controller that speaks MAVLink over serial, UDP or TCP, through pymavlink.

Only the generated dialect is loaded: pymavlink's own connections would bring numpy along.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from queuetail.link.mavlink import MavlinkReader
from queuetail.onboard.ports import Port
from queuetail.onboard.source import Source

BEAT_S = 1.0
MISSING_S = 3.0  # what the vehicle does not send by itself by then is asked for
ASK_AGAIN_S = 5.0
TIMES_ASKED = 3
OTHER_VEHICLE_S = 5.0  # after so long without the first vehicle, another one may speak
AUTOPILOT, BROADCAST = 1, 0
# Our system and component numbers.  Not 255, the pilot's: our heartbeats, which say that they come
# from an onboard controller, must not stand in for a ground station that was lost.
ONBOARD_COMPUTER, LISTENER = (1, 191), (245, 190)
# Names and rates; either of the gimbal messages will do, so only the current one is asked for.
ASKED_HZ = {
    "GLOBAL_POSITION_INT": 10.0,
    "ATTITUDE": 10.0,
    "GIMBAL_DEVICE_ATTITUDE_STATUS": 10.0,
    "DISTANCE_SENSOR": 10.0,
    "SYSTEM_TIME": 1.0,
    "CAMERA_FOV_STATUS": 1.0,
}


class _Writer:
    """What pymavlink writes its own messages to."""

    def __init__(self, port: Port) -> None:
        self._port = port

    def write(self, data: bytes) -> None:
        self._port.write(data)


class MavlinkSource(Source):
    """Hears one vehicle; it asks for messages that the vehicle does not send by itself."""

    def __init__(
        self, name: str, open_port: Callable[[], Port], identity: tuple[int, int] = ONBOARD_COMPUTER
    ) -> None:
        super().__init__(name)
        self._open_port = open_port
        self._identity = identity
        self._vehicle: int | None = None
        self._vehicle_s = 0.0

    def _session(self) -> bool:
        from pymavlink.dialects.v20 import (  # type: ignore[import-untyped]  # noqa: PLC0415
            common,
        )

        port = self._open_port()
        try:
            mav = common.MAVLink(_Writer(port), *self._identity)
            mav.robust_parsing = True  # noise between messages is skipped, not raised
            self._listen(port, mav, common)
        finally:
            port.close()
        return True

    def _listen(self, port: Port, mav: Any, dialect: Any) -> None:
        reader = MavlinkReader()
        seen: set[str] = set()
        beat_s = 0.0
        asking = _Asking(mav, dialect)
        while not self._stopping.is_set():
            data = port.read()
            arrived_s = time.monotonic()
            if arrived_s - beat_s >= BEAT_S:
                beat_s = arrived_s
                mav.heartbeat_send(
                    dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 0
                )
                asking.ask(self._vehicle, seen, arrived_s)
            for message in (mav.parse_buffer(data) or ()) if data else ():
                if message.get_type() == "BAD_DATA":
                    continue
                if self._is_ours(message, arrived_s):
                    seen.add(message.get_type())
                    self._take(message, reader, arrived_s)

    def _take(self, message: Any, reader: MavlinkReader, arrived_s: float) -> None:
        """Stamp a message by its sender's clock, counted in milliseconds since its start."""
        boot_ms = getattr(message, "time_boot_ms", None)
        clock = message.get_srcComponent()
        sent_s = None if not boot_ms else boot_ms / 1000
        if sent_s is not None:
            self._tick(sent_s, arrived_s, clock)
        for quantity in reader.quantities(message, arrived_s):
            self._hear(quantity, arrived_s, sent_s, clock)

    def _is_ours(self, message: Any, arrived_s: float) -> bool:
        """Stay with the first vehicle that tells its position, as long as it is heard."""
        system = message.get_srcSystem()
        if system == self._vehicle:
            self._vehicle_s = arrived_s
            return True
        is_free = self._vehicle is None or arrived_s - self._vehicle_s > OTHER_VEHICLE_S
        tells = message.get_type() in ("GLOBAL_POSITION_INT", "HEARTBEAT")
        if not is_free or not tells or message.get_srcComponent() != AUTOPILOT:
            return False
        self._vehicle, self._vehicle_s = system, arrived_s
        return True


class _Asking:
    """Asks a vehicle for the messages that are missing, a few times."""

    def __init__(self, mav: Any, dialect: Any) -> None:
        self._mav, self._dialect = mav, dialect
        self._since_s: float | None = None
        self._asked = 0

    def ask(self, vehicle: int | None, seen: set[str], now_s: float) -> None:
        """Ask when it is time; source: MAV_CMD_SET_MESSAGE_INTERVAL of the common dialect."""
        if vehicle is None or self._asked >= TIMES_ASKED:
            return
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._since_s < MISSING_S + self._asked * ASK_AGAIN_S:
            return
        self._asked += 1
        for name, rate_hz in ASKED_HZ.items():
            if name not in seen:
                number = getattr(self._dialect, f"MAVLINK_MSG_ID_{name}")
                command = self._dialect.MAV_CMD_SET_MESSAGE_INTERVAL
                interval_us = 1e6 / rate_hz
                self._mav.command_long_send(
                    vehicle, AUTOPILOT, command, 0, number, interval_us, 0, 0, 0, 0, 0
                )
