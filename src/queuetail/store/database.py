"""The store: one class over SQLite and PostgreSQL, through SQLAlchemy Core."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from threading import Lock
from typing import Any

from sqlalchemy import (
    Connection,
    Engine,
    Select,
    Table,
    create_engine,
    delete,
    event,
    func,
    inspect,
    select,
    text,
    update,
)
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.exc import SQLAlchemyError

from queuetail.errors import InputError
from queuetail.store.address import Address, parse_address
from queuetail.store.records import Batch, Flight, HistoryPoint, StoredEvent
from queuetail.store.tables import (
    EVENT,
    FLIGHT,
    HISTORY,
    META,
    METADATA,
    MIGRATIONS,
    SCHEMA_VERSION,
)

BUSY_MS = 5000  # that an SQLite file may be locked by another process


class Store:
    """Flights, history and events in a database; each method reaches it anew when it was away.

    Every method raises InputError with one sentence when the database cannot be used.
    """

    def __init__(self, address: Address | str) -> None:
        """Name the database; nothing is opened before it is needed."""
        self._address = parse_address(address) if isinstance(address, str) else address
        self._lock = Lock()
        self._is_ready = False
        self._engine = _engine(self._address)

    @property
    def name(self) -> str:
        """The database's address without its password."""
        return self._address.shown

    def close(self) -> None:
        """Give the connections back."""
        self._engine.dispose()

    def prepare(self) -> None:
        """Make the tables where there are none."""
        with self._writing():
            pass

    def put_flight(self, flight: Flight) -> None:
        """Add a flight, or renew what is known of it."""
        row = {c.name: getattr(flight, c.name) for c in FLIGHT.columns}
        with self._writing() as connection:
            insert = _insert(connection, FLIGHT).values(row)
            changed = {n: insert.excluded[n] for n in row if n not in ("id", "last_utc")}
            connection.execute(insert.on_conflict_do_update(index_elements=["id"], set_=changed))

    def finish_flight(self, flight: str) -> None:
        """Note that a flight ended as it should."""
        with self._writing() as connection:
            connection.execute(update(FLIGHT).where(FLIGHT.c.id == flight).values(is_finished=True))

    def delete_flight(self, flight: str) -> None:
        """Remove a flight with its history and events."""
        with self._writing() as connection:
            connection.execute(delete(FLIGHT).where(FLIGHT.c.id == flight))

    def add(self, batch: Batch) -> None:
        """Add history and events, all or nothing; what is there already stays as it is."""
        newest: dict[str, datetime] = {}
        added: list[HistoryPoint | StoredEvent] = [*batch.history, *batch.events]
        for row in added:
            newest[row.flight] = max(row.utc, newest.get(row.flight, row.utc))
        with self._writing() as connection:
            for table, rows in ((HISTORY, batch.history), (EVENT, batch.events)):
                if rows:
                    values = [dataclasses.asdict(row) for row in rows]
                    insert = _insert(connection, table).on_conflict_do_nothing()
                    connection.execute(insert, values)
            for flight, utc in newest.items():
                later = (FLIGHT.c.last_utc.is_(None)) | (FLIGHT.c.last_utc < utc)
                connection.execute(
                    update(FLIGHT).where(FLIGHT.c.id == flight, later).values(last_utc=utc)
                )

    def flights(self, since: datetime | None = None, until: datetime | None = None) -> list[Flight]:
        """Return the flights that went on within a span of time, the newest first."""
        answers = _count(HISTORY)
        events = _count(EVENT)
        wanted = select(FLIGHT, answers.label("answers"), events.label("events")).order_by(
            FLIGHT.c.started_utc.desc(), FLIGHT.c.id
        )
        if since is not None:
            wanted = wanted.where(func.coalesce(FLIGHT.c.last_utc, FLIGHT.c.started_utc) >= since)
        if until is not None:
            wanted = wanted.where(FLIGHT.c.started_utc <= until)
        with self._reading() as connection:
            return [Flight(**row) for row in connection.execute(wanted).mappings()]

    def history(
        self,
        flight: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        approach: str | None = None,
    ) -> list[HistoryPoint]:
        """Return the end of the queue over time, oldest first."""
        wanted = _chosen(HISTORY, flight, since, until, approach)
        with self._reading() as connection:
            return [HistoryPoint(**row) for row in connection.execute(wanted).mappings()]

    def events(
        self,
        flight: str | None = None,
        since: datetime | None = None,
        until: datetime | None = None,
        approach: str | None = None,
    ) -> list[StoredEvent]:
        """Return what changed, oldest first."""
        wanted = _chosen(EVENT, flight, since, until, approach)
        with self._reading() as connection:
            return [StoredEvent(**row) for row in connection.execute(wanted).mappings()]

    @contextmanager
    def _writing(self) -> Iterator[Connection]:
        path = self._address.path
        try:
            if path is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
            self._make_ready()
            with self._engine.begin() as connection:
                yield connection
        except SQLAlchemyError as error:
            raise InputError(self._words(error)) from None
        except OSError as error:
            raise InputError(f"{self.name}: the store cannot be reached ({error})") from None

    @contextmanager
    def _reading(self) -> Iterator[Connection]:
        path = self._address.path
        if (path is not None and not path.is_file()) or not self._has_tables():
            raise InputError(
                f"{self.name}: there is no history there yet; 'queuetail live' and "
                "'queuetail history import' write one"
            )
        with self._writing() as connection:
            yield connection

    def _has_tables(self) -> bool:
        """Return whether it is ours: who only reads changes nothing of another's."""
        if self._is_ready:
            return True
        try:
            with self._engine.connect() as connection:
                return inspect(connection).has_table(META.name)
        except SQLAlchemyError as error:
            raise InputError(self._words(error)) from None
        except OSError as error:
            raise InputError(f"{self.name}: the store cannot be reached ({error})") from None

    def _make_ready(self) -> None:
        """Make the tables, or bring them up to date, once; refuse those of a newer queuetail."""
        with self._lock:
            if self._is_ready:
                return
            with self._engine.begin() as connection:
                seen = inspect(connection)
                if not seen.has_table(META.name):
                    others = seen.get_table_names() if self._address.path is not None else []
                    if others:
                        raise InputError(
                            f"{self.name} is another program's database (it has a table "
                            f"{others[0]}); name another file for the store"
                        )
                    METADATA.create_all(connection)
                    connection.execute(
                        _insert(connection, META)
                        .values(key="schema_version", value=str(SCHEMA_VERSION))
                        .on_conflict_do_nothing()
                    )
                self._migrate(connection)
            if self._address.path is not None:  # the file remembers it; not before it is ours
                with self._engine.connect() as connection:
                    connection.exec_driver_sql("PRAGMA journal_mode=WAL")
            self._is_ready = True

    def _migrate(self, connection: Connection) -> None:
        value = connection.scalar(select(META.c.value).where(META.c.key == "schema_version"))
        version = int(value or 0)
        if version > SCHEMA_VERSION:
            raise InputError(
                f"{self.name} was written by a newer queuetail (schema {version}, this one knows "
                f"{SCHEMA_VERSION}); update queuetail, or name another store"
            )
        while version < SCHEMA_VERSION:
            for statement in MIGRATIONS[version]:
                connection.execute(text(statement))
            version += 1
        connection.execute(
            update(META).where(META.c.key == "schema_version").values(value=str(version))
        )

    def _words(self, error: SQLAlchemyError) -> str:
        """Return one sentence; drivers give their errors as text or as a table of fields."""
        cause: Any = getattr(error, "orig", None) or error
        arguments = getattr(cause, "args", ())
        first = arguments[0] if arguments else ""
        said = first.get("M", "") if isinstance(first, dict) else str(cause)
        line = " ".join(str(said).split()) or type(cause).__name__
        return f"{self.name}: the store cannot be used ({line})"


def _engine(address: Address) -> Engine:
    # A lost connection cannot be closed in order: the pool logs that with a traceback, and we
    # raise it as a sentence.
    logging.getLogger("sqlalchemy.pool").setLevel(logging.CRITICAL)
    engine = create_engine(
        address.url, pool_pre_ping=True, hide_parameters=True, connect_args=address.options
    )
    if address.path is not None:

        @event.listens_for(engine, "connect")
        def prepare(connection: Any, record: Any) -> None:
            cursor = connection.cursor()
            cursor.execute(f"PRAGMA busy_timeout={BUSY_MS}")
            cursor.execute("PRAGMA synchronous=FULL")  # what was stored survives a power cut
            cursor.execute("PRAGMA foreign_keys=ON")
            cursor.close()

    return engine


def _insert(connection: Connection, table: Table) -> postgresql.Insert | sqlite.Insert:
    dialect = postgresql if connection.dialect.name == "postgresql" else sqlite
    return dialect.insert(table)


def _count(table: Table) -> Any:
    counted = select(func.count()).select_from(table).where(table.c.flight == FLIGHT.c.id)
    return counted.scalar_subquery()


def _chosen(
    table: Table,
    flight: str | None,
    since: datetime | None,
    until: datetime | None,
    approach: str | None,
) -> Select[Any]:
    wanted = select(table).order_by(table.c.utc, table.c.approach)
    if flight is not None:
        wanted = wanted.where(table.c.flight == flight)
    if approach is not None:
        wanted = wanted.where(table.c.approach == approach)
    if since is not None:
        wanted = wanted.where(table.c.utc >= since)
    if until is not None:
        wanted = wanted.where(table.c.utc <= until)
    return wanted
