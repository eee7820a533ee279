"""Passwords and keys of feeds: from a file of the owner's, or from the environment.

Never from a site file or a command line, which others can read, and never into a log.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path

from queuetail.errors import InputError

LARGEST = 65_536


def read_private(file: Path, what: str) -> str:
    """Return the text of a file that only its owner can read; raises InputError."""
    try:
        with file.open("rb") as opened:
            status = os.fstat(opened.fileno())
            if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
                raise InputError(
                    f"{file} holds {what}, and others than its owner may read or write it; "
                    f"run: chmod 600 {file}"
                )
            return opened.read(LARGEST).decode("utf-8")
    except OSError as error:
        raise InputError(f"{file}: {what} cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise InputError(f"{file}: {what} has to be text in UTF-8") from None


def read_secret(
    file: Path | None,
    variable: str,
    what: str,
    environment: Mapping[str, str] | None = None,
) -> str | None:
    """Return a secret from its file, else from the environment, else None; raises InputError."""
    if file is not None:
        secret = read_private(file, what).strip("\r\n")
        source = str(file)
    else:
        found = (os.environ if environment is None else environment).get(variable)
        if found is None:
            return None
        secret, source = found, variable
    if not secret.strip():
        raise InputError(f"{source}: {what} is empty")
    return secret
