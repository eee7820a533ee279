"""The simulated sign: its message table, its clock, its error codes."""

from __future__ import annotations

from io import BytesIO

import pytest
from PIL import Image

from queuetail.signs import face, ntcip
from queuetail.signs.multi import Syntax
from queuetail.signs.ntcip import (
    BLANK,
    Activation,
    Column,
    ControlMode,
    Memory,
    MessageId,
    Source,
    Status,
    cell,
)
from queuetail.signs.simulated import Refused, SimulatedSign

TEXT = "[jp3][jl3]STOPPED[nl]TRAFFIC"


class Bench:
    """A sign on a bench, with a clock in seconds."""

    def __init__(self) -> None:
        self.sign = SimulatedSign()
        self.sign.tick(0.0)

    def at(self, column: Column, number: int = 1) -> ntcip.Oid:
        return cell(column, Memory.CHANGEABLE, number)

    def store(self, text: str = TEXT, number: int = 1, priority: int = 100) -> MessageId:
        sign = self.sign
        sign.set(self.at(Column.STATUS, number), Status.MODIFY_REQUEST)
        sign.set(self.at(Column.MULTI, number), text.encode())
        sign.set(self.at(Column.PRIORITY, number), priority)
        sign.set(self.at(Column.STATUS, number), Status.VALIDATE_REQUEST)
        return MessageId(Memory.CHANGEABLE, number, ntcip.crc(text.encode()))

    def show(self, message: MessageId, minutes: int = 1, priority: int = 100) -> None:
        code = Activation(minutes, priority, message)
        self.sign.set(ntcip.ACTIVATE_MESSAGE, code.encode())

    def refuses(self, message: MessageId, priority: int = 100) -> int:
        with pytest.raises(Refused) as refused:
            self.show(message, priority=priority)
        assert refused.value.status == 5
        error = self.sign.get(ntcip.ACTIVATE_ERROR)
        assert isinstance(error, int)
        return error

    @property
    def words(self) -> list[str]:
        return [line.text for page in self.sign.pages_shown() for line in page.lines]


def test_a_message_goes_through_every_status() -> None:
    bench = Bench()
    status = bench.at(Column.STATUS)
    assert bench.sign.get(status) == Status.NOT_USED
    bench.sign.set(status, Status.MODIFY_REQUEST)
    assert bench.sign.get(status) == Status.MODIFYING
    bench.sign.set(bench.at(Column.MULTI), b"A[xx]")
    bench.sign.set(status, Status.VALIDATE_REQUEST)
    assert bench.sign.get(status) == Status.ERROR
    assert bench.sign.get(ntcip.VALIDATE_ERROR) == 5
    assert bench.sign.get(ntcip.MULTI_ERROR) == Syntax.UNSUPPORTED_TAG
    assert bench.sign.get(ntcip.MULTI_ERROR_POSITION) == 1
    bench.store()
    assert bench.sign.get(status) == Status.VALID
    bench.sign.set(status, Status.NOT_USED_REQUEST)
    assert bench.sign.get(status) == Status.NOT_USED


@pytest.mark.parametrize(
    ("before", "request_", "after"),
    [
        (Status.NOT_USED, Status.MODIFY_REQUEST, Status.MODIFYING),
        (Status.NOT_USED, Status.VALIDATE_REQUEST, None),
        (Status.NOT_USED, Status.NOT_USED_REQUEST, Status.NOT_USED),
        (Status.MODIFYING, Status.MODIFY_REQUEST, Status.MODIFYING),
        (Status.MODIFYING, Status.VALIDATE_REQUEST, Status.VALID),
        (Status.MODIFYING, Status.NOT_USED_REQUEST, Status.NOT_USED),
        (Status.VALID, Status.MODIFY_REQUEST, Status.MODIFYING),
        (Status.VALID, Status.VALIDATE_REQUEST, None),
        (Status.VALID, Status.NOT_USED_REQUEST, Status.NOT_USED),
        (Status.ERROR, Status.MODIFY_REQUEST, Status.MODIFYING),
        (Status.ERROR, Status.VALIDATE_REQUEST, None),
        (Status.ERROR, Status.NOT_USED_REQUEST, Status.NOT_USED),
        (Status.MODIFYING, Status.VALID, None),
    ],
)
def test_every_request_in_every_status(
    before: Status, request_: Status, after: Status | None
) -> None:
    bench = Bench()
    row = bench.sign._rows[Memory.CHANGEABLE, 1]
    row.status, row.multi = before, b"A"
    if after is None:
        with pytest.raises(Refused):
            bench.sign.set(bench.at(Column.STATUS), request_)
        assert row.status == before
    else:
        bench.sign.set(bench.at(Column.STATUS), request_)
        assert row.status == after


def test_a_duration_ends_in_its_message() -> None:
    bench = Bench()
    default = bench.store("[jl3]WORK", 2, 1)
    bench.sign.set(ntcip.END_DURATION_MESSAGE, default.encode())
    bench.show(bench.store(), 2)
    assert bench.sign.get(ntcip.TIME_REMAINING) == 2
    bench.sign.tick(59.0)
    assert bench.sign.get(ntcip.TIME_REMAINING) == 2
    bench.sign.tick(61.0)
    assert bench.sign.get(ntcip.TIME_REMAINING) == 1
    assert bench.words == ["STOPPED", "TRAFFIC"]
    bench.sign.tick(120.0)
    assert bench.words == ["WORK"]
    assert bench.sign.get(ntcip.SOURCE_MODE) == Source.END_DURATION
    assert bench.sign.get(ntcip.TIME_REMAINING) == 65535


def test_a_message_for_an_occasion_that_is_gone_is_blank() -> None:
    bench = Bench()
    bench.sign.set(ntcip.END_DURATION_MESSAGE, MessageId(Memory.CHANGEABLE, 9, 77).encode())
    bench.show(bench.store())
    bench.sign.set(ntcip.TIME_REMAINING, 0)
    assert bench.words == []
    assert bench.sign.message == BLANK


def test_a_silent_link_ends_in_its_message_unless_the_sign_is_local() -> None:
    bench = Bench()
    bench.sign.set(ntcip.COMM_LOSS_MINUTES, 2)
    bench.show(bench.store(), 65535)
    bench.sign.heard()
    bench.sign.tick(120.0)
    assert bench.words
    bench.sign.heard()
    bench.sign.control_mode = ControlMode.LOCAL
    bench.sign.tick(400.0)
    assert bench.words
    bench.sign.control_mode = ControlMode.CENTRAL
    bench.sign.tick(401.0)
    assert bench.words == []
    assert bench.sign.get(ntcip.SOURCE_MODE) == Source.COMM_LOSS


def test_power_that_returns_shows_the_recovery_message() -> None:
    bench = Bench()
    bench.show(bench.store(), 65535)
    bench.sign.lose_power()
    assert bench.words == []
    assert bench.sign.get(ntcip.SOURCE_MODE) == Source.POWER_RECOVERY


def test_why_a_message_is_not_shown() -> None:
    bench = Bench()
    good = bench.store()
    bench.show(good)
    assert bench.sign.get(ntcip.ACTIVATE_ERROR) == 2
    assert bench.refuses(good, priority=99) == 3
    assert bench.sign.get(ntcip.SHORT_ERROR_STATUS) == 1 << 7
    assert bench.refuses(MessageId(Memory.CURRENT, 1, 0)) == 5
    assert bench.refuses(MessageId(Memory.CHANGEABLE, 9, 0)) == 6
    assert bench.refuses(MessageId(Memory.CHANGEABLE, 999, 0)) == 6
    assert bench.refuses(MessageId(Memory.CHANGEABLE, 1, 1)) == 7
    bench.sign.set(bench.at(Column.STATUS), Status.MODIFY_REQUEST)
    assert bench.refuses(good) == 4
    bench.sign.control_mode = ControlMode.LOCAL
    assert bench.refuses(good) == 9
    assert bench.words == ["STOPPED", "TRAFFIC"]  # the buffer keeps what was shown


@pytest.mark.parametrize(
    ("oid", "value", "status"),
    [
        ((1, 3, 6, 1, 2, 1, 1, 1, 0), 1, 2),
        (ntcip.SIGN_TYPE, 1, 17),
        (ntcip.CONTROL_MODE, 2, 10),
        (ntcip.CONTROL_MODE, b"x", 7),
        (ntcip.TIME_REMAINING, 70_000, 10),
        (ntcip.END_DURATION_MESSAGE, b"123", 8),
        (ntcip.ACTIVATE_MESSAGE, b"", 8),
        (cell(Column.MULTI, Memory.CHANGEABLE, 1), b"A", 5),
        (cell(Column.MULTI, Memory.CURRENT, 1), b"A", 17),
        (cell(Column.CRC, Memory.CHANGEABLE, 99), 1, 2),
        ((*ntcip.MESSAGE_ENTRY, 77, 3, 1), 1, 2),
        ((*ntcip.MESSAGE_ENTRY, 3), 1, 2),
    ],
)
def test_what_cannot_be_set(oid: ntcip.Oid, value: int | bytes, status: int) -> None:
    with pytest.raises(Refused) as refused:
        Bench().sign.set(oid, value)
    assert refused.value.status == status


def test_a_request_for_several_objects_changes_all_or_none() -> None:
    bench = Bench()
    bench.store()
    bench.sign.set(bench.at(Column.STATUS), Status.MODIFY_REQUEST)
    with pytest.raises(Refused) as refused:
        bench.sign.set_all([(bench.at(Column.MULTI), b"B"), (bench.at(Column.BEACON), 1)])
    assert (refused.value.status, refused.value.index) == (10, 1)
    assert bench.sign.get(bench.at(Column.MULTI)) == TEXT.encode()


def test_every_object_that_is_walked_can_be_read() -> None:
    sign = Bench().sign
    names = sign.names()
    assert names == sorted(set(names))
    assert len([sign.get(name) for name in names]) > 300


def test_phases_alternate_and_the_face_shows_them() -> None:
    bench = Bench()
    bench.show(bench.store("[pt20o5]ONE[np]TWO"))
    shown = []
    for tenths in range(50):
        bench.sign.tick(tenths / 10 + 0.05)
        page = bench.sign.page_shown()
        word = page.lines[0].text if page else ""
        if not shown or shown[-1] != word:
            shown.append(word)
    assert shown == ["ONE", "", "TWO", ""]


def test_the_face_as_text_and_as_a_picture() -> None:
    bench = Bench()
    dark = face.png(bench.sign.page_shown(), 3, 8)
    bench.show(bench.store())
    page = bench.sign.page_shown()
    assert face.as_text(page, 3, 8).splitlines()[1:-1] == [
        "| STOPPED  |",
        "| TRAFFIC  |",
        "|          |",
    ]
    lit = Image.open(BytesIO(face.png(page, 3, 8))).convert("RGB")
    unlit = Image.open(BytesIO(dark)).convert("RGB")
    assert lit.size == unlit.size

    def amber(picture: Image.Image) -> int:
        pixels = picture.get_flattened_data()
        return sum(r > 200 and g > 120 and b < 90 for r, g, b in pixels)

    assert amber(lit) > 5000
    assert amber(unlit) == 0
