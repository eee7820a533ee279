"""Which database an address means; a password in it is never shown."""

from __future__ import annotations

import getpass
import os
import ssl
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError

from queuetail.errors import InputError

DEFAULT_STORE = "out/history.db"
STORE_VARIABLE = "QUEUETAIL_STORE"
USER_VARIABLE, PASSWORD_VARIABLE = "PGUSER", "PGPASSWORD"  # as every PostgreSQL client has it
POSTGRES = {"postgresql", "postgres", "postgresql+pg8000"}
ANSWER_WITHIN_S = 10.0
EXAMPLES = "history.db, sqlite:///history.db or postgresql://USER@HOST/DATABASE"


@dataclass(frozen=True, slots=True)
class Address:
    """A database: how SQLAlchemy reaches it, and what may be shown of that."""

    url: URL
    shown: str
    options: dict[str, Any] = field(default_factory=dict, repr=False)  # of the driver
    path: Path | None = None  # of an SQLite file


def store_address(text: str | None) -> Address:
    """Return what an address given by a user means; else the environment's, else the default.

    Raises InputError where it is none, or where it holds a password: those are for the environment.
    """
    if text is not None:
        try:
            has_password = "://" in text and make_url(text).password is not None
        except ArgumentError:
            has_password = False
        if has_password:
            raise InputError(
                "a password on the command line can be read by every user of this machine; "
                f"leave it out and set {PASSWORD_VARIABLE}, or set the whole address in "
                f"{STORE_VARIABLE}"
            )
    return parse_address(text or os.environ.get(STORE_VARIABLE) or DEFAULT_STORE)


def parse_address(text: str) -> Address:
    """Return what a path or a database URL means; raises InputError."""
    if "://" not in text:
        path = Path(text)
        return Address(URL.create("sqlite", database=str(path)), text, path=path)
    try:
        url = make_url(text)
    except (ArgumentError, ValueError):
        raise InputError(f"this is no address of a store; write {EXAMPLES}") from None
    shown = url.render_as_string(hide_password=True)
    if url.drivername == "sqlite":
        if not url.database or url.database == ":memory:":
            raise InputError(f"{shown} names no file; write {EXAMPLES}")
        return Address(url, shown, path=Path(url.database))
    if url.drivername not in POSTGRES:
        raise InputError(f"{shown}: the store is SQLite or PostgreSQL; write {EXAMPLES}")
    if not url.database:
        raise InputError(f"{shown} names no database; write postgresql://USER@HOST/DATABASE")
    options: dict[str, Any] = {"timeout": ANSWER_WITHIN_S}
    mode = str(url.query.get("sslmode", ""))
    if mode:
        options["ssl_context"] = _tls(mode, shown)
        url = url.difference_update_query(["sslmode"])
    if not url.username:
        url = url.set(username=os.environ.get(USER_VARIABLE) or getpass.getuser())
    if url.password is None and os.environ.get(PASSWORD_VARIABLE):
        url = url.set(password=os.environ[PASSWORD_VARIABLE])
    return Address(url.set(drivername="postgresql+pg8000"), shown, options)


def _tls(mode: str, shown: str) -> ssl.SSLContext | None:
    """Return what PostgreSQL's `sslmode` asks for."""
    if mode == "disable":
        return None
    context = ssl.create_default_context()
    if mode == "require":  # encrypted, but whoever answers is believed
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    elif mode != "verify-full":
        raise InputError(f"{shown}: sslmode is disable, require or verify-full")
    return context
