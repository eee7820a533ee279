"""A simulated sign: the objects of NTCIP 1203 that a portable sign has, and how they behave.

It knows its time only from :meth:`SimulatedSign.tick`, and nothing of SNMP: `agent` gives it a
network, `face` a face.  It holds to the MIB's descriptions where real signs are lenient.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from queuetail.signs import ntcip
from queuetail.signs.multi import MultiError, Page, Syntax, parse
from queuetail.signs.ntcip import (
    BLANK,
    INFINITE_MIN,
    Activation,
    Column,
    ControlMode,
    Memory,
    MessageId,
    Oid,
    Source,
    Status,
    cell,
)

Value = int | bytes
MESSAGES = 20  # changeable ones, and as many volatile
MULTI_OCTETS = 512
VMS_CHARACTER_PORTABLE = 4 + 128  # dmsSignType: character matrix, on a trailer


# When a sign shows a message by itself: the objects that hold which one.
OCCASIONS = (
    ntcip.SHORT_POWER_MESSAGE,
    ntcip.LONG_POWER_MESSAGE,
    ntcip.RESET_MESSAGE,
    ntcip.COMM_LOSS_MESSAGE,
    ntcip.END_DURATION_MESSAGE,
)


class Refused(Exception):  # noqa: N818 - what a sign says to a request
    """An SNMP error-status (RFC 3416) for one of the objects in a request, counted from 0."""

    def __init__(self, status: int, index: int = 0) -> None:
        super().__init__(f"error-status {status}")
        self.status, self.index = status, index


NO_SUCH, BAD_VALUE, GEN_ERR, WRONG_TYPE, WRONG_VALUE = 2, 3, 5, 7, 10
INCONSISTENT, NOT_WRITABLE = 12, 17


@dataclass(slots=True)
class Row:
    """One row of dmsMessageTable."""

    multi: bytes = b""
    owner: bytes = b""
    beacon: int = 0
    pixel_service: int = 0
    priority: int = 1
    status: int = Status.NOT_USED

    @property
    def crc(self) -> int:
        """dmsMessageCRC."""
        return ntcip.crc(self.multi, self.beacon, self.pixel_service)


@dataclass(slots=True)
class SimulatedSign:
    """One sign; `size` is lines and characters of a character matrix of 5 × 7 pixels."""

    lines: int = 3
    characters: int = 8
    pages: int = 2
    control_mode: int = ControlMode.CENTRAL
    current: Row = field(default_factory=Row)
    message: MessageId = BLANK
    source: int = Source.RESET
    requester: bytes = bytes(4)
    left_s: float = math.inf
    activations: int = 0
    _rows: dict[tuple[int, int], Row] = field(default_factory=dict)
    _stored: dict[Oid, Value] = field(default_factory=dict)
    _now_s: float | None = None
    _heard_s: float = 0.0
    _shown_since_s: float = 0.0

    def __post_init__(self) -> None:
        for memory in (Memory.CHANGEABLE, Memory.VOLATILE):
            self._rows |= {(memory, n): Row() for n in range(1, MESSAGES + 1)}
        self.current = Row(status=Status.VALID, priority=1)
        self._stored = dict.fromkeys(OCCASIONS, BLANK.encode())
        self._stored |= {
            ntcip.COMM_LOSS_MINUTES: 0,
            ntcip.VALIDATE_ERROR: 2,
            ntcip.ACTIVATE_ERROR: 2,
            ntcip.MULTI_ERROR: int(Syntax.NONE),
            ntcip.MULTI_ERROR_POSITION: 0,
            ntcip.ACTIVATE_MESSAGE: Activation(INFINITE_MIN, 255, BLANK).encode(),
        }

    # Time

    def tick(self, now_s: float) -> None:
        """Let the sign's clock be `now_s`: durations end, a silent link is noticed."""
        if self._now_s is None:
            self._now_s = self._heard_s = self._shown_since_s = now_s
        elapsed_s, self._now_s = max(now_s - self._now_s, 0.0), now_s
        self.left_s -= elapsed_s
        if self.left_s <= 0:
            self._by_itself(ntcip.END_DURATION_MESSAGE, Source.END_DURATION)
        silent_min = int(self._stored[ntcip.COMM_LOSS_MINUTES])
        watched = silent_min > 0 and self.control_mode != ControlMode.LOCAL
        silent = watched and now_s - self._heard_s > 60.0 * silent_min
        if silent and self.source != Source.COMM_LOSS:
            self._by_itself(ntcip.COMM_LOSS_MESSAGE, Source.COMM_LOSS)

    def heard(self) -> None:
        """Note that a management station spoke to the sign just now."""
        self._heard_s = self._now_s or 0.0

    def lose_power(self) -> None:
        """Switch off and on again after long: what is shown then is the recovery message."""
        self._by_itself(ntcip.LONG_POWER_MESSAGE, Source.POWER_RECOVERY)
        for memory, number in list(self._rows):
            if memory == Memory.VOLATILE:
                self._rows[memory, number] = Row()

    # Face

    def pages_shown(self) -> tuple[Page, ...]:
        """Return the pages of the current message; none for a blank sign."""
        pages = parse(self.current.multi.decode("ascii"))
        return pages if any(line.text for page in pages for line in page.lines) else ()

    def page_shown(self) -> Page | None:
        """Return the page that is lit just now; None while the face is dark."""
        pages = self.pages_shown()
        if not pages:
            return None
        cycle_s = sum(page.on_s + page.off_s for page in pages)
        into_s = ((self._now_s or 0.0) - self._shown_since_s) % cycle_s
        for page in pages:
            if into_s < page.on_s:
                return page
            into_s -= page.on_s + page.off_s
            if into_s < 0:
                return None
        return pages[-1]

    # Objects

    def get(self, oid: Oid) -> Value:
        """Return an object's value; raises Refused."""
        if oid in self._stored:
            return self._stored[oid]
        if oid[: len(ntcip.MESSAGE_ENTRY)] == ntcip.MESSAGE_ENTRY:
            return self._cell(oid[len(ntcip.MESSAGE_ENTRY) :])
        facts: dict[Oid, Callable[[], Value]] = {
            ntcip.SIGN_TYPE: lambda: VMS_CHARACTER_PORTABLE,
            ntcip.CHARACTER_HEIGHT_PX: lambda: 7,
            ntcip.CHARACTER_WIDTH_PX: lambda: 5,
            ntcip.SIGN_HEIGHT_PX: lambda: 7 * self.lines,
            ntcip.SIGN_WIDTH_PX: lambda: 5 * self.characters,
            ntcip.MAX_PAGES: lambda: self.pages,
            ntcip.MAX_MULTI_LENGTH: lambda: MULTI_OCTETS,
            ntcip.MAX_CHANGEABLE: lambda: MESSAGES,
            ntcip.CONTROL_MODE: lambda: self.control_mode,
            ntcip.TIME_REMAINING: self._minutes_left,
            ntcip.MESSAGE_SOURCE: self.message.encode,
            ntcip.REQUESTER: lambda: self.requester,
            ntcip.SOURCE_MODE: lambda: self.source,
            ntcip.SHORT_ERROR_STATUS: lambda: (
                ntcip.MESSAGE_ERROR_BIT if self._stored[ntcip.ACTIVATE_ERROR] != 2 else 0
            ),
        }
        if oid not in facts:
            raise Refused(NO_SUCH)
        return facts[oid]()

    def set(self, oid: Oid, value: Value) -> None:
        """Set an object; raises Refused."""
        if oid[: len(ntcip.MESSAGE_ENTRY)] == ntcip.MESSAGE_ENTRY:
            self._set_cell(oid[len(ntcip.MESSAGE_ENTRY) :], value)
        elif oid in (ntcip.ACTIVATE_MESSAGE, ntcip.ACTIVATE_MESSAGE_V4):
            self._activate(_octets(value, 12 if oid == ntcip.ACTIVATE_MESSAGE else 8))
        elif oid == ntcip.CONTROL_MODE:
            mode = _integer(value, 2, 5)
            if mode not in (ControlMode.CENTRAL, ControlMode.CENTRAL_OVERRIDE):
                raise Refused(WRONG_VALUE)  # the switch at the sign alone makes it local
            self.control_mode = mode
        elif oid == ntcip.TIME_REMAINING:
            minutes = _integer(value, 0, INFINITE_MIN)
            self.left_s = math.inf if minutes == INFINITE_MIN else 60.0 * minutes
            if minutes == 0:
                self._by_itself(ntcip.END_DURATION_MESSAGE, Source.END_DURATION)
        elif oid == ntcip.COMM_LOSS_MINUTES:
            self._stored[oid] = _integer(value, 0, 65535)
        elif oid in OCCASIONS:
            self._stored[oid] = _octets(value, 5)
        else:
            self.get(oid)  # there is none, or it can only be read
            raise Refused(NOT_WRITABLE)

    def set_all(self, pairs: Sequence[tuple[Oid, Value]]) -> None:
        """Set objects, all or none of the message table's; raises Refused."""
        before = copy.deepcopy(self._rows)
        for index, (oid, value) in enumerate(pairs):
            try:
                self.set(oid, value)
            except Refused as refused:
                self._rows = before
                raise Refused(refused.status, index) from None

    def names(self) -> list[Oid]:
        """Return every object's name in the order in which SNMP walks them."""
        scalars = [o for o in vars(ntcip).values() if isinstance(o, tuple) and o[-1:] == (0,)]
        found = [o for o in scalars if o != ntcip.ACTIVATE_MESSAGE_V4]
        rows = [*self._rows, (Memory.CURRENT, 1), (Memory.BLANK, 1), (Memory.BLANK, 255)]
        found += [cell(column, *row) for column in Column for row in rows]
        return sorted(found)

    def _row(self, memory: int, number: int) -> Row:
        if memory == Memory.CURRENT and number == 1:
            return self.current
        if memory == Memory.BLANK and 1 <= number <= 255:
            return Row(priority=number, status=Status.VALID)
        if (memory, number) not in self._rows:
            raise Refused(NO_SUCH)
        return self._rows[memory, number]

    def _cell(self, index: Oid) -> Value:
        if len(index) != 3 or index[0] not in set(Column):
            raise Refused(NO_SUCH)
        column, memory, number = index
        row = self._row(memory, number)
        values: dict[int, Value] = {
            Column.MEMORY_TYPE: memory,
            Column.NUMBER: number,
            Column.MULTI: row.multi,
            Column.OWNER: row.owner,
            Column.CRC: 0 if memory == Memory.BLANK else row.crc,
            Column.BEACON: row.beacon,
            Column.PIXEL_SERVICE: row.pixel_service,
            Column.PRIORITY: row.priority,
            Column.STATUS: row.status,
        }
        return values[column]

    def _set_cell(self, index: Oid, value: Value) -> None:
        self._cell(index)
        column, memory, number = index
        if memory not in (Memory.CHANGEABLE, Memory.VOLATILE):
            raise Refused(NOT_WRITABLE)
        row = self._row(memory, number)
        if column == Column.STATUS:
            self._request(row, _integer(value, 1, 8))
            return
        if row.status != Status.MODIFYING:
            raise Refused(GEN_ERR)
        if column == Column.MULTI:
            text = _octets(value)
            if len(text) > MULTI_OCTETS or not text.isascii() or b"\0" in text:
                raise Refused(WRONG_VALUE)
            row.multi = text
        elif column == Column.OWNER:
            row.owner = _octets(value)[:127]
        elif column in (Column.BEACON, Column.PIXEL_SERVICE):
            _integer(value, 0, 0)  # it has neither
        elif column == Column.PRIORITY:
            row.priority = _integer(value, 1, 255)
        else:
            raise Refused(NOT_WRITABLE)

    def _request(self, row: Row, request: int) -> None:
        """Advance a row's status: section 4.3.4's state machine."""
        if request == Status.MODIFY_REQUEST and row.status != Status.VALIDATING:
            row.status = Status.MODIFYING
        elif request == Status.VALIDATE_REQUEST and row.status == Status.MODIFYING:
            fault = self._fault(row)
            self._stored[ntcip.VALIDATE_ERROR] = 2 if fault is None else 5
            row.status = Status.VALID if fault is None else Status.ERROR
        elif request == Status.NOT_USED_REQUEST and row.status != Status.VALIDATING:
            row.status = Status.NOT_USED
        else:
            raise Refused(BAD_VALUE)

    def _fault(self, row: Row) -> MultiError | None:
        """Return what is wrong with a row's text, and note it."""
        fault: MultiError | None = None
        try:
            pages = parse(row.multi.decode("ascii"))
            if len(pages) > self.pages:
                raise MultiError(Syntax.TOO_MANY_PAGES, row.multi.lower().rfind(b"[np"))
            for page in pages:
                wide = any(len(line.text) > self.characters for line in page.lines)
                if wide or len(page.lines) > self.lines:
                    raise MultiError(Syntax.TEXT_TOO_BIG, 0)
        except MultiError as found:
            fault = found
        self._stored[ntcip.MULTI_ERROR] = int(fault.syntax if fault else Syntax.NONE)
        self._stored[ntcip.MULTI_ERROR_POSITION] = fault.position if fault else 0
        return fault

    # Activation

    def _activate(self, octets: bytes) -> None:
        code = Activation.decode(octets)
        error = self._activation_error(code)
        self._stored[ntcip.ACTIVATE_ERROR] = error
        if error != 2:
            raise Refused(GEN_ERR)
        self._show(code.message, Source.CENTRAL, code.minutes)
        self.requester = bytes(code.source_ip)
        self._stored[ntcip.ACTIVATE_MESSAGE] = code.encode()

    def _activation_error(self, code: Activation) -> int:
        """Return dmsActivateMsgError for a request from central."""
        memory, number = code.message.memory, code.message.number
        writable = memory in (Memory.CHANGEABLE, Memory.VOLATILE)
        row = self._rows.get((memory, number), Row()) if writable else Row(status=Status.VALID)
        there = row.status != Status.NOT_USED and (writable or 1 <= number <= 255)
        faults = (
            (self.control_mode == ControlMode.LOCAL, 9),
            (code.priority < self.current.priority, 3),
            (not writable and memory != Memory.BLANK, 5),
            (not there, 6),
            (row.status != Status.VALID, 4),
            (code.message.crc != (row.crc if writable else 0), 7),
        )
        return next((error for wrong, error in faults if wrong), 2)

    def _by_itself(self, oid: Oid, source: Source) -> None:
        """Show the message kept for an occasion; blank when it cannot be shown."""
        message = MessageId.decode(_octets(self._stored[oid]))
        try:
            row = self._row(message.memory, message.number)
            crc = 0 if message.memory == Memory.BLANK else row.crc
            good = row.status == Status.VALID and crc == message.crc
        except Refused:
            good = False
        self._show(message if good else BLANK, source, INFINITE_MIN)

    def _show(self, message: MessageId, source: Source, minutes: int) -> None:
        row = self._row(message.memory, message.number)
        if row.multi != self.current.multi:
            self._shown_since_s = self._now_s or 0.0
        self.current = Row(row.multi, row.owner, 0, 0, row.priority, Status.VALID)
        self.message, self.source = message, source
        self.left_s = math.inf if minutes == INFINITE_MIN else 60.0 * minutes
        self.activations += 1

    def _minutes_left(self) -> int:
        return INFINITE_MIN if math.isinf(self.left_s) else max(math.ceil(self.left_s / 60.0), 0)


def _octets(value: Value, length: int | None = None) -> bytes:
    if not isinstance(value, bytes):
        raise Refused(WRONG_TYPE)
    if length is not None and len(value) != length:
        raise Refused(8)
    return value


def _integer(value: Value, least: int, most: int) -> int:
    if not isinstance(value, int):
        raise Refused(WRONG_TYPE)
    if not least <= value <= most:
        raise Refused(WRONG_VALUE)
    return value
