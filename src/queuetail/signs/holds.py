"""Who controls a sign on this machine: names that one process has, free again when it dies."""

from __future__ import annotations

import errno
import socket
from hashlib import sha256


class Holds:
    """Names that one run holds: its folder and, once it was armed, each of its signs."""

    def __init__(self) -> None:
        self._held: dict[str, socket.socket] = {}

    def take(self, name: str) -> bool:
        """Take a name, or tell that somebody else has it; one that is held stays so.

        The names are Linux' abstract addresses.  Where there are none, everybody gets the name: it
        must not keep a warning from a sign.
        """
        if name in self._held:
            return True
        held = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            held.bind(f"\0queuetail-{sha256(name.encode()).hexdigest()}")
        except OSError as error:
            held.close()
            return error.errno != errno.EADDRINUSE
        self._held[name] = held
        return True

    def close(self) -> None:
        """Give every name back."""
        while self._held:
            self._held.popitem()[1].close()
