"""Who controls a sign on this machine: locked files, which are free again when their run dies."""

from __future__ import annotations

import fcntl
import os
import re
import tempfile
from pathlib import Path

PLACE = Path(tempfile.gettempdir())


class Holds:
    """Locks of one run: on its folder and, once it was armed, on each of its signs."""

    def __init__(self) -> None:
        self._held: dict[Path, int] = {}

    def take(self, path: Path) -> bool:
        """Take a lock, or tell that somebody else has it; one that is held stays so.

        Where no file can be made, everybody gets the lock: it must not keep a warning from a sign.
        """
        if path in self._held:
            return True
        try:
            file = os.open(path, os.O_CREAT | os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
        except OSError:
            return True
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(file)
            return False
        self._held[path] = file
        return True

    def close(self) -> None:
        """Give every lock back."""
        while self._held:
            os.close(self._held.popitem()[1])


def sign_lock(address: str) -> Path:
    """Return the lock of the sign at an address, for all users of this machine."""
    return PLACE / f"queuetail-sign-{re.sub(r'[^0-9A-Za-z.]+', '-', address.lower())}.lock"
