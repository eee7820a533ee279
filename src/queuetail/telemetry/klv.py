"""MISB ST 0601 local sets: what a packet says of the camera, through the library `stanag4609`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from stanag4609.errors import Stanag4609Error
from stanag4609.klv.ber import decode_ber_length
from stanag4609.klv.checksum import running_sum_16
from stanag4609.klv.local_set import encode_local_set, parse_local_set
from stanag4609.klv.model import KLVPacket
from stanag4609.st0601 import ST0601_KEY, FieldDecodingMode, decode_uas_local_set

from queuetail.errors import InputError
from queuetail.telemetry.klv_pose import height_agl_m, sensor_angles_deg
from queuetail.telemetry.reading import Reading
from queuetail.types import TelemetrySample

KEY_START = b"\x06\x0e\x2b\x34"  # of every SMPTE universal label (ST 336)
LATITUDE, LONGITUDE, HFOV, TIME, CHECKSUM = 13, 14, 16, 2, 1
KEY_BYTES, MAX_LENGTH_BYTES, CHECKSUM_BYTES = 16, 9, 4
CHECKSUM_HEAD = b"\x01\x02"  # tag 1, two bytes: always the last item
EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
# Only these are decoded: a fault in any other item must not cost the whole packet.
TAGS = frozenset(
    (TIME, 5, 6, 7, LATITUDE, LONGITUDE, 15, HFOV, 18, 19, 20, 21, 23, 24, 25, 75, 78, 90, 91, 104)
)


@dataclass(slots=True)
class Losses:
    """How many packets were of no use, by reason."""

    packets: int = 0
    checksum: int = 0
    malformed: int = 0
    old: int = 0

    def notes(self) -> tuple[str, ...]:
        """One sentence for each reason that occurred."""
        reasons = (
            (self.checksum, "dropped: wrong checksum"),
            (self.malformed, "dropped: malformed"),
            (self.old, "not read: they are not ST 0601 (the older EG 0104, perhaps)"),
        )
        return tuple(
            f"{count} of {self.packets} KLV packets {why}" for count, why in reasons if count
        )


@dataclass(frozen=True, slots=True)
class Packet:
    """The numbers of one local set by tag, and its time stamp in seconds since 1970."""

    values: Mapping[int, float]
    stamp_s: float | None


def is_klv(head: bytes) -> bool:
    """Tell whether the bytes start with a KLV packet."""
    return head.startswith(KEY_START)


def decode(data: bytes, losses: Losses) -> list[Packet]:
    """Decode all complete packets in `data`, counting those that are of no use.

    After a damaged packet the search goes on at the next key, inside it if need be.
    """
    packets = []
    start = data.find(KEY_START)
    while start >= 0:
        losses.packets += 1
        raw = _frame(data, start)
        packet = _decode_one(raw, losses)
        if packet is not None:
            packets.append(packet)
        if raw is not None and (packet is not None or raw.key != ST0601_KEY):
            start = data.find(KEY_START, start + len(raw.raw))
        else:
            start = data.find(ST0601_KEY, start + KEY_BYTES)
    return packets


def _frame(data: bytes, start: int) -> KLVPacket | None:
    """Return the packet whose key is at `start`; None where it is not complete."""
    body = start + KEY_BYTES
    try:
        length, used = decode_ber_length(data[body : body + MAX_LENGTH_BYTES], canonical=False)
    except Stanag4609Error:
        return None
    end = body + used + length
    if end > len(data):
        return None
    return KLVPacket(data[start:body], data[body + used : end], data[body : body + used], start)


def _decode_one(raw: KLVPacket | None, losses: Losses) -> Packet | None:
    if raw is None:
        losses.malformed += 1
        return None
    if raw.key != ST0601_KEY:
        losses.old += 1
        return None
    if raw.value[-CHECKSUM_BYTES:-2] != CHECKSUM_HEAD:
        losses.malformed += 1
        return None
    if running_sum_16(raw.raw[:-2]).to_bytes(2, "big") != raw.value[-2:]:
        losses.checksum += 1
        return None
    try:
        items = parse_local_set(raw.value, canonical=False).items
        wanted = {item.tag: item for item in items if item.tag in TAGS}
        ordered = sorted(wanted.values(), key=lambda item: item.tag != TIME)
        value = encode_local_set([*ordered, items[-1]])
        local_set = decode_uas_local_set(
            KLVPacket(ST0601_KEY, value, b""),
            verify_checksum=False,  # checked above, on the packet as it came
            require_timestamp=False,
            require_version=False,
            field_decoding=FieldDecodingMode.PRESERVE,
        )
    except (Stanag4609Error, ValueError, ArithmeticError):
        losses.malformed += 1
        return None
    values: dict[int, float] = {}
    stamp_s: float | None = None
    for field in local_set.fields:
        if isinstance(field.value, datetime):
            stamp_s = (field.value - EPOCH).total_seconds()
        elif isinstance(field.value, int | float) and field.definition.tag != CHECKSUM:
            values[field.definition.tag] = float(field.value)
    return Packet(values, stamp_s)


def sample_of(packet: Packet, t_s: float) -> tuple[TelemetrySample, frozenset[str]]:
    """Return what the packet says of the camera, and notes on what was derived rather than read."""
    values = packet.values
    yaw, pitch, roll, angle_notes = sensor_angles_deg(values)
    height, height_notes = height_agl_m(values, pitch)
    sample = TelemetrySample(
        t_s=t_s,
        lat_deg=values.get(LATITUDE),
        lon_deg=values.get(LONGITUDE),
        height_agl_m=height,
        heading_deg=yaw,
        gimbal_pitch_deg=pitch,
        gimbal_roll_deg=roll,
        hfov_deg=values.get(HFOV),
    )
    return sample, frozenset((*angle_notes, *height_notes))


def reading_of(timed: Iterable[tuple[float, Packet]], losses: Losses) -> Reading:
    """Turn packets with times into a reading; each note is given once."""
    samples: list[TelemetrySample] = []
    notes: set[str] = set()
    for t_s, packet in timed:
        sample, sample_notes = sample_of(packet, t_s)
        samples.append(sample)
        notes |= sample_notes
    return Reading(samples, (*losses.notes(), *sorted(notes)))


def refuse_without(packets: Sequence[object], source: str, losses: Losses) -> None:
    """Raise InputError when no packet is left, saying why."""
    if packets:
        return
    if losses.old and losses.old == losses.packets:
        raise InputError(
            f"{source}: its KLV metadata is not MISB ST 0601 but another set, such as the old "
            "EG 0104, which queuetail does not read; give the telemetry as a file"
        )
    why = "; ".join(losses.notes()) or "no packets were found"
    raise InputError(f"{source}: no MISB ST 0601 packet can be used ({why})")


def read_klv(data: bytes, source: str) -> Reading:
    """Read concatenated packets; times come from the precision time stamp (tag 2)."""
    losses = Losses()
    packets = decode(data, losses)
    refuse_without(packets, source, losses)
    return reading_by_stamps(packets, source, losses)


def reading_by_stamps(packets: list[Packet], source: str, losses: Losses) -> Reading:
    """Turn packets into a reading by their own time stamps; raises InputError without any."""
    stamped = [(packet.stamp_s, packet) for packet in packets if packet.stamp_s is not None]
    if not stamped:
        raise InputError(f"{source}: its KLV packets have no time stamp (tag 2), so no time")
    first = min(stamp for stamp, _ in stamped)
    reading = reading_of([(stamp - first, packet) for stamp, packet in stamped], losses)
    return Reading(reading.samples, reading.notes, EPOCH + timedelta(seconds=first))
