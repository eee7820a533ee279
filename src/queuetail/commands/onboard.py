"""`onboard`: the drone's end of the telemetry link, on its companion computer."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from datetime import UTC, datetime
from pathlib import Path

from queuetail.commands import Commands
from queuetail.commands.live import seconds
from queuetail.errors import InputError


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    onboard = commands.add_parser(
        "onboard", help="send the drone's telemetry over a serial radio (on the drone)"
    )
    onboard.add_argument(
        "--flight-controller",
        metavar="SRC",
        help="MAVLink: DEVICE[:BAUD], udpin:HOST:PORT …; bridges: dji-json:udp:PORT, dji:mqtt://…",
    )
    onboard.add_argument("--lidar", metavar="SERIAL", help="a LightWare LW20/C: DEVICE[:BAUD]")
    onboard.add_argument("--radio", metavar="SERIAL", required=True, help="the radio's device")
    onboard.add_argument(
        "--baud",
        type=_baud,
        default=9600,
        metavar="N",
        help="of the radio's serial line (default: 9600)",
    )
    onboard.add_argument("--duration", type=seconds, metavar="S", help="end after so many seconds")
    onboard.add_argument(
        "--simulate",
        type=Path,
        metavar="PATH",
        help="instead of sensors: a flight folder with telemetry.csv, or a site file",
    )
    onboard.set_defaults(command=_onboard)


def _onboard(arguments: argparse.Namespace) -> int:
    from queuetail.onboard import sources
    from queuetail.onboard.lidar import LidarSource
    from queuetail.onboard.ports import SerialPort, serial_line, split_device
    from queuetail.onboard.sender import Sender, header_rates
    from queuetail.onboard.simulated import SimulatedSource
    from queuetail.onboard.source import Source

    sensors = arguments.flight_controller or arguments.lidar
    if bool(sensors) == bool(arguments.simulate):
        raise InputError(
            "say what to send: --flight-controller and --lidar, or --simulate without them"
        )
    sources.needs("serial", "the radio")
    flight: list[Source] = []
    lidar = None
    if arguments.simulate:
        flight.append(SimulatedSource(arguments.simulate))
    if arguments.flight_controller:
        flight.append(sources.flight_controller(arguments.flight_controller))
    if arguments.lidar:
        lidar = LidarSource(*split_device(arguments.lidar, 115_200))
    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    radio = serial_line(arguments.radio)
    sender = Sender(flight, lidar, lambda: SerialPort(radio, arguments.baud), arguments.baud, _tell)
    sent = sender.run(stopping, arguments.duration)
    print(f"{sent.frames} messages, {sent.sent_bytes} bytes; last: {header_rates(sent)}")
    return 0


def _tell(sentence: str) -> None:
    """Say what changed, with the time, for whoever reads the companion's journal."""
    print(f"{datetime.now(UTC):%H:%M:%S} {sentence}", file=sys.stderr, flush=True)


def _baud(text: str) -> int:
    if not text.isdigit() or not 300 <= int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"'{text}' is not a baud rate; radios mostly have 9600")
    return int(text)
