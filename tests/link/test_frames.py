"""The link's frames: every value comes back, and noise never becomes a value."""

from __future__ import annotations

import math
import random
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from link_noise import ReadingStream, flip_bits
from queuetail.link.frames import OVERHEAD_BYTES, Decoder, encode
from queuetail.link.messages import (
    IDS,
    KINDS,
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
    header_of,
)
from queuetail.types import Ints

ROOT = Path(__file__).resolve().parent.parent.parent
tenths = st.integers(0, 255).map(lambda n: n / 10)
quantities = st.one_of(
    st.builds(Position, st.floats(-90, 90), st.floats(-180, 180)),
    st.builds(Height, st.floats(-500, 10_000), st.sampled_from(HeightSource)),
    st.builds(Altitude, st.none() | st.floats(-500, 9_000), st.none() | st.floats(-500, 9_000)),
    st.builds(Heading, st.floats(-720, 720)),
    st.builds(Attitude, st.floats(-180, 179.99), st.floats(-90, 90)),
    st.builds(
        Gimbal,
        st.none() | st.floats(-360, 720),
        st.none() | st.floats(-91, 91),
        st.none() | st.floats(-180, 179.99),
    ),
    st.builds(Lidar, st.none() | st.floats(0, 300)),
    st.builds(Lens, st.floats(0.1, 179.9)),
    st.builds(ClockTime, st.floats(1.6e9, 4e9), st.sampled_from(ClockSource)),
    st.builds(
        Status,
        st.integers(0, 255),
        st.sampled_from([Sensors(n) for n in range(4)]),
        st.lists(st.builds(Rate, st.sampled_from(sorted(IDS)), tenths, tenths), max_size=10).map(
            tuple
        ),
    ),
)


def near(a: Quantity, b: Quantity) -> bool:
    """Tell whether two records differ by no more than the wire's rounding."""
    if type(a) is not type(b):
        return False
    for name in a.__slots__:
        x, y = getattr(a, name), getattr(b, name)
        if not isinstance(x, float) or not isinstance(y, float):
            if x != y:
                return False
            continue
        step = 1e-7 if isinstance(a, Position) else 1e-6 if isinstance(a, ClockTime) else 0.01
        turned = (x - y + 180) % 360 - 180 if name in ("deg", "yaw_deg", "roll_deg") else x - y
        if abs(turned) > 0.51 * step + 1e-9 * abs(x):
            return False
    return True


@given(quantities, st.floats(0, 4e6), st.integers(0, 255))
def test_every_value_comes_back(quantity: Quantity, sent_s: float, number: int) -> None:
    frame = encode(quantity, sent_s, number)
    (message,) = Decoder().feed(frame)
    assert near(quantity, message.quantity)
    assert message.number == number
    assert message.sent_s == pytest.approx(round(sent_s * 1000) % 2**32 / 1000)
    assert message.size == len(frame)
    assert frame[:3].decode() == header_of(quantity)


@given(
    st.lists(quantities, min_size=1, max_size=6),
    st.lists(st.binary(max_size=40), min_size=7, max_size=7),
    st.integers(1, 50),
)
def test_garbage_between_frames_costs_no_frame(
    sent: list[Quantity], garbage: list[bytes], chunk: int
) -> None:
    """Whatever stands between, and in whatever pieces it arrives; only a cut header waits."""
    frames = [encode(q, i, i) for i, q in enumerate(sent)]
    data = b"".join(g + f for g, f in zip(garbage, frames, strict=False)) + bytes(64)
    decoder = Decoder()
    heard = []
    for start in range(0, len(data), chunk):
        heard += decoder.feed(data[start : start + chunk])
    assert [m.number for m in heard] == list(range(len(sent)))
    assert all(near(q, m.quantity) for q, m in zip(sent, heard, strict=True))
    counts = decoder.counts
    assert counts.skipped_bytes + sum(len(f) for f in frames) + 2 >= len(data)


@given(quantities, st.data())
def test_up_to_six_flipped_bits_are_always_found(quantity: Quantity, data: st.DataObject) -> None:
    frame = bytearray(encode(quantity, 12.345, 7))
    most = 4 if isinstance(quantity, Status) else 6
    bits = st.integers(0, 8 * len(frame) - 1)
    for bit in data.draw(st.sets(bits, min_size=1, max_size=most)):
        frame[bit // 8] ^= 1 << bit % 8
    assert Decoder().feed(bytes(frame)) == []


@pytest.mark.parametrize("bit_error_rate", [0.0, 1e-4, 1e-3, 1e-2])
def test_noise_never_becomes_a_value(bit_error_rate: float) -> None:
    stream = ReadingStream(random.Random(5))
    noise = random.Random(6)
    decoder = Decoder()
    count = 6_000
    for _ in range(count // 20):
        sent = b"".join(stream.next_frame() for _ in range(20))
        for message in decoder.feed(flip_bits(sent, bit_error_rate, noise)):
            assert stream.was_sent(message)
    good = decoder.counts.messages
    assert good >= count * (1 - bit_error_rate) ** 260 * 0.9 - 1
    assert (good == count) == (bit_error_rate == 0)


@given(st.binary(max_size=600))
def test_garbage_alone_is_no_message(garbage: bytes) -> None:
    assert Decoder().feed(garbage) == []


def test_a_right_checksum_over_an_impossible_value_is_refused() -> None:
    frame = bytearray(encode(Position(36.0, -97.0), 1.0, 0))
    frame[9:13] = (1_000_000_000).to_bytes(4, "big")  # 100° north
    frame[-4:] = zlib.crc32(frame[:-4]).to_bytes(4, "big")
    decoder = Decoder()
    assert decoder.feed(bytes(frame)) == []
    assert decoder.counts.impossible == 1


@pytest.mark.parametrize(
    "quantity",
    [
        Position(math.nan, 0.0),
        Position(91.0, 0.0),
        Heading(math.inf),
        Height(math.nan, HeightSource.LIDAR),
        Height(1e9, HeightSource.LIDAR),
        Gimbal(0.0, -120.0, 0.0),
        Lidar(-1.0),
        Lens(0.0),
        ClockTime(0.0, ClockSource.GPS),
        ClockTime(math.nan, ClockSource.GPS),
    ],
)
def test_what_cannot_be_sent_is_refused(quantity: Quantity) -> None:
    with pytest.raises(ValueError, match=r"is not|not within"):
        encode(quantity, 0.0, 0)


def test_lost_frames_are_counted_and_a_restart_is_no_loss() -> None:
    decoder = Decoder()
    for number, sent_s in ((0, 10.0), (1, 10.1), (5, 10.5), (6, 10.6), (0, 0.1), (1, 0.2)):
        decoder.feed(encode(Heading(1.0), sent_s, number))
    assert decoder.counts.lost == 3


def test_the_worked_example_of_the_document() -> None:
    """docs/telemetry-link.md shows two frames in hexadecimal and what they mean."""
    text = (ROOT / "docs" / "telemetry-link.md").read_text("utf-8")
    block = re.search(r"^```hex\n(.*?)^```", text, re.M | re.S)
    assert block is not None
    hexadecimal = " ".join(line.split("#")[0] for line in block[1].splitlines())
    heard = Decoder().feed(bytes.fromhex(hexadecimal))
    assert [m.quantity for m in heard] == [
        Position(36.1101897, -97.0575359),
        Gimbal(75.02, -55.0, None),
    ]
    assert [(m.sent_s, m.number) for m in heard] == [(83.25, 41), (83.251, 42)]


def test_the_document_lists_every_kind_with_its_size() -> None:
    text = (ROOT / "docs" / "telemetry-link.md").read_text("utf-8")
    for kind in KINDS:
        row = re.search(rf"^\| {IDS[kind.header]} \| `{kind.header}` \| (\d+)", text, re.M)
        assert row is not None, kind.header
        assert int(row[1]) == kind.lengths[0] + OVERHEAD_BYTES


def syndromes(size: int) -> Ints:
    """Return what each flipped bit of a frame of so many bytes does to its checksum."""
    body = bytes(size - 4)
    plain = zlib.crc32(body)
    found = []
    for bit in range(8 * len(body)):
        flipped = bytearray(body)
        flipped[bit // 8] ^= 1 << bit % 8
        found.append(zlib.crc32(flipped) ^ plain)
    return np.array(found + [1 << bit for bit in range(32)], np.int64)


@pytest.mark.parametrize(("size", "flips"), [(22, 6), (45, 4)])
def test_no_pattern_of_so_few_flips_is_missed(size: int, flips: int) -> None:
    """The checksum is linear: if all patterns of half as many flips differ, none of so many is 0.

    Proves the distances of docs/telemetry-link.md for the longest frame but STA, and for STA.
    """
    single = syndromes(size)
    patterns = [np.zeros(1, np.int64), single]
    first, second = np.triu_indices(len(single), 1)
    pairs = single[first] ^ single[second]
    patterns.append(pairs)
    if flips == 6:
        patterns += [pairs[second < third] ^ single[third] for third in range(len(single))]
    everything = np.concatenate(patterns)
    assert len(np.unique(everything)) == len(everything)
