"""Text of unknown origin: encodings, delimiters, tables and numbers, read tolerantly."""

from __future__ import annotations

import codecs
import csv
import io
from collections.abc import Mapping
from dataclasses import dataclass

BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
TEXT_CONTROLS = set(b"\t\n\r\f\x1a")
DELIMITERS = ",;\t|"
HEADER_CHARS = 20_000  # a header line is shorter; a text without line ends must not stall here


def decode_text(data: bytes) -> str | None:
    """Return `data` as text: UTF-8, UTF-16 or Latin-1, with any line ends; None if it is binary."""
    text = _decode(data)
    return None if text is None else text.replace("\r\n", "\n").replace("\r", "\n")


def _decode(data: bytes) -> str | None:
    for mark, encoding in BOMS:
        if data.startswith(mark):
            return data.decode(encoding, errors="replace")
    head = data[:4096]
    if b"\0" in head:
        return _decode_utf16_without_mark(data, head)
    if any(byte < 32 and byte not in TEXT_CONTROLS for byte in head):
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return data.decode("latin-1")  # the degree sign of old DJI firmware


def _decode_utf16_without_mark(data: bytes, head: bytes) -> str | None:
    even, odd = head[0::2].count(0), head[1::2].count(0)
    half = len(head) // 2
    if odd > 0.9 * half and even == 0:
        return data.decode("utf-16-le", errors="replace")
    if even > 0.9 * half and odd == 0:
        return data.decode("utf-16-be", errors="replace")
    return None


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: its number in the file, and its non-empty cells by column name."""

    line: int
    cells: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Table:
    """A delimited table; column names are trimmed and in lower case."""

    columns: tuple[str, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


class Numbers:
    """Reads cells as numbers and keeps count of those that are none, for one note at the end."""

    def __init__(self) -> None:
        self._bad: dict[tuple[int, str], str] = {}

    def get(self, row: Row, column: str | None) -> float | None:
        """Return the cell as a float; None where it is empty or no number."""
        cell = row.cells.get(column) if column is not None else None
        if cell is None:
            return None
        try:
            return float(cell)
        except ValueError:
            self.reject(row, column or "", cell)
            return None

    def reject(self, row: Row, column: str, cell: str) -> None:
        """Count a cell that could not be read."""
        self._bad[row.line, column] = cell

    def notes(self, source: str) -> tuple[str, ...]:
        """One sentence on the cells that were dropped, if any."""
        if not self._bad:
            return ()
        count = len(self._bad)
        cells = "1 cell was" if count == 1 else f"{count} cells were"
        line, column = min(self._bad)
        first = f"line {line}, {column} '{self._bad[line, column][:40]}'"
        return (f"{source}: {cells} unreadable and dropped (first: {first})",)


def header_line(text: str) -> str:
    """Return the first line that says anything."""
    return next((line for line in text[:HEADER_CHARS].splitlines() if line.strip()), "")


def delimiter_of(text: str) -> str:
    """Return the delimiter that occurs most often in the header line."""
    header = header_line(text)
    return max(DELIMITERS, key=header.count)


def column_names(text: str) -> tuple[str, ...]:
    """Return the header's column names, trimmed and in lower case."""
    parsed = next(csv.reader([header_line(text)], delimiter=delimiter_of(text)), [])
    return tuple(name.strip().lower() for name in parsed)


def read_table(text: str) -> Table:
    """Split a delimited table with a header line; a cut-off last line is dropped and said."""
    delimiter = delimiter_of(text)
    reader = csv.reader(io.StringIO(text.replace("\0", "")), delimiter=delimiter)
    columns: tuple[str, ...] = ()
    rows: list[Row] = []
    widths: list[int] = []
    try:
        for record in reader:
            if not any(cell.strip() for cell in record):
                continue
            if not columns:
                columns = column_names(text)
                continue
            cells = {}
            for name, raw in zip(columns, record, strict=False):
                cell = raw.strip()
                if cell and name:
                    # A semicolon between cells is what spreadsheets write where commas are decimal.
                    cells[name] = cell.replace(",", ".") if delimiter == ";" else cell
            rows.append(Row(reader.line_num, cells))
            widths.append(len(record))
    except csv.Error:
        return Table(columns, tuple(rows), (f"unreadable after line {reader.line_num}",))
    notes: tuple[str, ...] = ()
    if rows and not text.endswith("\n") and widths[-1] < len(columns):
        notes = (f"the last line ({rows[-1].line}) is cut off and was dropped",)
        rows.pop()
    return Table(columns, tuple(rows), notes)
