"""One sign under central control: what it shows, and the whole sequence to make it show something.

The sequence (NTCIP 1203 section 4.3): the message row is asked to be modified, filled, validated,
its checksum compared with ours, activated for minutes, and what the sign then shows is read back.
The messages for the end of the duration, for lost communications, for recovered power and for a
reset are set first, so that whatever fails ends in the sign's default message, or blank.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from queuetail.signs import ntcip
from queuetail.signs.faults import SignFault, SignSilent, activate_sentence, validate_sentence
from queuetail.signs.multi import MultiError, build, phases_of
from queuetail.signs.ntcip import (
    BLANK,
    Activation,
    Column,
    ControlMode,
    Memory,
    MessageId,
    Status,
    cell,
)
from queuetail.signs.records import Phases, as_text
from queuetail.signs.snmp import Session, SnmpRefused, Value

T = TypeVar("T")
POLLS, POLL_S = 20, 0.1  # a sign that writes its flash may take a second or two
NO_SUCH, GEN_ERR = 2, 5  # SNMP error-status
OWNER = b"queuetail"
ANY_MAY_REPLACE = 1  # the run-time priority of a default message


class Overtaken(Exception):  # noqa: N818 - nothing went wrong
    """The message was not activated: it is not wanted any more, or has to be sent anew."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What a sign shows, by its own word."""

    multi: str
    phases: Phases
    source: int  # dmsMsgSourceMode
    minutes_left: int  # 65535: for ever
    control_mode: int
    message: MessageId
    errors: int  # shortErrorStatus


class SignClient:
    """Speaks to one sign; its coroutines are for one task at a time."""

    def __init__(
        self, session: Session, message_number: int = 1, priority: int = 100, phase_s: float = 2.5
    ) -> None:
        self._session = session
        self._number, self._default_number = message_number, message_number + 1
        self._priority, self._phase_s = priority, phase_s
        self._stored: MessageId | None = None
        self._default = BLANK
        self.is_prepared = False

    async def status(self) -> Shown:
        """Return what the sign shows now."""
        multi, mode, control, source, minutes, errors = await self._session.get(
            cell(Column.MULTI, Memory.CURRENT, 1),
            ntcip.SOURCE_MODE,
            ntcip.CONTROL_MODE,
            ntcip.MESSAGE_SOURCE,
            ntcip.TIME_REMAINING,
            ntcip.SHORT_ERROR_STATUS,
            what="tell what it shows",
        )
        text = _octets(multi).decode("ascii", "replace")
        try:
            phases = phases_of(text)
        except MultiError:
            phases = ((text,),)
        return Shown(
            multi=text,
            phases=phases,
            source=_number(mode),
            minutes_left=_number(minutes),
            control_mode=_number(control),
            message=_decoded(source),
            errors=_number(errors),
        )

    async def prepare(self, default: Phases, comm_loss_min: int) -> None:
        """Set what the sign does by itself when a duration ends, the link is lost, power returns.

        Until this has worked, nothing that could go stale should be shown.
        """
        await self._check_mode()
        self._default = BLANK
        if default:
            text = build(default, self._phase_s)
            self._default = await self._store(self._default_number, text, ANY_MAY_REPLACE)
        code = self._default.encode()
        for oid in (ntcip.END_DURATION_MESSAGE, ntcip.COMM_LOSS_MESSAGE):
            await self._session.set((oid, code), what="keep its message for a lost link")
        await self._session.set(
            (ntcip.COMM_LOSS_MINUTES, comm_loss_min), what="watch its link to us"
        )
        for oid in (ntcip.SHORT_POWER_MESSAGE, ntcip.LONG_POWER_MESSAGE, ntcip.RESET_MESSAGE):
            await self._try_set(oid, code, "keep its message for recovered power")
        self.is_prepared = True

    async def show(
        self, phases: Phases, minutes: int, still_wanted: Callable[[], bool] = lambda: True
    ) -> Shown:
        """Show phases for minutes, blank for none of them; return what the sign then shows.

        `still_wanted` is asked last before the message is activated; raises Overtaken if it is not,
        or if the sign has lost what was stored in it.
        """
        await self._check_mode()
        if not phases:
            if not still_wanted():
                raise Overtaken
            return await self._activated(BLANK, "", minutes=ntcip.INFINITE_MIN)
        multi = build(phases, self._phase_s)
        wanted = MessageId(Memory.CHANGEABLE, self._number, ntcip.crc(multi.encode("ascii")))
        if self._stored == wanted and not await self._still_stored(wanted):
            self.forget()
            raise Overtaken  # the sign lost its memory, or somebody wrote over ours: begin anew
        if self._stored != wanted:
            self._stored = None
            self._stored = await self._store(self._number, multi, self._priority)
        if not still_wanted():
            raise Overtaken
        return await self._activated(wanted, multi, minutes)

    async def show_default(self) -> Shown:
        """Show the default that :meth:`prepare` stored, for as long as nobody else changes it."""
        await self._check_mode()
        multi = ""
        if self._default != BLANK:
            (text,) = await self._session.get(
                cell(Column.MULTI, self._default.memory, self._default.number),
                what="tell its default message",
            )
            multi = _octets(text).decode("ascii", "replace")
        return await self._activated(self._default, multi, ntcip.INFINITE_MIN)

    def forget(self) -> None:
        """Take nothing for granted: after a lost link the sign may be another one."""
        self._stored, self.is_prepared = None, False

    def close(self) -> None:
        """Release the socket."""
        self._session.close()

    async def _check_mode(self) -> None:
        (mode,) = await self._session.get(ntcip.CONTROL_MODE, what="tell who controls it")
        if mode == ControlMode.LOCAL:
            raise SignFault(activate_sentence(9))

    async def _store(self, number: int, multi: str, priority: int) -> MessageId:
        """Write a message into changeable memory and have it validated."""
        session, octets = self._session, multi.encode("ascii")
        status = cell(Column.STATUS, Memory.CHANGEABLE, number)
        await session.set((status, Status.MODIFY_REQUEST), what="let a message be changed")
        await self._until(status, lambda s: s == Status.MODIFYING, "let a message be changed")
        text = (cell(Column.MULTI, Memory.CHANGEABLE, number), octets)
        extras = [
            (cell(column, Memory.CHANGEABLE, number), 0)
            for column in (Column.BEACON, Column.PIXEL_SERVICE)
        ]
        try:
            await session.set(text, *extras, what="take the text")
        except SnmpRefused as refused:
            if refused.status != NO_SUCH:
                raise
            await session.set(text, what="take the text")  # the MIB: absent ones count as zero
        column = cell(Column.PRIORITY, Memory.CHANGEABLE, number)
        await session.set((column, priority), what="take the message's priority")
        await self._try_set(cell(Column.OWNER, Memory.CHANGEABLE, number), OWNER, "note the owner")
        await session.set((status, Status.VALIDATE_REQUEST), what="validate the message")
        ends = (Status.VALID, Status.ERROR)
        if await self._until(status, lambda s: s in ends, "validate the message") != Status.VALID:
            raise SignFault(await self._explained(ntcip.VALIDATE_ERROR, validate_sentence))
        expected = ntcip.crc(octets)
        crc_cell = cell(Column.CRC, Memory.CHANGEABLE, number)
        (found,) = await session.get(crc_cell, what="tell the message's checksum")
        if found != expected:
            raise SignFault(
                f"the sign stored something else than was sent: its checksum is {_number(found)}, "
                f"and should be {expected}; nothing was shown"
            )
        return MessageId(Memory.CHANGEABLE, number, expected)

    async def _still_stored(self, wanted: MessageId) -> bool:
        """Tell whether our message is unchanged in the sign, so that it need not be written."""
        status, found = await self._session.get(
            cell(Column.STATUS, wanted.memory, wanted.number),
            cell(Column.CRC, wanted.memory, wanted.number),
            what="tell a message's state",
        )
        return status == Status.VALID and found == wanted.crc

    async def _activated(self, message: MessageId, multi: str, minutes: int) -> Shown:
        """Activate a message and read back what the sign shows."""
        code = Activation(minutes, self._priority, message, _own_address(self._session.peer_ip))
        try:
            await self._activate(code)
        except SnmpRefused as refused:
            if refused.status in (GEN_ERR, 3, 10, 12, 14):
                sentence = await self._explained(ntcip.ACTIVATE_ERROR, activate_sentence)
                raise SignFault(sentence) from None
            raise
        for _ in range(POLLS):
            shown = await self.status()
            same = shown.message.memory == message.memory and shown.message.number == message.number
            if same and shown.multi == multi:
                return shown
            await asyncio.sleep(POLL_S)
        raise SignFault(
            f"the sign accepted the message but shows {as_text(shown.phases)} instead of it"
        )

    async def _activate(self, code: Activation) -> None:
        what = "show the message"
        try:
            await self._session.set((ntcip.ACTIVATE_MESSAGE, code.encode()), what=what)
        except SnmpRefused as refused:
            if refused.status not in (NO_SUCH, 17):
                raise
            await self._session.set((ntcip.ACTIVATE_MESSAGE_V4, code.encode_v4()), what=what)

    async def _explained(
        self, oid: ntcip.Oid, sentence: Callable[[int, int | None, int | None], str]
    ) -> str:
        """Return why the last request failed, with the place in the text where there is one."""
        (code,) = await self._session.get(oid, what="tell why it refused")
        syntax: int | None = None
        position: int | None = None
        try:
            found = await self._session.get(
                ntcip.MULTI_ERROR, ntcip.MULTI_ERROR_POSITION, what="tell what is wrong in the text"
            )
            syntax, position = _number(found[0]), _number(found[1])
        except SignFault:
            pass  # these objects are optional
        return sentence(_number(code), syntax, position)

    async def _until(self, oid: ntcip.Oid, done: Callable[[Value], bool], what: str) -> Value:
        """Poll an object until it is done; a status of error ends it, too."""
        for _ in range(POLLS):
            (value,) = await self._session.get(oid, what=what)
            if done(value):
                return value
            await asyncio.sleep(POLL_S)
        raise SignFault(
            f"the sign did not {what} in time: its message status stays {_number(value)}"
        )

    async def _try_set(self, oid: ntcip.Oid, value: Value, what: str) -> None:
        """Set what not every sign has."""
        with contextlib.suppress(SnmpRefused):
            await self._session.set((oid, value), what=what)


def _own_address(peer_ip: str) -> tuple[int, int, int, int]:
    """Return the IPv4 address from which this machine reaches the sign, for the sign's log."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect((peer_ip, 161))  # sends nothing
            a, b, c, d = (int(part) for part in probe.getsockname()[0].split("."))
    except (OSError, ValueError):
        return 127, 0, 0, 1
    return a, b, c, d


def _number(value: Value) -> int:
    if isinstance(value, int):
        return value
    raise SignSilent("the sign answered with text where the standard has a number")


def _octets(value: Value) -> bytes:
    if isinstance(value, bytes):
        return value
    raise SignSilent("the sign answered with a number where the standard has text")


def _decoded(value: Value) -> MessageId:
    try:
        return MessageId.decode(_octets(value))
    except ValueError as error:
        raise SignSilent(f"the sign answered nonsense: {error}") from None
