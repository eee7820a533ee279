"""`open`: a finished run in the console; and how any command serves it."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from queuetail.console.app import ConsoleServer
    from queuetail.console.source import ConsoleSource


def serve(source: ConsoleSource, port: int, host: str) -> ConsoleServer:
    """Serve the console and say where; raises InputError where that cannot be."""
    from queuetail.errors import InputError

    try:
        from queuetail.console.app import ConsoleServer
    except ImportError as error:
        raise InputError(
            f"the console needs {error.name}: install it with pip install 'queuetail[console]'"
        ) from None
    server = ConsoleServer(source, port, host)
    if server.is_local:
        print(f"console on {server.address} · health on {server.address}health", flush=True)
        return server
    print(f"console on {server.address}, health on {server.address}health, with a token:")
    for name, token in (("operators", server.access.operator), ("viewers", server.access.viewer)):
        print(f"  {name}: {server.invitation(token)}")
    print_code(server.invitation(server.access.viewer))
    sys.stdout.flush()
    return server


def print_code(address: str) -> None:
    """Print an address as a QR code for a phone's camera, on a terminal."""
    import segno

    if sys.stdout.isatty():
        print("for a viewer's phone:")
        segno.make(address, error="l").terminal(compact=True)
