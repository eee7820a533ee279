"""Addresses of stores: what they mean, and that no password is ever shown."""

from __future__ import annotations

import pytest

from queuetail.errors import InputError
from queuetail.store.address import parse_address, store_address
from queuetail.store.database import Store


@pytest.fixture(autouse=True)
def _bare_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("QUEUETAIL_STORE", raising=False)
    monkeypatch.delenv("PGPASSWORD", raising=False)


@pytest.mark.parametrize("text", ["out/history.db", "sqlite:///out/history.db"])
def test_files(text: str) -> None:
    address = parse_address(text)
    assert str(address.path) == "out/history.db"
    assert address.url.database == "out/history.db"


def test_the_default_and_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    assert store_address(None).shown == "out/history.db"
    monkeypatch.setenv("QUEUETAIL_STORE", "postgresql://me:secret@db/roads")
    assert store_address(None).url.password == "secret"
    assert store_address("other.db").shown == "other.db"


@pytest.mark.parametrize("scheme", ["postgresql", "postgres", "postgresql+pg8000"])
def test_postgres(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PGPASSWORD", "of the environment")
    address = parse_address(f"{scheme}://me@db:5433/roads?sslmode=require")
    assert address.url.drivername == "postgresql+pg8000"
    assert address.url.password == "of the environment"
    assert "sslmode" not in address.url.query
    assert address.options["ssl_context"] is not None
    assert address.path is None


def test_postgres_without_a_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PGUSER", "county")
    assert parse_address("postgresql://127.0.0.1:1/roads").url.username == "county"
    with pytest.raises(InputError, match="the store cannot be used"):
        Store("postgresql://127.0.0.1:1/roads").flights()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mysql://me@db/roads", "the store is SQLite or PostgreSQL"),
        ("postgresql://me@db", "names no database"),
        ("sqlite://", "names no file"),
        ("postgresql://me@db:port/roads", "no address of a store"),
        ("postgresql://me@db/roads?sslmode=perhaps", "sslmode is disable, require or verify-full"),
    ],
)
def test_what_is_wrong_is_said(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_address(text)


def test_a_password_is_never_shown() -> None:
    with pytest.raises(InputError, match="can be read by every user") as refused:
        store_address("postgresql://me:hunter2@db/roads")
    assert "hunter2" not in str(refused.value)
    address = parse_address("postgresql://me:hunter2@127.0.0.1:1/roads")
    assert "hunter2" not in repr(address)
    assert "hunter2" not in address.shown
    with pytest.raises(InputError, match=r"me:\*\*\*@127.0.0.1:1/roads: the store cannot") as lost:
        Store(address).flights()
    assert "hunter2" not in str(lost.value)
    assert lost.value.__cause__ is None
