"""Writing small files, with one clear sentence where that fails."""

from __future__ import annotations

from pathlib import Path

from queuetail.errors import InputError


def write_text(path: Path, text: str) -> None:
    """Write a text file in UTF-8; raises InputError where it cannot be written."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror})") from None
