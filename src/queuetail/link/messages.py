"""The quantities of the telemetry link, and the bytes of each (docs/telemetry-link.md).

Every quantity has its own three-letter header and is sent at its own rate, as in Messenger et al.
(2023).  Numbers are big-endian integers in fixed units.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, IntFlag

NO_ANGLE, NO_YAW, NO_RANGE, NO_LENGTH = -(2**15), 2**16 - 1, 2**16 - 1, -(2**31)
FULL_TURN_CDEG = 36_000
MAX_LENGTH_CM = 2_000_000  # 20 km: no drone that watches a road is higher
PITCH_LIMIT_CDEG = 9_100  # gimbals looking straight down report up to -90.1
EARLIEST_UTC_US, LATEST_UTC_US = 1_577_836_800_000_000, 4_102_444_800_000_000  # 2020 … 2100


class HeightSource(IntEnum):
    """How a height above the ground was found, best first."""

    LIDAR = 1
    LIDAR_AND_ALTITUDE = 2  # the altitude, corrected by what the lidar said last
    TAKEOFF = 3  # the height above the take-off point


class ClockSource(IntEnum):
    """Whose clock a UTC is."""

    COMPANION = 0  # the companion computer's own, which may never have been set
    GPS = 1  # through the flight controller


class Sensors(IntFlag):
    """Which parts of the drone's end are heard."""

    NONE = 0
    FLIGHT_CONTROLLER = 1
    LIDAR = 2


@dataclass(frozen=True, slots=True)
class Position:
    """POS: where the drone is, WGS84."""

    lat_deg: float
    lon_deg: float


@dataclass(frozen=True, slots=True)
class Height:
    """HGT: metres from the ground below up to the drone."""

    agl_m: float
    source: HeightSource


@dataclass(frozen=True, slots=True)
class Altitude:
    """ALT: metres above the take-off point and above mean sea level."""

    above_takeoff_m: float | None = None
    msl_m: float | None = None


@dataclass(frozen=True, slots=True)
class Heading:
    """HDG: where the drone's nose points, clockwise from true north."""

    deg: float


@dataclass(frozen=True, slots=True)
class Attitude:
    """ATT: the drone's own roll (right side down is positive) and pitch (nose up is positive)."""

    roll_deg: float
    pitch_deg: float


@dataclass(frozen=True, slots=True)
class Gimbal:
    """GMB: the camera's yaw from true north, pitch (-90 straight down) and roll."""

    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None


@dataclass(frozen=True, slots=True)
class Lidar:
    """LDR: the rangefinder's distance; ``None`` while it gets no echo."""

    range_m: float | None


@dataclass(frozen=True, slots=True)
class Lens:
    """FOV: the horizontal field of view of the video."""

    hfov_deg: float


@dataclass(frozen=True, slots=True)
class ClockTime:
    """TIM: the UTC, in seconds since 1970, at the message's time stamp."""

    utc_s: float
    source: ClockSource


@dataclass(frozen=True, slots=True)
class Rate:
    """How often one quantity is wanted, and how often it was sent."""

    header: str
    wanted_hz: float
    sent_hz: float

    @property
    def is_reduced(self) -> bool:
        """Whether the line was too full for the wanted rate (a tenth less counts as kept)."""
        return self.sent_hz < 0.9 * self.wanted_hz - 0.1


@dataclass(frozen=True, slots=True)
class Status:
    """STA: how full the line is, which sensors are heard, and the rates achieved."""

    load_percent: int
    sensors: Sensors
    rates: tuple[Rate, ...]


Quantity = (
    Position | Height | Altitude | Heading | Attitude | Gimbal | Lidar | Lens | ClockTime | Status
)


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of message: its header, the record it carries, and its payload's bytes."""

    header: str
    record: type[Quantity]
    lengths: range  # of the payload, in bytes
    pack: Callable[..., bytes]
    unpack: Callable[[bytes], Quantity]  # raises ValueError for values that cannot be


def _fixed(header: str, record: type[Quantity], layout: str, to: Callable[..., tuple[int, ...]],
           back: Callable[..., Quantity]) -> Kind:  # fmt: skip
    """Describe a kind whose payload is one structure of integers."""
    shape = struct.Struct(f">{layout}")
    return Kind(
        header,
        record,
        range(shape.size, shape.size + 1),
        lambda quantity: shape.pack(*to(quantity)),
        lambda payload: back(*shape.unpack(payload)),
    )


def _within(value: int, low: int, high: int) -> int:
    if not low <= value <= high:
        raise ValueError(f"{value} is not within {low} … {high}")
    return value


def _centi(value: float, low: int, high: int) -> int:
    """Return hundredths; raises ValueError where they are not within the limits or no number."""
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a number")
    return _within(round(value * 100), low, high)


def _turn(deg: float) -> int:
    return _centi(deg % 360.0, 0, FULL_TURN_CDEG) % FULL_TURN_CDEG


def _signed_turn(deg: float) -> int:
    return _centi((deg + 180.0) % 360.0 - 180.0, -18_000, 18_000)


def _pack_position(p: Position) -> tuple[int, int]:
    if not (math.isfinite(p.lat_deg) and math.isfinite(p.lon_deg)):
        raise ValueError("a position that is not a number")
    return (
        _within(round(p.lat_deg * 1e7), -900_000_000, 900_000_000),
        _within(round(p.lon_deg * 1e7), -1_800_000_000, 1_800_000_000),
    )


def _unpack_position(lat: int, lon: int) -> Position:
    _within(lat, -900_000_000, 900_000_000)
    _within(lon, -1_800_000_000, 1_800_000_000)
    return Position(lat / 1e7, lon / 1e7)


def _length(value: float | None) -> int:
    return NO_LENGTH if value is None else _centi(value, -MAX_LENGTH_CM, MAX_LENGTH_CM)


def _metres(centimetres: int) -> float:
    return _within(centimetres, -MAX_LENGTH_CM, MAX_LENGTH_CM) / 100


def _unpack_altitude(above_takeoff: int, msl: int) -> Altitude:
    return Altitude(
        None if above_takeoff == NO_LENGTH else _metres(above_takeoff),
        None if msl == NO_LENGTH else _metres(msl),
    )


def _pack_gimbal(g: Gimbal) -> tuple[int, int, int]:
    return (
        NO_YAW if g.yaw_deg is None else _turn(g.yaw_deg),
        NO_ANGLE
        if g.pitch_deg is None
        else _centi(g.pitch_deg, -PITCH_LIMIT_CDEG, PITCH_LIMIT_CDEG),
        NO_ANGLE if g.roll_deg is None else _signed_turn(g.roll_deg),
    )


def _unpack_gimbal(yaw: int, pitch: int, roll: int) -> Gimbal:
    return Gimbal(
        None if yaw == NO_YAW else _within(yaw, 0, FULL_TURN_CDEG - 1) / 100,
        None if pitch == NO_ANGLE else _within(pitch, -PITCH_LIMIT_CDEG, PITCH_LIMIT_CDEG) / 100,
        None if roll == NO_ANGLE else _within(roll, -18_000, 18_000) / 100,
    )


def _pack_time(t: ClockTime) -> tuple[int, int]:
    if not math.isfinite(t.utc_s):
        raise ValueError("a time that is not a number")
    return _within(round(t.utc_s * 1e6), EARLIEST_UTC_US, LATEST_UTC_US), t.source


def _unpack_time(utc_us: int, source: int) -> ClockTime:
    return ClockTime(_within(utc_us, EARLIEST_UTC_US, LATEST_UTC_US) / 1e6, ClockSource(source))


def _tenths(rate_hz: float) -> int:
    return min(round(rate_hz * 10), 255)


def _pack_status(s: Status) -> bytes:
    rates = b"".join(
        bytes((IDS[r.header], _tenths(r.wanted_hz), _tenths(r.sent_hz))) for r in s.rates
    )
    return bytes((_within(s.load_percent, 0, 255), s.sensors)) + rates


def _unpack_status(payload: bytes) -> Status:
    _within(payload[1], 0, Sensors.FLIGHT_CONTROLLER | Sensors.LIDAR)
    rows = [payload[i : i + 3] for i in range(2, len(payload), 3)]
    if any(row[0] not in HEADERS for row in rows):
        raise ValueError("a status of an unknown quantity")
    rates = tuple(Rate(HEADERS[i], wanted / 10, sent / 10) for i, wanted, sent in rows)
    return Status(payload[0], Sensors(payload[1]), rates)


# A quantity's number in STA is its place in this list, from 1.
KINDS = (
    _fixed("POS", Position, "ii", _pack_position, _unpack_position),
    _fixed("HGT", Height, "iB", lambda h: (_length(h.agl_m), h.source),
           lambda cm, source: Height(_metres(cm), HeightSource(source))),
    _fixed("ALT", Altitude, "ii", lambda a: (_length(a.above_takeoff_m), _length(a.msl_m)),
           _unpack_altitude),
    _fixed("HDG", Heading, "H", lambda h: (_turn(h.deg),),
           lambda cdeg: Heading(_within(cdeg, 0, FULL_TURN_CDEG - 1) / 100)),
    _fixed("ATT", Attitude, "hh",
           lambda a: (_signed_turn(a.roll_deg), _centi(a.pitch_deg, -9_000, 9_000)),
           lambda roll, pitch: Attitude(_within(roll, -18_000, 18_000) / 100,
                                        _within(pitch, -9_000, 9_000) / 100)),
    _fixed("GMB", Gimbal, "Hhh", _pack_gimbal, _unpack_gimbal),
    _fixed("LDR", Lidar, "H",
           lambda r: (NO_RANGE if r.range_m is None else _centi(r.range_m, 0, 60_000),),
           lambda cm: Lidar(None if cm == NO_RANGE else _within(cm, 0, 60_000) / 100)),
    _fixed("FOV", Lens, "H", lambda f: (_centi(f.hfov_deg, 1, 17_999),),
           lambda cdeg: Lens(_within(cdeg, 1, 17_999) / 100)),
    _fixed("TIM", ClockTime, "QB", _pack_time, _unpack_time),
    Kind("STA", Status, range(2, 2 + 3 * 10 + 1, 3), _pack_status, _unpack_status),
)  # fmt: skip
BY_HEADER = {kind.header: kind for kind in KINDS}
BY_RECORD = {kind.record: kind for kind in KINDS}
IDS = {kind.header: number for number, kind in enumerate(KINDS, 1)}
HEADERS = {number: header for header, number in IDS.items()}


def header_of(quantity: Quantity) -> str:
    """Return the three letters of a quantity."""
    return BY_RECORD[type(quantity)].header
