"""Text files that grow by whole lines, so that a killed run leaves nothing half-written."""

from __future__ import annotations

import os
import time
from pathlib import Path

from queuetail.errors import InputError

MAX_LINES = 2000
MAX_AGE_S = 1.0


class LineFile:
    """A UTF-8 file written in blocks of whole lines, at least once a second while lines come."""

    def __init__(self, path: Path, header: str | None = None) -> None:
        """Create `path`; raises InputError where it cannot be written."""
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise InputError(f"{path} cannot be written: {error.strerror}") from None
        self._path = path
        self._pending: list[str] = [] if header is None else [header]
        self._flush()

    def extend(self, lines: list[str]) -> None:
        """Add lines, given without their line ends."""
        self._pending += lines
        if len(self._pending) > MAX_LINES or time.monotonic() - self._flushed_s > MAX_AGE_S:
            self._flush()

    def close(self) -> None:
        """Write what is pending and close; a second call does nothing."""
        if not self._file.closed:
            try:
                self._flush()
            finally:
                self._file.close()

    def _flush(self) -> None:
        self._flushed_s = time.monotonic()
        if not self._pending:
            return
        block = memoryview(("\n".join(self._pending) + "\n").encode())
        self._pending = []
        try:
            while block:
                block = block[os.write(self._file.fileno(), block) :]
        except OSError as error:
            raise InputError(f"{self._path} cannot be written: {error.strerror}") from None
