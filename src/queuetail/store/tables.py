"""The store's tables, their version, and how an older one is brought up to it."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    Boolean,
    Column,
    DateTime,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    TypeDecorator,
)

SCHEMA_VERSION = 1
# What brings a store from a version to the next: plain SQL, run in one transaction.
MIGRATIONS: dict[int, tuple[str, ...]] = {}


class UtcTime(TypeDecorator[datetime]):
    """A moment in UTC; SQLite keeps no zone, so it is taken off and put on again."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Any) -> datetime | None:
        """Return the moment in UTC; raises ValueError where it has no zone."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"{value} has no time zone")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Any) -> datetime | None:
        """Return the moment with its zone."""
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


METADATA = MetaData()


def _flight_key() -> Column[str]:
    return Column(
        "flight", String, ForeignKey("queuetail_flight.id", ondelete="CASCADE"), primary_key=True
    )


def _figures() -> tuple[Column[Any], ...]:
    return (
        Column("lat_deg", Float(53)),
        Column("lon_deg", Float(53)),
        Column("station_m", Float(53)),
        Column("sigma_m", Float(53)),
        Column("length_m", Float(53)),
        Column("vehicles", Integer),
        Column("growth_mps", Float(53)),
        Column("reasons", String, nullable=False),
    )


META = Table(
    "queuetail_meta",
    METADATA,
    Column("key", String, primary_key=True),
    Column("value", String, nullable=False),
)
FLIGHT = Table(
    "queuetail_flight",
    METADATA,
    Column("id", String, primary_key=True),
    Column("site", String, nullable=False),
    Column("source", String, nullable=False),
    Column("preset", String, nullable=False),
    Column("version", String, nullable=False),
    Column("started_utc", UtcTime, nullable=False),
    Column("last_utc", UtcTime),
    Column("is_finished", Boolean, nullable=False),
)
HISTORY = Table(
    "queuetail_history",
    METADATA,
    _flight_key(),
    Column("utc", UtcTime, primary_key=True),
    Column("approach", String, primary_key=True),
    Column("t_s", Float(53), nullable=False),
    Column("status", String, nullable=False),
    *_figures(),
    Index("queuetail_history_utc", "utc"),
)
EVENT = Table(
    "queuetail_event",
    METADATA,
    _flight_key(),
    Column("utc", UtcTime, primary_key=True),
    Column("approach", String, primary_key=True),
    Column("event", String, primary_key=True),
    Column("t_s", Float(53), nullable=False),
    Column("status", String, nullable=False),
    *_figures(),
    Index("queuetail_event_utc", "utc"),
)
