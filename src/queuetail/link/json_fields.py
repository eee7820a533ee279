"""JSON telemetry as quantities: our own names, and those of DJI's Cloud API (osd, osd_info_push).

Source: developer.dji.com, Cloud API, `thing/product/{sn}/osd` and the DRC method `osd_info_push`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from queuetail.link.messages import (
    Altitude,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lens,
    Lidar,
    Position,
    Quantity,
)

PAYLOAD_INDEX = re.compile(r"^\d+-\d+-\d+$")  # type-subtype-gimbal: where DJI puts the camera


@dataclass(frozen=True, slots=True)
class JsonReading:
    """What one JSON text says; ``sent_s`` is on the sender's own clock, ``utc_s`` since 1970."""

    quantities: tuple[Quantity, ...]
    sent_s: float | None = None
    utc_s: float | None = None
    gateway: str | None = None  # DJI's serial number of the remote controller or dock


def read_json(text: str | bytes) -> JsonReading | None:
    """Return what the text says; None where it is no JSON object."""
    try:
        raw = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(raw, dict):
        return None
    data = raw.get("data")
    if isinstance(data, dict):
        return _dji(raw, data)
    return _dji(raw, raw) if "latitude" in raw else _own(raw)


def _own(raw: Mapping[str, Any]) -> JsonReading:
    """Read the names of our telemetry table (docs/telemetry-link.md)."""
    lat, lon = _number(raw, "lat"), _number(raw, "lon")
    found: list[Quantity] = []
    if lat is not None and lon is not None and (lat or lon):
        found.append(Position(lat, lon))
    gimbal = Gimbal(
        _number(raw, "heading_deg"),
        _number(raw, "gimbal_pitch_deg"),
        _number(raw, "gimbal_roll_deg"),
    )
    if gimbal != Gimbal():
        found.append(gimbal)
    if (deg := _number(raw, "drone_heading_deg")) is not None:
        found.append(Heading(deg))
    if (metres := _number(raw, "height_agl_m")) is not None:
        found.append(Height(metres, HeightSource.LIDAR))
    if (metres := _number(raw, "height_takeoff_m")) is not None:
        found.append(Altitude(metres))
    if "lidar_m" in raw:
        found.append(Lidar(_number(raw, "lidar_m")))
    if (deg := _number(raw, "hfov_deg")) is not None:
        found.append(Lens(deg))
    utc_s = _utc(raw.get("utc"))
    sent_s = _number(raw, "t_s")
    return JsonReading(tuple(found), utc_s if sent_s is None else sent_s, utc_s)


def _dji(raw: Mapping[str, Any], data: Mapping[str, Any]) -> JsonReading:
    """Read DJI's names; its gimbal yaw counts from true north."""
    lat, lon = _number(data, "latitude"), _number(data, "longitude")
    found: list[Quantity] = []
    if lat is not None and lon is not None and (lat or lon):
        found.append(Position(lat, lon))
    if (head := _number(data, "attitude_head")) is not None:
        found.append(Heading(head % 360.0))
    if (above_takeoff := _number(data, "elevation")) is not None:
        found.append(Altitude(above_takeoff))
    gimbal = _dji_gimbal(data)
    if gimbal is not None:
        found.append(gimbal)
    stamp_ms = _number(raw, "timestamp")
    stamp_s = None if stamp_ms is None else stamp_ms / 1000
    gateway = raw.get("gateway")
    return JsonReading(
        tuple(found), stamp_s, stamp_s, gateway if isinstance(gateway, str) else None
    )


def _dji_gimbal(data: Mapping[str, Any]) -> Gimbal | None:
    """Return the first camera's angles: beside the position (DRC), or under its payload index."""
    holders = [data]
    holders += [
        value
        for key, value in sorted(data.items())
        if PAYLOAD_INDEX.match(key) and isinstance(value, dict)
    ]
    for holder in holders:
        yaw = _number(holder, "gimbal_yaw")
        pitch = _number(holder, "gimbal_pitch")
        if yaw is not None or pitch is not None:
            return Gimbal(
                None if yaw is None else yaw % 360.0, pitch, _number(holder, "gimbal_roll")
            )
    return None


def _number(raw: Mapping[str, Any], name: str) -> float | None:
    """Return a finite number, also one that is written as text; None for anything else."""
    value = raw.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if math.isfinite(number) else None


def _utc(text: object) -> float | None:
    """Return an ISO 8601 time in seconds since 1970; without a zone it is UTC."""
    if not isinstance(text, str):
        return None
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (when.replace(tzinfo=UTC) if when.tzinfo is None else when).timestamp()
