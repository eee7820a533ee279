"""The store keeps what it is given, on SQLite and PostgreSQL alike."""

from __future__ import annotations

import dataclasses
import sqlite3
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path

import pytest
from sqlalchemy import text

from queuetail.errors import InputError
from queuetail.store.database import Store
from queuetail.store.records import Batch, Flight, HistoryPoint, StoredEvent

START = datetime(2026, 5, 14, 15, 30, tzinfo=UTC)
FLIGHT = Flight("a", "I-35", "rtsp://drone/live", "road", "0.1.0", START)


def point(s: float, approach: str = "NB", flight: str = "a") -> HistoryPoint:
    utc = START + timedelta(seconds=s)
    return HistoryPoint(
        flight, utc, s, approach, "queued", 36.1, -97.05, 512.25, 1.5, 80.0, 9, None, "why – so"
    )


def formed(s: float) -> StoredEvent:
    utc = START + timedelta(seconds=s)
    return StoredEvent("a", utc, s, "NB", "queue_formed", "queued", station_m=1 / 3)


def test_what_goes_in_comes_out(store: Store) -> None:
    store.put_flight(FLIGHT)
    history = tuple(point(s, name) for s in (0.0, 1.000001, 2.5) for name in ("NB", "SB"))
    store.add(Batch(history, (formed(0.5),)))
    assert store.history("a") == list(history)
    assert store.events("a") == [formed(0.5)]
    (flight,) = store.flights()
    last = START + timedelta(seconds=2.5)
    assert flight == dataclasses.replace(FLIGHT, last_utc=last, answers=6, events=1)
    store.finish_flight("a")
    assert store.flights()[0].is_finished


def test_a_second_delivery_changes_nothing(store: Store) -> None:
    """As after a commit whose answer was lost."""
    for _ in range(2):
        store.put_flight(FLIGHT)
        store.add(Batch((point(0.0), point(1.0)), (formed(0.5),)))
    assert len(store.history()) == 2
    assert len(store.events()) == 1
    assert store.flights()[0].last_utc == START + timedelta(seconds=1)


def test_spans_of_time_and_approaches(store: Store) -> None:
    store.put_flight(FLIGHT)
    later = START + timedelta(hours=2)
    store.put_flight(dataclasses.replace(FLIGHT, id="b", started_utc=later))
    store.add(Batch(tuple(point(float(s), name) for s in range(10) for name in ("NB", "SB"))))
    since, until = START + timedelta(seconds=3), START + timedelta(seconds=5)
    assert [p.t_s for p in store.history("a", since, until, "NB")] == [3.0, 4.0, 5.0]
    assert [f.id for f in store.flights()] == ["b", "a"]
    assert [f.id for f in store.flights(until=START + timedelta(hours=1))] == ["a"]
    assert [f.id for f in store.flights(since=START + timedelta(hours=1))] == ["b"]
    assert store.history("b") == []


def test_moments_of_other_zones_are_the_same_moments(store: Store) -> None:
    store.put_flight(FLIGHT)
    central = timezone(timedelta(hours=-5))
    local = dataclasses.replace(point(0.0), utc=START.astimezone(central))
    store.add(Batch((local,)))
    assert store.history()[0].utc == START
    assert store.history("a", START.astimezone(central), START.astimezone(central)) == [point(0.0)]


def test_a_flight_that_is_removed_takes_its_rows_along(store: Store) -> None:
    store.put_flight(FLIGHT)
    store.add(Batch((point(0.0),), (formed(0.0),)))
    store.delete_flight("a")
    assert store.flights() == []
    assert store.history() == []
    assert store.events() == []


def test_all_or_nothing(store: Store) -> None:
    store.put_flight(FLIGHT)
    with pytest.raises(InputError, match="the store cannot be used"):
        store.add(Batch((point(0.0), point(1.0, flight="nobody"))))
    assert store.history() == []


def test_the_store_of_a_newer_version_is_refused(store: Store) -> None:
    store.put_flight(FLIGHT)
    with store._engine.begin() as connection:
        connection.execute(text("UPDATE queuetail_meta SET value = '7'"))
    again = Store(store._address)
    with pytest.raises(InputError, match=r"newer queuetail \(schema 7, this one knows 1\)"):
        again.flights()
    again.close()


def test_an_older_store_is_brought_up_to_date(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.put_flight(FLIGHT)
    monkeypatch.setattr("queuetail.store.database.SCHEMA_VERSION", 2)
    steps = {1: ("ALTER TABLE queuetail_flight ADD COLUMN weather VARCHAR",)}
    monkeypatch.setattr("queuetail.store.database.MIGRATIONS", steps)
    again = Store(store._address)
    again.put_flight(FLIGHT)
    with again._engine.begin() as connection:
        assert connection.scalar(text("SELECT value FROM queuetail_meta")) == "2"
        assert connection.execute(text("SELECT weather FROM queuetail_flight")).all() == [(None,)]
    again.close()


def test_sqlite_is_in_wal_mode_and_readable_by_others(tmp_path: Path) -> None:
    path = tmp_path / "history.db"
    store = Store(str(path))
    store.put_flight(FLIGHT)
    store.add(Batch((point(0.0),)))
    with sqlite3.connect(path) as reader:
        assert reader.execute("PRAGMA journal_mode").fetchone() == ("wal",)
        assert reader.execute("SELECT status, station_m FROM queuetail_history").fetchall() == [
            ("queued", 512.25)
        ]
    reader.close()
    store.close()


def test_another_programs_database_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "payroll.db"
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE wages (name TEXT)")
    other.close()
    before = path.read_bytes()
    with pytest.raises(InputError, match="there is no history there yet"):
        Store(str(path)).flights()
    assert path.read_bytes() == before
    with pytest.raises(InputError, match=r"another program's database .it has a table wages"):
        Store(str(path)).put_flight(FLIGHT)
    empty = tmp_path / "empty.db"
    empty.touch()
    with pytest.raises(InputError, match="there is no history there yet"):
        Store(str(empty)).flights()


def test_what_is_no_store_is_said_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no history there yet"):
        Store(str(tmp_path / "nothing.db")).flights()
    strange = tmp_path / "strange.db"
    strange.write_text("this is a letter to the county, and no database at all\n" * 20)
    with pytest.raises(InputError, match="file is not a database"):
        Store(str(strange)).flights()
    with pytest.raises(InputError, match="the store cannot be reached"):
        Store(str(strange / "below.db")).put_flight(FLIGHT)
