"""The history's routes: flights, events and ends of queue of the store, and their export."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Callable, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

from fastapi import FastAPI, HTTPException, Query, Response
from pydantic import AfterValidator, BaseModel, Field

from queuetail.console.source import ConsoleSource
from queuetail.errors import InputError

if TYPE_CHECKING:
    from queuetail.store.database import Store

T = TypeVar("T")

MOST_ROWS = 20_000
GEOJSON = "application/geo+json"


def _zoned(moment: datetime) -> datetime:
    if moment.tzinfo is None:
        raise ValueError("give the moment with its zone, as 2026-05-14T15:30:00Z")
    return moment


Utc = Annotated[datetime | None, Query(), AfterValidator(lambda v: v if v is None else _zoned(v))]
Text = Annotated[str | None, Query(max_length=100)]


class FlightRecord(BaseModel):
    """One flight that the store remembers."""

    id: str
    site: str
    source: str
    preset: str
    started_utc: datetime
    last_utc: datetime | None
    is_finished: bool
    answers: int
    events: int


class Flights(BaseModel):
    """The flights of the store; `problem` says why there are none, if something is wrong."""

    store: str
    flights: list[FlightRecord]
    problem: str = ""


class PastRow(BaseModel):
    """The answer for one approach at one time; an event, where it is one."""

    flight: str
    utc: datetime
    t_s: float
    approach: str
    status: str
    event: str | None = None
    lat_deg: float | None
    lon_deg: float | None
    station_m: float | None
    sigma_m: float | None
    length_m: float | None
    vehicles: int | None
    growth_mps: float | None
    reasons: str


class PastRows(BaseModel):
    """Rows in order of time, every n-th where there are many."""

    rows: list[PastRow]
    of: int = Field(description="how many there are")


class Archive:
    """The store that a run keeps, or the environment's; opened when it is asked for."""

    def __init__(self, source: ConsoleSource) -> None:
        self._source = source
        self._store: Store | None = None

    @property
    def store(self) -> Store:
        """The store; raises HTTPException where its address or its programs are missing."""
        if self._store is None:
            try:
                from queuetail.store.address import store_address  # noqa: PLC0415 - SQLAlchemy
                from queuetail.store.database import Store  # noqa: PLC0415

                self._store = Store(getattr(self._source, "store", None) or store_address(None))
            except ImportError as error:
                raise HTTPException(404, f"the history needs {error.name}") from None
            except InputError as error:
                raise HTTPException(404, str(error)) from None
        return self._store

    def ask(self, call: Callable[[Store], T]) -> T:
        """Return an answer of the store; raises HTTPException where it cannot be reached."""
        try:
            return call(self.store)
        except InputError as error:
            raise HTTPException(404, str(error)) from None


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the history's routes."""
    archive = Archive(source)
    unreachable: dict[int | str, dict[str, Any]] = {
        404: {"description": "there is no history, or it cannot be reached"}
    }

    @app.get("/api/v1/flights", tags=["history"], responses=unreachable)
    def flights(since: Utc = None, until: Utc = None) -> Flights:
        """Return the flights that went on within a span of time, the newest first."""
        name = archive.store.name
        try:
            found = archive.store.flights(since, until)
        except InputError as error:
            return Flights(store=name, flights=[], problem=str(error))
        names = FlightRecord.model_fields
        rows = [FlightRecord(**{n: getattr(f, n) for n in names}) for f in found[:1000]]
        return Flights(store=name, flights=rows)

    @app.get("/api/v1/flights/eoq", tags=["history"], responses=unreachable)
    def ends(
        flight: Text = None,
        since: Utc = None,
        until: Utc = None,
        limit: Annotated[int, Query(ge=1, le=MOST_ROWS)] = 4000,
    ) -> PastRows:
        """Return the end of the queue over time, as the store remembers it."""
        found = archive.ask(lambda s: s.history(flight, since, until))
        step = -(-len(found) // limit) or 1
        return PastRows(rows=[past_row(r) for r in found[::step]], of=len(found))

    @app.get("/api/v1/flights/events", tags=["history"], responses=unreachable)
    def events(flight: Text = None, since: Utc = None, until: Utc = None) -> PastRows:
        """Return what changed."""
        found = archive.ask(lambda s: s.events(flight, since, until))
        return PastRows(rows=[past_row(r) for r in found[-MOST_ROWS:]], of=len(found))

    @app.get(
        "/api/v1/flights/export", tags=["history"], response_class=Response, responses=unreachable
    )
    def export(
        form: Literal["csv", "json", "geojson"] = "csv",
        show: Literal["eoq", "events"] = "eoq",
        flight: Text = None,
        since: Utc = None,
        until: Utc = None,
    ) -> Response:
        """Return all rows as a file."""
        rows: Sequence[Any] = archive.ask(
            lambda s: (s.events if show == "events" else s.history)(flight, since, until)
        )
        body, kind = exported([past_row(r) for r in rows], form)
        headers = {"Content-Disposition": f'attachment; filename="queuetail-{show}.{form}"'}
        return Response(body, media_type=kind, headers=headers)


def past_row(row: Any) -> PastRow:
    """Return a row of the store for JSON."""
    return PastRow(**dataclasses.asdict(row))


def exported(rows: list[PastRow], form: str) -> tuple[str, str]:
    """Return rows as a file's text and its media type."""
    records = [r.model_dump(mode="json") for r in rows]
    if form == "json":
        return json.dumps(records, indent=1), "application/json"
    if form == "geojson":
        features = [
            {
                "type": "Feature",
                "geometry": {"type": "Point", "coordinates": [r["lon_deg"], r["lat_deg"]]},
                "properties": {k: v for k, v in r.items() if k not in ("lat_deg", "lon_deg")},
            }
            for r in records
            if r["lat_deg"] is not None and r["lon_deg"] is not None
        ]
        return json.dumps({"type": "FeatureCollection", "features": features}), GEOJSON
    out = io.StringIO()
    writer = csv.DictWriter(out, list(PastRow.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    return out.getvalue(), "text/csv; charset=utf-8"
