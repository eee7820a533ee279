"""Made-up readings and bit errors, for the tests and the benchmark of the link."""

from __future__ import annotations

import math
from random import Random

from queuetail.link.frames import Message, encode
from queuetail.link.messages import (
    IDS,
    Altitude,
    Attitude,
    ClockSource,
    ClockTime,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lens,
    Lidar,
    Position,
    Quantity,
    Rate,
    Sensors,
    Status,
)

REMEMBERED = 512  # frames: a decoder is never further behind
STEP_S = 0.02


def random_quantity(random: Random) -> Quantity:
    """Return any quantity with any values that the link can carry."""
    angle = random.uniform(0, 359.99)
    makers = (
        lambda: Position(random.uniform(-90, 90), random.uniform(-180, 180)),
        lambda: Height(random.uniform(0, 150), random.choice(list(HeightSource))),
        lambda: Altitude(random.uniform(-50, 150), random.uniform(0, 900)),
        lambda: Heading(angle),
        lambda: Attitude(random.uniform(-30, 30), random.uniform(-30, 30)),
        lambda: Gimbal(angle, random.uniform(-90, 0), random.uniform(-5, 5)),
        lambda: Lidar(random.choice((None, random.uniform(1, 100)))),
        lambda: Lens(random.uniform(20, 120)),
        lambda: ClockTime(random.uniform(1.7e9, 1.9e9), ClockSource.GPS),
        lambda: Status(80, Sensors(3), tuple(Rate(h, 10.0, angle // 36) for h in IDS)),
    )
    return random.choice(makers)()


def flip_bits(data: bytes, bit_error_rate: float, random: Random) -> bytes:
    """Return the bytes with each bit flipped with the given probability."""
    if bit_error_rate <= 0:
        return data
    flipped = bytearray(data)
    bits = 8 * len(data)
    position = -1
    while True:  # the gaps between errors are geometrically distributed
        position += 1 + int(math.log(1 - random.random()) / math.log1p(-bit_error_rate))
        if position >= bits:
            return bytes(flipped)
        flipped[position // 8] ^= 1 << position % 8


class ReadingStream:
    """An endless stream of frames that knows what it sent."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._sent: dict[int, bytes] = {}
        self._count = 0

    def next_frame(self) -> bytes:
        """Return the next frame."""
        frame = encode(random_quantity(self._random), self._count * STEP_S, self._count)
        self._sent[self._count] = frame
        self._sent.pop(self._count - REMEMBERED, None)
        self._count += 1
        return frame

    def was_sent(self, message: Message) -> bool:
        """Tell whether a received message says, to the bit, what the frame of its time said."""
        again = encode(message.quantity, message.sent_s, message.number)
        return self._sent.get(round(message.sent_s / STEP_S)) == again
