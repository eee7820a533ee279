"""`open`: a finished run in the console; and how any command serves it."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from queuetail.commands import Commands
from queuetail.commands.live import LOOPBACK, PORT, port

if TYPE_CHECKING:
    from queuetail.console.app import ConsoleServer
    from queuetail.console.source import ConsoleSource
    from queuetail.feeds.build import Feeds
    from queuetail.signs.controller import SignController


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    opening = commands.add_parser("open", help="look at a finished run in the console")
    opening.add_argument("run", type=Path, metavar="RUN_DIR", help="the folder that run wrote")
    opening.add_argument(
        "--video", type=Path, metavar="FILE", help="the flight's own video (default: the annotated)"
    )
    opening.add_argument(
        "--telemetry", type=Path, metavar="FILE", help="its log (default: beside or in the video)"
    )
    opening.add_argument(
        "--site", type=Path, metavar="SITE.toml", help="instead of the settings of the run"
    )
    opening.add_argument(
        "--port",
        type=port,
        default=PORT,
        metavar="N",
        help="of the console (default: %(default)s; 0: any free one)",
    )
    opening.add_argument(
        "--host",
        default=LOOPBACK,
        metavar="ADDRESS",
        help="as for live (default: %(default)s)",
    )
    opening.set_defaults(command=_open)


def _open(arguments: argparse.Namespace) -> int:
    from queuetail.config import read_site
    from queuetail.console.run_source import RunSource
    from queuetail.errors import InputError

    a = arguments
    if a.telemetry is not None and a.video is None:
        raise InputError("--telemetry belongs to the flight's own video: give --video, too")
    site = read_site(a.site) if a.site else None
    source = RunSource(a.run, site, a.site, a.video, a.telemetry)
    asked = Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, frame: asked.set())
    server = serve(source, a.port, a.host)
    try:
        asked.wait()
    finally:
        server.close()
        source.close()
    return 0


def serve(
    source: ConsoleSource,
    port: int,
    host: str,
    feeds: Feeds | None = None,
    signs: SignController | None = None,
) -> ConsoleServer:
    """Serve the console and say where; raises InputError where that cannot be."""
    from queuetail.errors import InputError

    try:
        from queuetail.console.app import ConsoleServer
    except ImportError as error:
        raise InputError(
            f"the console needs {error.name}: install it with pip install 'queuetail[console]'"
        ) from None
    server = ConsoleServer(source, port, host, (feeds.router(),) if feeds is not None else ())
    health = f" · health on {server.address}health" if source.about.is_live else ""
    told = [signs.told] if signs is not None else []
    if server.is_local:
        print(f"console on {server.address}{health}", *told, sep="\n", flush=True)
        return server
    print(f"console on {server.address}{health}, with a token:")
    for name, token in (("operators", server.access.operator), ("viewers", server.access.viewer)):
        print(f"  {name}: {server.invitation(token)}")
    print_code(server.invitation(server.access.viewer))
    print(*told, sep="\n", end="\n" if told else "", flush=True)
    return server


def print_code(address: str) -> None:
    """Print an address as a QR code for a phone's camera, on a terminal."""
    import segno

    if sys.stdout.isatty():
        print("for a viewer's phone:")
        segno.make(address, error="l").terminal(compact=True)
