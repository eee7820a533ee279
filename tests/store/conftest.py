"""Databases to test with: an SQLite file, and PostgreSQL where one can be reached."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import create_engine, text
from sqlalchemy.exc import SQLAlchemyError

from queuetail.store.database import Store

POSTGRES = os.environ.get("QUEUETAIL_TEST_POSTGRES", "postgresql://postgres@127.0.0.1:5432/test")


@pytest.fixture
def postgres() -> Iterator[str]:
    """The address of an empty PostgreSQL database that is removed again; skips without a server."""
    url = POSTGRES.replace("postgresql://", "postgresql+pg8000://")
    engine = create_engine(url, isolation_level="AUTOCOMMIT", connect_args={"timeout": 3})
    name = f"queuetail_{uuid.uuid4().hex[:10]}"
    try:
        with engine.connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
    except SQLAlchemyError:
        pytest.skip(f"no PostgreSQL server lets us in at {POSTGRES}")
    yield f"{POSTGRES.rpartition('/')[0]}/{name}"
    with engine.connect() as connection:
        connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()


@pytest.fixture(params=["sqlite", "postgres"])
def store(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Store]:
    """An empty store of each kind."""
    if request.param == "sqlite":
        opened = Store(str(tmp_path / "new" / "history.db"))
    else:
        opened = Store(request.getfixturevalue("postgres"))
    yield opened
    opened.close()
