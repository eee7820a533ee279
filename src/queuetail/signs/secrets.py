"""How queuetail proves to a sign who it is: from a file of the owner's, or from the environment.

Never from a command line, which every user of a machine can read, and never into a log.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, SecretStr, model_validator

from queuetail.config import parse_settings, read_toml
from queuetail.errors import InputError
from queuetail.settings import Settings

PREFIX = "QUEUETAIL_SIGN_"
SECRET_KEYS = {"community", "auth_key", "priv_key"}
Key = Annotated[SecretStr, Field(min_length=8)]  # RFC 3414 section 11.2


class Secrets(Settings):
    """A community for SNMPv1, or a user for SNMPv3."""

    community: SecretStr | None = None
    user: str | None = None
    auth: Literal["md5", "sha", "sha224", "sha256", "sha384", "sha512"] = "sha256"
    auth_key: Key | None = None
    priv: Literal["des", "3des", "aes128", "aes192", "aes256"] = "aes128"
    priv_key: Key | None = None

    @model_validator(mode="after")
    def _is_one_way(self) -> Secrets:
        if self.user is not None and self.community is not None:
            raise ValueError("give either a community (SNMPv1) or a user (SNMPv3), not both")
        if self.user is None and (self.auth_key is not None or self.priv_key is not None):
            raise ValueError("a key needs its user")
        if self.priv_key is not None and self.auth_key is None:
            raise ValueError("priv_key needs auth_key: SNMPv3 does not encrypt for strangers")
        return self


def read_secrets(file: Path | None, environment: Mapping[str, str] | None = None) -> Secrets:
    """Return the secrets of a file, else of the environment, else the community `public`.

    Raises InputError when others than the owner could read the file.
    """
    if file is not None:
        _check_private(file)
        return _parsed(read_toml(file, "file of secrets"), str(file))
    variables = os.environ if environment is None else environment
    known = Secrets.model_fields
    found = {k: variables[PREFIX + k.upper()] for k in known if PREFIX + k.upper() in variables}
    if not found:
        return Secrets(community=SecretStr("public"))
    return _parsed(found, f"the environment ({PREFIX}…)")


def _parsed(raw: Mapping[str, object], source: str) -> Secrets:
    """Validate secrets; they are covered first, so that no sentence on what is wrong shows one."""
    for key in SECRET_KEYS & raw.keys():
        if not isinstance(raw[key], str):
            raise InputError(f"{source}: {key} has to be text in quotes")
    covered = {k: SecretStr(str(v)) if k in SECRET_KEYS else v for k, v in raw.items()}
    return parse_settings(Secrets, covered, source)


def _check_private(file: Path) -> None:
    try:
        status = file.stat()
    except OSError as error:
        raise InputError(f"{file}: the file of secrets cannot be read ({error.strerror})") from None
    if status.st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise InputError(
            f"{file} holds secrets, and others than its owner may read or write it; "
            f"run: chmod 600 {file}"
        )
