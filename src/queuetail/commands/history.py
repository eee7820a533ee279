"""`history`: what the store remembers."""

from __future__ import annotations

import argparse
import csv
import dataclasses
import json
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from queuetail.commands import Commands

if TYPE_CHECKING:
    from queuetail.store.database import Store

SHOWN = ("flights", "events", "eoq")
ROWS_SHOWN = 200  # on a terminal; --csv and --json have them all


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    history = commands.add_parser("history", help="what the store remembers of flights")
    history.add_argument(
        "--store", metavar="URL", help="default: QUEUETAIL_STORE of the environment, out/history.db"
    )
    history.add_argument("--flight", metavar="ID", help="only this flight")
    history.add_argument("--approach", metavar="NAME", help="only this approach")
    history.add_argument("--since", type=moment, metavar="UTC", help="as 2026-05-14T15:30:00Z")
    history.add_argument("--until", type=moment, metavar="UTC", help="as --since")
    history.add_argument("--show", choices=SHOWN, help="default: flights; with --flight its events")
    form = history.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print JSON")
    form.add_argument("--csv", action="store_true", help="print CSV")
    history.set_defaults(command=_history)
    actions = history.add_subparsers(metavar="import", required=False)
    importing = actions.add_parser("import", help="put the files of a run into the store")
    importing.add_argument("run", type=Path, metavar="RUN_DIR", help="the folder that run wrote")
    importing.add_argument("--store", metavar="URL", default=argparse.SUPPRESS, help="as above")
    importing.add_argument(
        "--start", type=moment, metavar="UTC", help="when the video began, where it does not say"
    )
    importing.set_defaults(command=_import)


def moment(text: str) -> datetime:
    """Parse a moment in ISO 8601; without a zone it is UTC."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no moment; write it as 2026-05-14T15:30:00Z"
        ) from None
    return when.replace(tzinfo=UTC) if when.tzinfo is None else when.astimezone(UTC)


def _store(arguments: argparse.Namespace) -> Store:
    from queuetail.store.address import store_address
    from queuetail.store.database import Store

    return Store(store_address(arguments.store))


def _import(arguments: argparse.Namespace) -> int:
    from queuetail.store.imported import import_run

    store = _store(arguments)
    flight = import_run(store, arguments.run, arguments.start)
    print(f"{flight.id} is now in {store.name}")
    return 0


def _history(arguments: argparse.Namespace) -> int:
    records = [_record(row) for row in _rows(_store(arguments), arguments)]
    if arguments.json:
        print(json.dumps(records, indent=2))
    elif arguments.csv:
        fields = [f.name for f in dataclasses.fields(_kind(arguments))]
        writer = csv.DictWriter(sys.stdout, fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(records)
    else:
        _print_table(records, _shown(arguments))
    return 0


def _record(row: Any) -> dict[str, Any]:
    fields = dataclasses.asdict(row)
    return {k: v.isoformat() if isinstance(v, datetime) else v for k, v in fields.items()}


def _shown(arguments: argparse.Namespace) -> str:
    return arguments.show or ("events" if arguments.flight else "flights")


def _kind(arguments: argparse.Namespace) -> Any:
    from queuetail.store.records import Flight, HistoryPoint, StoredEvent

    return {"flights": Flight, "events": StoredEvent, "eoq": HistoryPoint}[_shown(arguments)]


def _rows(store: Store, arguments: argparse.Namespace) -> Sequence[object]:
    from queuetail.errors import InputError

    a = arguments
    if a.flight is not None and a.flight not in {f.id for f in store.flights()}:
        raise InputError(
            f"{store.name} has no flight {a.flight}; 'queuetail history' lists those it has"
        )
    if _shown(a) == "flights":
        return [f for f in store.flights(a.since, a.until) if a.flight in (None, f.id)]
    read = store.events if _shown(a) == "events" else store.history
    return read(a.flight, a.since, a.until, a.approach)


COLUMNS = {
    "flights": ("id", "site", "preset", "started_utc", "last_utc", "answers", "events"),
    "events": ("utc", "approach", "event", "status", "station_m", "length_m", "reasons"),
    "eoq": ("utc", "approach", "status", "lat_deg", "lon_deg", "station_m", "sigma_m", "length_m"),
}


def _print_table(records: list[dict[str, Any]], shown: str) -> None:
    """Print aligned columns that a shell can cut, too."""
    if not records:
        print(f"no {shown} there")
        return
    names = COLUMNS[shown]
    part = records[-ROWS_SHOWN:] if shown != "flights" else records[:ROWS_SHOWN]
    rows = [names, *(tuple(_cell(name, record[name]) for name in names) for record in part)]
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        print("  ".join(cells).rstrip())
    if len(records) > ROWS_SHOWN:
        print(f"{ROWS_SHOWN} of {len(records)} shown; --csv and --json have them all")


def _cell(name: str, value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6f}" if name in ("lat_deg", "lon_deg") else f"{value:.1f}"
    text = str(value)
    return text[:19] + "Z" if name.endswith("utc") else text
