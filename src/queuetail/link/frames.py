"""Frames: a quantity as bytes for the radio, and an incremental decoder that survives noise.

A frame is header (3 letters), payload length (1 byte), number (1), time stamp in milliseconds (4),
payload, CRC-32 (4) of all before it.  CRC-32 as in IEEE 802.3; it finds every error of up to six
bits in frames of up to 171 bits before it (Koopman, DSN 2002, table 1), which all but STA are.
"""

from __future__ import annotations

import re
import struct
import zlib
from dataclasses import dataclass

from queuetail.link.messages import BY_HEADER, BY_RECORD, KINDS, Quantity

HEAD = struct.Struct(">3sBBI")
CRC_BYTES = 4
OVERHEAD_BYTES = HEAD.size + CRC_BYTES
HEADER = re.compile(b"|".join(kind.header.encode() for kind in KINDS))
HEADER_BYTES = 3
CLOCK_MS = 2**32  # the time stamp starts again after 49.7 days


@dataclass(frozen=True, slots=True)
class Message:
    """One quantity as it came over the link, with the sender's time stamp and frame number."""

    quantity: Quantity
    sent_s: float  # on the sender's clock
    number: int
    size: int  # bytes of its frame


@dataclass(slots=True)
class Counts:
    """What a decoder met so far."""

    messages: int = 0
    bad_frames: int = 0  # a header and a fitting length, but a wrong checksum
    impossible: int = 0  # a right checksum over a value that cannot be
    lost: int = 0  # gaps in the numbers of the frames
    skipped_bytes: int = 0  # that belong to no good frame


def encode(quantity: Quantity, sent_s: float, number: int) -> bytes:
    """Return the frame of a quantity; raises ValueError where its value cannot be sent."""
    kind = BY_RECORD[type(quantity)]
    payload = kind.pack(quantity)
    stamp = round(sent_s * 1000) % CLOCK_MS
    body = HEAD.pack(kind.header.encode(), len(payload), number % 256, stamp) + payload
    return body + zlib.crc32(body).to_bytes(CRC_BYTES, "big")


class Decoder:
    """Bytes in, messages out; after garbage it finds the next frame by itself."""

    def __init__(self) -> None:
        self.counts = Counts()
        self._buffer = bytearray()
        self._last: tuple[int, float] | None = None  # number and time stamp of the last frame

    def feed(self, data: bytes) -> list[Message]:
        """Take what arrived and return the messages that it completes."""
        buffer = self._buffer
        buffer += data
        messages: list[Message] = []
        start = 0
        while (found := HEADER.search(buffer, start)) is not None:
            self.counts.skipped_bytes += found.start() - start
            start = found.start()
            size = self._size_at(start)
            if size is None or len(buffer) - start < size:
                break  # the rest has not arrived yet
            message = self._message(bytes(buffer[start : start + size])) if size else None
            if message is None:
                self.counts.skipped_bytes += 1
                start += 1
            else:
                messages.append(message)
                start += size
        else:
            # What is left may be the first letters of a header.
            keep = max(start, len(buffer) - (HEADER_BYTES - 1))
            self.counts.skipped_bytes += keep - start
            start = keep
        del buffer[:start]
        return messages

    def _size_at(self, start: int) -> int | None:
        """Return the frame's size; None while its length is not here yet, 0 where it cannot be."""
        if len(self._buffer) <= start + HEADER_BYTES:
            return None
        kind = BY_HEADER[self._buffer[start : start + HEADER_BYTES].decode()]
        length = self._buffer[start + HEADER_BYTES]
        return length + OVERHEAD_BYTES if length in kind.lengths else 0

    def _message(self, frame: bytes) -> Message | None:
        body, crc = frame[:-CRC_BYTES], frame[-CRC_BYTES:]
        if zlib.crc32(body) != int.from_bytes(crc, "big"):
            self.counts.bad_frames += 1
            return None
        header, _, number, stamp_ms = HEAD.unpack_from(body)
        try:
            quantity = BY_HEADER[header.decode()].unpack(body[HEAD.size :])
        except ValueError:
            self.counts.impossible += 1
            return None
        sent_s = stamp_ms / 1000
        if self._last is not None and sent_s >= self._last[1] - 1.0:  # else the sender restarted
            self.counts.lost += (number - self._last[0] - 1) % 256
        self._last = number, sent_s
        self.counts.messages += 1
        return Message(quantity, sent_s, number, len(frame))
