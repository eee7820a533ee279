"""NTCIP 1203: the MIB's own vector, its enumerations, MULTI there and back."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.signs import faults, ntcip
from queuetail.signs.faults import activate_sentence, short_errors, snmp_sentence, validate_sentence
from queuetail.signs.multi import MultiError, Syntax, build, parse, phases_of
from queuetail.signs.ntcip import Activation, Memory, MessageId, crc

MIB = Path(__file__).resolve().parents[3] / "shared" / "data" / "ntcip" / "NTCIP1203-Dms.mib"
OFFICIAL = b"[jp3]TEST [fl]Flashing[/fl]"


def test_the_mibs_own_example_of_a_message() -> None:
    """NTCIP1203-Dms.mib, MessageIDCode and MessageActivationCode."""
    message = MessageId(Memory.VOLATILE, 5, crc(OFFICIAL, 0, 0))
    assert message.encode().hex(" ") == "04 00 05 95 f9"
    code = Activation(267, 55, message, (103, 8, 9, 10))
    assert code.encode().hex(" ") == "01 0b 37 04 00 05 95 f9 67 08 09 0a"
    assert Activation.decode(code.encode()) == code
    assert Activation.decode(code.encode_v4()).message == message


@pytest.mark.parametrize("octets", [b"", b"1234", b"123456"])
def test_codes_of_another_length_are_refused(octets: bytes) -> None:
    with pytest.raises(ValueError, match="5 octets"):
        MessageId.decode(octets)
    with pytest.raises(ValueError, match="12 octets"):
        Activation.decode(octets)


def mib() -> str:
    if not MIB.exists():
        pytest.skip(f"{MIB.name} is not beside the project")
    return MIB.read_text("latin-1")


def enumeration(name: str) -> dict[int, str]:
    """Return the numbers and names of an enumerated object of the MIB."""
    body = re.search(rf"^\s*{name}\s+OBJECT-TYPE(.*?)\}}", mib(), re.S | re.M)
    assert body is not None
    text = re.sub(r"--[^\n]*", "", body[1])
    return {int(n): word for word, n in re.findall(r"(\w+)\s*\(\s*(\d+)\s*\)", text)}


@pytest.mark.parametrize(
    ("name", "sentences"),
    [
        ("dmsActivateMsgError", faults.ACTIVATE_ERRORS),
        ("dmsValidateMessageError", faults.VALIDATE_ERRORS),
        ("dmsMultiSyntaxError", faults.SYNTAX_ERRORS),
    ],
)
def test_every_error_of_the_mib_has_its_sentence(name: str, sentences: dict[int, str]) -> None:
    assert set(enumeration(name)) == {int(n) for n in sentences}
    assert len(set(sentences.values())) == len(sentences)


@pytest.mark.parametrize(
    ("name", "ours"),
    [
        ("dmsMessageStatus", ntcip.Status),
        ("dmsControlMode", ntcip.ControlMode),
        ("dmsMessageMemoryType", ntcip.Memory),
        ("dmsMsgSourceMode", ntcip.Source),
        ("dmsMultiSyntaxError", Syntax),
    ],
)
def test_our_numbers_are_the_mibs(name: str, ours: type[ntcip.Status]) -> None:
    theirs = {word.lower(): n for n, word in enumeration(name).items()}
    renamed = {"modifyrequest": "modifyreq", "validaterequest": "validatereq"}
    renamed |= {"notusedrequest": "notusedreq", "scheduler": "timebasedscheduler"}
    renamed |= {"current": "currentbuffer"}
    for member in ours:
        word = member.name.lower().replace("_", "")
        assert theirs[renamed.get(word, word)] == member.value


@pytest.mark.parametrize(
    ("name", "oid"),
    [
        ("dmsControlMode", ntcip.CONTROL_MODE),
        ("dmsActivateMessage", ntcip.ACTIVATE_MESSAGE),
        ("dmsMessageTimeRemaining", ntcip.TIME_REMAINING),
        ("dmsMsgTableSource", ntcip.MESSAGE_SOURCE),
        ("dmsMsgSourceMode", ntcip.SOURCE_MODE),
        ("dmsShortPowerRecoveryMessage", ntcip.SHORT_POWER_MESSAGE),
        ("dmsLongPowerRecoveryMessage", ntcip.LONG_POWER_MESSAGE),
        ("dmsResetMessage", ntcip.RESET_MESSAGE),
        ("dmsCommunicationsLossMessage", ntcip.COMM_LOSS_MESSAGE),
        ("dmsTimeCommLoss", ntcip.COMM_LOSS_MINUTES),
        ("dmsEndDurationMessage", ntcip.END_DURATION_MESSAGE),
        ("dmsActivateMsgError", ntcip.ACTIVATE_ERROR),
        ("dmsMultiSyntaxError", ntcip.MULTI_ERROR),
        ("dmsMultiSyntaxErrorPosition", ntcip.MULTI_ERROR_POSITION),
        ("dmsActivateMessageV4", ntcip.ACTIVATE_MESSAGE_V4),
        ("dmsValidateMessageError", ntcip.VALIDATE_ERROR),
        ("shortErrorStatus", ntcip.SHORT_ERROR_STATUS),
        ("vmsSignWidthPixels", ntcip.SIGN_WIDTH_PX),
        ("dmsMaxMultiStringLength", ntcip.MAX_MULTI_LENGTH),
        ("dmsMaxNumberPages", ntcip.MAX_PAGES),
        ("dmsMaxChangeableMsg", ntcip.MAX_CHANGEABLE),
    ],
)
def test_our_object_names_are_the_mibs(name: str, oid: ntcip.Oid) -> None:
    groups = {"vmsCfg": 2, "multiCfg": 4, "dmsMessage": 5, "signControl": 6, "statError": 9}
    place = re.search(rf"^\s*{name}\s+OBJECT-TYPE.*?::=\s*\{{\s*(\w+)\s+(\d+)", mib(), re.S | re.M)
    assert place is not None
    assert place[1] in groups
    assert oid[len(ntcip.DMS)] == groups[place[1]]
    assert oid[-2:] == (int(place[2]), 0)


def test_sentences_of_errors() -> None:
    assert "higher priority" in activate_sentence(3)
    assert "local control" in activate_sentence(9)
    assert activate_sentence(8, 5, 12).endswith("size in the site file, at character 13)")
    assert "unknown error 99" in activate_sentence(99)
    assert "unknown syntax error 77" in validate_sentence(5, 77, 0)
    assert snmp_sentence(17, "x") == "the sign refused to x: this object cannot be written"
    assert "unknown SNMP error 250" in snmp_sentence(250, "x")
    assert short_errors(0b1000_0010_0000) == (
        "pixels fail",
        "a critical temperature: the face is dark",
    )


def test_multi_of_two_phases() -> None:
    phases = (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))
    multi = build(phases, 2.5)
    assert multi == ("[pt25o0][jp3][jl3]STOPPED[nl]TRAFFIC[nl]1/2 MILE[np]PREPARE[nl]TO STOP")
    pages = parse(multi)
    assert [p.on_s for p in pages] == [2.5, 2.5]
    assert [p.off_s for p in pages] == [0.0, 0.0]
    assert build((("A",),), 2.5) == "[jp3][jl3]A"
    assert build((), 2.5) == ""
    assert phases_of("") == ()


LINE = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=10)


@given(st.lists(st.lists(LINE, min_size=1, max_size=3).map(tuple), min_size=1, max_size=2))
def test_multi_there_and_back(phases: list[tuple[str, ...]]) -> None:
    assert phases_of(build(tuple(phases), 2.5)) == tuple(phases)


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        pages = parse(text)
    except MultiError as error:
        pages = ()
        place = error.position
    else:
        place = 0
    assert 0 <= place <= len(text)
    assert len(pages) <= text.lower().count("[np") + 1


@pytest.mark.parametrize(
    ("multi", "syntax", "position"),
    [
        ("AB[xx]", Syntax.UNSUPPORTED_TAG, 2),
        ("AB[", Syntax.UNSUPPORTED_TAG, 2),
        ("[jl9]A", Syntax.UNSUPPORTED_TAG_VALUE, 0),
        ("A\tB", Syntax.CHARACTER_NOT_DEFINED, 1),
        ("[pt0o0]A", Syntax.UNSUPPORTED_TAG_VALUE, 0),
        ("[g1]", Syntax.UNSUPPORTED_TAG, 0),
    ],
)
def test_what_is_wrong_in_a_text_and_where(multi: str, syntax: Syntax, position: int) -> None:
    with pytest.raises(MultiError) as refused:
        parse(multi)
    assert (refused.value.syntax, refused.value.position) == (syntax, position)


def test_tags_of_layout_are_understood() -> None:
    (page,) = parse("[JP2][jl2]A[nl][jl4][FL]B[/fl]C[nl3][hc41][fo1][[x]]")
    assert page.vertical == "top"
    assert [line.justify for line in page.lines] == ["left", "right", "right"]
    assert [line.text for line in page.lines] == ["A", "BC", "A[x]"]
    assert [line.flash for line in page.lines] == [False, True, False]
