"""NTCIP 1203 v04.08 (v01 to v03 in its deprecated objects): names, codes and the message CRC."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

Oid = tuple[int, ...]
DMS: Oid = (1, 3, 6, 1, 4, 1, 1206, 4, 2, 3)

SIGN_TYPE: Oid = (*DMS, 1, 2, 0)
CHARACTER_HEIGHT_PX: Oid = (*DMS, 2, 1, 0)
CHARACTER_WIDTH_PX: Oid = (*DMS, 2, 2, 0)
SIGN_HEIGHT_PX: Oid = (*DMS, 2, 3, 0)
SIGN_WIDTH_PX: Oid = (*DMS, 2, 4, 0)
MAX_PAGES: Oid = (*DMS, 4, 15, 0)
MAX_MULTI_LENGTH: Oid = (*DMS, 4, 16, 0)
MAX_CHANGEABLE: Oid = (*DMS, 5, 3, 0)
MESSAGE_ENTRY: Oid = (*DMS, 5, 8, 1)
VALIDATE_ERROR: Oid = (*DMS, 5, 9, 0)
CONTROL_MODE: Oid = (*DMS, 6, 1, 0)
ACTIVATE_MESSAGE: Oid = (*DMS, 6, 3, 0)
TIME_REMAINING: Oid = (*DMS, 6, 4, 0)
MESSAGE_SOURCE: Oid = (*DMS, 6, 5, 0)
REQUESTER: Oid = (*DMS, 6, 6, 0)
SOURCE_MODE: Oid = (*DMS, 6, 7, 0)
SHORT_POWER_MESSAGE: Oid = (*DMS, 6, 8, 0)
LONG_POWER_MESSAGE: Oid = (*DMS, 6, 9, 0)
RESET_MESSAGE: Oid = (*DMS, 6, 11, 0)
COMM_LOSS_MESSAGE: Oid = (*DMS, 6, 12, 0)
COMM_LOSS_MINUTES: Oid = (*DMS, 6, 13, 0)
END_DURATION_MESSAGE: Oid = (*DMS, 6, 15, 0)
ACTIVATE_ERROR: Oid = (*DMS, 6, 17, 0)
MULTI_ERROR: Oid = (*DMS, 6, 18, 0)
MULTI_ERROR_POSITION: Oid = (*DMS, 6, 19, 0)
ACTIVATE_MESSAGE_V4: Oid = (*DMS, 6, 26, 0)
SHORT_ERROR_STATUS: Oid = (*DMS, 9, 7, 1, 0)

INFINITE_MIN = 65535
MESSAGE_ERROR_BIT = 1 << 7  # of shortErrorStatus


class Column(IntEnum):
    """Columns of dmsMessageTable."""

    MEMORY_TYPE = 1
    NUMBER = 2
    MULTI = 3
    OWNER = 4
    CRC = 5
    BEACON = 6
    PIXEL_SERVICE = 7
    PRIORITY = 8
    STATUS = 9


class Memory(IntEnum):
    """dmsMessageMemoryType."""

    PERMANENT = 2
    CHANGEABLE = 3
    VOLATILE = 4
    CURRENT = 5
    SCHEDULE = 6
    BLANK = 7


class Status(IntEnum):
    """dmsMessageStatus; the last three are requests."""

    NOT_USED = 1
    MODIFYING = 2
    VALIDATING = 3
    VALID = 4
    ERROR = 5
    MODIFY_REQUEST = 6
    VALIDATE_REQUEST = 7
    NOT_USED_REQUEST = 8


class ControlMode(IntEnum):
    """dmsControlMode, without what is obsolete."""

    LOCAL = 2
    CENTRAL = 4
    CENTRAL_OVERRIDE = 5


class Source(IntEnum):
    """dmsMsgSourceMode: who put the current message on the sign."""

    OTHER = 1
    LOCAL = 2
    EXTERNAL = 3
    CENTRAL = 8
    SCHEDULER = 9
    POWER_RECOVERY = 10
    RESET = 11
    COMM_LOSS = 12
    POWER_LOSS = 13
    END_DURATION = 14


SOURCES = {
    Source.OTHER: "something else",
    Source.LOCAL: "an operator at the sign",
    Source.EXTERNAL: "a device connected at the sign",
    Source.CENTRAL: "central control (such as queuetail)",
    Source.SCHEDULER: "the sign's schedule",
    Source.POWER_RECOVERY: "power recovery",
    Source.RESET: "a reset",
    Source.COMM_LOSS: "loss of communications",
    Source.POWER_LOSS: "loss of power",
    Source.END_DURATION: "the end of the last message's duration",
}


def crc(multi: bytes, beacon: int = 0, pixel_service: int = 0) -> int:
    """Return dmsMessageCRC: CRC-16/X-25 of text, beacon and pixel service, bytes swapped."""
    register = 0xFFFF
    for byte in (*multi, beacon, pixel_service):
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0x8408 if register & 1 else 0)
    register ^= 0xFFFF
    return (register & 0xFF) << 8 | register >> 8


@dataclass(frozen=True, slots=True)
class MessageId:
    """MessageIDCode: one row of the message table and its text's CRC."""

    memory: int
    number: int
    crc: int = 0

    def encode(self) -> bytes:
        """Return the five octets of MessageIDCode."""
        return struct.pack(">BHH", self.memory, self.number, self.crc)

    @classmethod
    def decode(cls, octets: bytes) -> MessageId:
        """Read five octets; raises ValueError for any other number of them."""
        if len(octets) != 5:
            raise ValueError(f"a message ID code has 5 octets, not {len(octets)}")
        return cls(*struct.unpack(">BHH", octets))


@dataclass(frozen=True, slots=True)
class Activation:
    """MessageActivationCode: show this message, for how long, how urgently, on whose word."""

    minutes: int
    priority: int
    message: MessageId
    source_ip: tuple[int, int, int, int] = (127, 0, 0, 1)

    def encode(self) -> bytes:
        """Return the twelve octets of MessageActivationCode."""
        head = struct.pack(">HB", self.minutes, self.priority)
        return head + self.message.encode() + bytes(self.source_ip)

    def encode_v4(self) -> bytes:
        """Return the eight octets of MessageActivationCodeV4, which leaves the address out."""
        return self.encode()[:8]

    @classmethod
    def decode(cls, octets: bytes) -> Activation:
        """Read twelve octets, or eight (v04); raises ValueError for any other number of them."""
        if len(octets) not in (8, 12):
            raise ValueError(f"a message activation code has 12 octets, not {len(octets)}")
        minutes, priority = struct.unpack(">HB", octets[:3])
        a, b, c, d = octets[8:] or (0, 0, 0, 0)
        return cls(minutes, priority, MessageId.decode(octets[3:8]), (a, b, c, d))


BLANK = MessageId(Memory.BLANK, 1)


def cell(column: Column, memory: int, number: int) -> Oid:
    """Return the name of one cell of dmsMessageTable."""
    return (*MESSAGE_ENTRY, column, memory, number)
