"""Which source a word on the command line means."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec

from queuetail.errors import InputError
from queuetail.onboard.json_sources import JsonUdpSource, MqttSource
from queuetail.onboard.mavlink import ONBOARD_COMPUTER, MavlinkSource
from queuetail.onboard.ports import (
    Port,
    SerialPort,
    TcpPort,
    UdpPort,
    split_address,
    split_device,
)
from queuetail.onboard.source import Source

MAVLINK_BAUD = 115_200
JSON_UDP = "dji-json:udp:"
MQTT = "dji:"


def flight_controller(spec: str) -> Source:
    """Return the source that `--flight-controller` names; raises InputError where it names none."""
    if spec.startswith(JSON_UDP):
        return json_udp(spec.removeprefix(JSON_UDP))
    if spec.startswith(MQTT):
        return mqtt(spec.removeprefix(MQTT))
    return mavlink(spec)


def mavlink(spec: str, identity: tuple[int, int] = ONBOARD_COMPUTER) -> Source:
    """Return a MAVLink source: DEVICE[:BAUD], udp:, udpin:, udpout: or tcp:HOST:PORT."""
    needs("pymavlink", "MAVLink")
    return MavlinkSource(f"MAVLink {spec}", mavlink_port(spec), identity)


def mavlink_port(spec: str) -> Callable[[], Port]:
    """Return what opens the port; raises InputError where the words make none."""
    kind, colon, rest = spec.partition(":")
    if colon and kind in ("udp", "udpin", "udpout", "tcp"):
        host, port = split_address(rest, f"{kind}:0.0.0.0:14550")
        if kind == "tcp":
            return lambda: TcpPort(host, port)
        return lambda: UdpPort(host, port, is_bound=kind != "udpout")
    needs("serial", "a serial line")
    device, baud = split_device(spec, MAVLINK_BAUD)
    return lambda: SerialPort(device, baud)


def json_udp(address: str) -> Source:
    """Return a source of JSON datagrams: PORT, or HOST:PORT for one address of this machine."""
    host, port = split_address(address if ":" in address else f"0.0.0.0:{address}", "14600")
    return JsonUdpSource(host, port)


def mqtt(url: str) -> Source:
    """Return a source behind an MQTT broker."""
    needs("aiomqtt", "MQTT")
    return MqttSource(url)


def needs(module: str, what: str) -> None:
    """Raise InputError with the mend where a library is missing."""
    if find_spec(module) is None:
        raise InputError(
            f"{what} needs the library {module}: install it with pip install 'queuetail[live]'"
        )
