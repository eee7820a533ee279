"""Every code that a sign may answer with, as one sentence with the mend."""

from __future__ import annotations

from queuetail.signs.multi import Syntax


class SignFault(Exception):  # noqa: N818 - it says what is wrong with the sign
    """What a sign refused or failed at, in one sentence for an operator."""


class SignSilent(SignFault):
    """The sign did not answer, or with nothing that could be understood."""


# SNMP error-status: RFC 1157 section 4.1.1 (1 to 5) and RFC 3416 section 3 (6 to 18).
SNMP_ERRORS = {
    1: "the answer would be too big for one packet",
    2: "it does not have this object",
    3: "it refuses this value",
    4: "this object can only be read",
    5: "it failed, and does not say why",
    6: "access to this object is not allowed",
    7: "the value is of the wrong type",
    8: "the value has the wrong length",
    9: "the value is wrongly encoded",
    10: "the value is out of range",
    11: "this row cannot be created",
    12: "the value does not go with the others",
    13: "it has no room for it now",
    14: "it could not carry out the change",
    15: "it could not undo the change",
    16: "these credentials may not do that",
    17: "this object cannot be written",
    18: "this row does not go with the others",
}

ACTIVATE_ERRORS = {
    1: "the sign cannot show the message, for a reason that the standard has no name for",
    2: "the sign refused, but reports no activation error",
    3: "a message with a higher priority is on the sign and stays there",
    4: "the message is not valid in the sign: it was changed by somebody else meanwhile",
    5: "the sign has no such kind of message memory",
    6: "the sign has no message with this number",
    7: "the text stored in the sign is not the one that was sent (checksums differ)",
    8: "the sign does not understand the text",
    9: "the sign is switched to local control: set it to central at its controller",
    10: "the sign is under central control and takes no local commands",
    11: "the sign is under central override and takes no local commands",
    12: "the sign's default font is not ready",
    13: "the sign does not have the beacon plan that the message asks for",
}

VALIDATE_ERRORS = {
    1: "the sign finds the message invalid, for a reason that the standard has no name for",
    2: "the sign finds the message invalid, but reports no error",
    3: "the sign has no such beacons",
    4: "the sign has no pixel service",
    5: "the sign does not understand the text",
}

SYNTAX_ERRORS = {
    Syntax.OTHER: "something the standard has no name for",
    Syntax.NONE: "nothing in particular",
    Syntax.UNSUPPORTED_TAG: "it does not know a tag",
    Syntax.UNSUPPORTED_TAG_VALUE: "it does not support a tag's value",
    Syntax.TEXT_TOO_BIG: "the text is larger than its face: give its size in the site file",
    Syntax.FONT_NOT_DEFINED: "it does not have the font",
    Syntax.CHARACTER_NOT_DEFINED: "its font does not have a character",
    Syntax.FIELD_DEVICE_NOT_EXIST: "a field device is not connected",
    Syntax.FIELD_DEVICE_ERROR: "a field device fails",
    Syntax.FLASH_REGION_ERROR: "it cannot flash that part",
    Syntax.TAG_CONFLICT: "tags contradict each other",
    Syntax.TOO_MANY_PAGES: "it cannot show so many pages: give phases in the site file",
    Syntax.FONT_VERSION_ID: "its font has another version",
    Syntax.GRAPHIC_ID: "its graphic has another version",
    Syntax.GRAPHIC_NOT_DEFINED: "it does not have the graphic",
    Syntax.INVALID_CHARACTER_ENCODING: "a character is wrongly encoded",
}

SHORT_ERRORS = {
    0: "another error",
    1: "a communications error",
    2: "a power error",
    3: "an attached device fails",
    4: "a lamp fails",
    5: "pixels fail",
    6: "a photocell fails",
    7: "a message error",
    8: "a controller error",
    9: "a temperature warning",
    10: "climate control fails",
    11: "a critical temperature: the face is dark",
    12: "a drum fails",
    13: "a door is open",
    14: "a humidity warning",
    15: "its default text is invisible",
}


def snmp_sentence(status: int, what: str) -> str:
    """Say why a request to do `what` was refused."""
    why = SNMP_ERRORS.get(status, f"it answers with the unknown SNMP error {status}")
    return f"the sign refused to {what}: {why}"


def activate_sentence(code: int, syntax: int | None = None, position: int | None = None) -> str:
    """Say why a message was not shown: dmsActivateMsgError."""
    sentence = ACTIVATE_ERRORS.get(code, f"the sign answers with the unknown error {code}")
    return sentence + (_syntax(syntax, position) if code == 8 else "")


def validate_sentence(code: int, syntax: int | None = None, position: int | None = None) -> str:
    """Say why a message was not valid: dmsValidateMessageError."""
    sentence = VALIDATE_ERRORS.get(code, f"the sign answers with the unknown error {code}")
    return sentence + (_syntax(syntax, position) if code == 5 else "")


def short_errors(bits: int) -> tuple[str, ...]:
    """Name the errors of shortErrorStatus."""
    return tuple(text for bit, text in SHORT_ERRORS.items() if bits >> bit & 1)


def _syntax(syntax: int | None, position: int | None) -> str:
    if syntax is None:
        return ""
    known = syntax in {s.value for s in Syntax}
    why = SYNTAX_ERRORS[Syntax(syntax)] if known else f"unknown syntax error {syntax}"
    place = f", at character {position + 1}" if position is not None else ""
    return f" ({why}{place})"
