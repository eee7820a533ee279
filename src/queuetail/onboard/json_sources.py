"""Bridges from drones that speak no MAVLink: JSON over UDP, and DJI's Cloud API over MQTT."""

from __future__ import annotations

import asyncio
import os
import ssl
import time
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from queuetail.errors import InputError
from queuetail.link.json_fields import JsonReading, read_json
from queuetail.link.messages import ClockSource, ClockTime
from queuetail.onboard.ports import UdpPort
from queuetail.onboard.source import POLL_S, Source

if TYPE_CHECKING:
    import aiomqtt

MQTT_PORT, MQTTS_PORT = 1883, 8883
USER, PASSWORD = "QUEUETAIL_MQTT_USER", "QUEUETAIL_MQTT_PASSWORD"  # never on a command line
FAR_FROM_NOW_S = 86_400.0  # a sender's clock that is further off was never set
MQTT_EXAMPLE = "mqtt://HOST:1883/DRONE_SERIAL_NUMBER"


class _JsonSource(Source):
    """A source of JSON texts."""

    def _take(self, text: str | bytes, arrived_s: float) -> JsonReading | None:
        reading = read_json(text)
        if reading is None:
            return None
        sent_s, utc_s = reading.sent_s, reading.utc_s
        if sent_s is not None:
            self._tick(sent_s, arrived_s)
            if utc_s is not None and abs(utc_s - time.time()) <= FAR_FROM_NOW_S:
                self._hear(ClockTime(utc_s, ClockSource.GPS), arrived_s, sent_s)
        for quantity in reading.quantities:
            self._hear(quantity, arrived_s, sent_s)
        return reading


class JsonUdpSource(_JsonSource):
    """Hears one JSON object per datagram."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"JSON on UDP port {port}")
        self._host, self._port = host, port

    def _session(self) -> bool:
        port = UdpPort(self._host, self._port, is_bound=True)
        try:
            while not self._stopping.is_set():
                if data := port.read():
                    self._take(data, time.monotonic())
        finally:
            port.close()
        return True


class MqttSource(_JsonSource):
    """Hears a drone through an MQTT broker: DJI's osd and osd_info_push, or our own JSON.

    Topics: ``thing/product/SN/osd``, ``thing/product/GATEWAY/drc/up`` of the gateway that the osd
    names, and ``queuetail/SN/telemetry``.  Retained messages are left out: they may be of any age.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        drone = parts.path.strip("/")
        if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or not drone:
            raise InputError(f"'{url}' is no MQTT source; write it as {MQTT_EXAMPLE}")
        if parts.username or parts.password:
            raise InputError(
                f"the MQTT address of {parts.hostname} holds a user or password; give them in the "
                f"environment as {USER} and {PASSWORD}"
            )
        if not set(drone).isdisjoint("#+/"):
            raise InputError(f"'{drone}' is no serial number of a drone; write {MQTT_EXAMPLE}")
        super().__init__(f"MQTT {parts.hostname}")
        self._is_tls = parts.scheme == "mqtts"
        self._host = parts.hostname
        try:
            self._port = parts.port or (MQTTS_PORT if self._is_tls else MQTT_PORT)
        except ValueError:
            raise InputError(f"'{url}' has no valid port; write it as {MQTT_EXAMPLE}") from None
        self._drone = drone

    def _session(self) -> bool:
        import aiomqtt  # noqa: PLC0415

        try:
            asyncio.run(self._listen())
        except aiomqtt.MqttError as error:
            raise ConnectionError(str(error)) from None
        return True

    async def _listen(self) -> None:
        import aiomqtt  # noqa: PLC0415

        async with aiomqtt.Client(
            self._host,
            self._port,
            username=os.environ.get(USER),
            password=os.environ.get(PASSWORD),
            tls_context=ssl.create_default_context() if self._is_tls else None,
            timeout=5,
        ) as client:
            await client.subscribe(f"thing/product/{self._drone}/osd")
            await client.subscribe(f"queuetail/{self._drone}/telemetry")
            hearing = asyncio.ensure_future(self._hear_all(client))
            while not self._stopping.is_set() and not hearing.done():
                await asyncio.wait([hearing], timeout=POLL_S)
            hearing.cancel()
            await asyncio.gather(hearing, return_exceptions=self._stopping.is_set())

    async def _hear_all(self, client: aiomqtt.Client) -> None:
        gateway = None
        async for message in client.messages:
            payload = message.payload
            if message.retain or not isinstance(payload, bytes | str):
                continue
            reading = self._take(payload, time.monotonic())
            if reading is not None and reading.gateway not in (None, gateway):
                gateway = reading.gateway
                await client.subscribe(f"thing/product/{gateway}/drc/up")
