"""What one DJI subtitle cue says, whatever its dialect."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

from queuetail.telemetry.lens import focal_length_mm, zoom_ratio

GpsOrder = Literal["lon_lat", "lat_lon"]

FEET_M = 0.3048
NUMBER = r"[+-]?\d+(?:\.\d+)?"
# A value must end visibly, or it may be the first half of one that was cut off.
KEY_VALUE = re.compile(r"([A-Za-z_]\w*)\s*:\s*([^\s\[\],:()<]+)(?=[\s\],)<])")
TRIPLE = (
    rf"\s*\(\s*(?P<a>{NUMBER})\s*,\s*(?P<b>{NUMBER})\s*"
    rf"(?:,\s*(?P<c>{NUMBER})\s*(?P<unit>m)?\s*)?\)"
)
GPS = re.compile(r"\bGPS" + TRIPLE, re.IGNORECASE)
HOME = re.compile(r"\bHOME" + TRIPLE, re.IGNORECASE)
HEIGHT_H = re.compile(rf"(?<![\w.])H\s+({NUMBER})\s*(m|ft)\b", re.IGNORECASE)
GIMBAL_PRY = re.compile(
    rf"\bG\.PRY\s*\(\s*({NUMBER})[^,\d]*,\s*({NUMBER})[^,\d]*,\s*({NUMBER})[^,\d]*\)", re.IGNORECASE
)
UNIT_NUMBER = re.compile(rf"^({NUMBER})\s*(m|ft)?$", re.IGNORECASE)
SAME_PLACE_DEG = 1.0  # between a drone and its home, in either axis


@dataclass(frozen=True, slots=True)
class CueFacts:
    """The quantities of one cue; heights by kind, in metres."""

    lat_deg: float | None
    lon_deg: float | None
    heights: Mapping[str, float]
    yaw_deg: float | None
    pitch_deg: float | None
    roll_deg: float | None
    focal_mm: float | None
    zoom: float

    @property
    def says_anything(self) -> bool:
        """Whether the cue tells a position, a height, an angle or a lens."""
        values = (self.lat_deg, self.yaw_deg, self.pitch_deg, self.focal_mm)
        return bool(self.heights) or any(value is not None for value in values)


def facts_of(text: str, order: GpsOrder) -> CueFacts:
    """Read one cue's text; `order` is that of the numbers in GPS(…)."""
    values = {key.lower(): value for key, value in KEY_VALUE.findall(text)}
    lat, lon = _position(text, values, order)
    yaw, pitch, roll = (
        _number(values.get(f"gb_{axis}", values.get(f"gimbal_{axis}")))
        for axis in ("yaw", "pitch", "roll")
    )
    gimbal = GIMBAL_PRY.search(text)
    if gimbal:
        pitch, roll, yaw = (float(angle) for angle in gimbal.groups())
    focal = values.get("focal_len")
    return CueFacts(
        lat_deg=lat,
        lon_deg=lon,
        heights=_heights(text, values),
        yaw_deg=yaw,
        pitch_deg=pitch,
        roll_deg=roll,
        focal_mm=None if focal is None else focal_length_mm(focal, _number(values.get("fnum"))),
        zoom=zoom_ratio(_number(values.get("dzoom_ratio"))),
    )


def gps_order(texts: Iterable[str]) -> tuple[GpsOrder, tuple[str, ...]]:
    """Decide how GPS(a, b, …) is ordered: by range where it decides, else by dialect; and a note.

    Only a longitude exceeds 90; HOME counts as evidence where it lies near, in the same order.  The
    M300's dialect, whose third number has the unit M, writes latitude first; all others that are
    known write longitude first.
    """
    first_is_lon = second_is_lon = seen = metres = 0
    for text in texts:
        gps = GPS.search(text)
        if gps is None:
            continue
        seen += 1
        metres += gps["unit"] is not None
        pairs = [(float(gps["a"]), float(gps["b"]))]
        home = HOME.search(text)
        if home is not None:
            pairs.append((float(home["a"]), float(home["b"])))
            if any(abs(x - y) > SAME_PLACE_DEG for x, y in zip(*pairs, strict=True)):
                pairs.pop()
        first_is_lon += any(90 < abs(a) <= 180 for a, _ in pairs)
        second_is_lon += any(90 < abs(b) <= 180 for _, b in pairs)
    if first_is_lon != second_is_lon:
        return ("lon_lat" if first_is_lon > second_is_lon else "lat_lon"), ()
    if 2 * metres > seen:
        return "lat_lon", ("GPS(…) is read as latitude, longitude, the order of this dialect",)
    if not seen:
        return "lon_lat", ()
    return "lon_lat", ("GPS(…) is read as longitude, latitude, the order of this dialect",)


def _position(
    text: str, values: Mapping[str, str], order: GpsOrder
) -> tuple[float | None, float | None]:
    lat = _number(values.get("latitude"))
    lon = _number(values.get("longitude", values.get("longtitude")))
    if lat is not None and lon is not None:
        return lat, lon
    gps = GPS.search(text)
    if gps is None:
        return None, None
    a, b = float(gps["a"]), float(gps["b"])
    return (b, a) if order == "lon_lat" else (a, b)


def _heights(text: str, values: Mapping[str, str]) -> dict[str, float]:
    """Return the heights that the cue gives, by kind."""
    found = {
        "rel_alt": _metres(values.get("rel_alt")),
        "barometer": _metres(values.get("barometer", values.get("hb"))),
        "altitude": _metres(values.get("altitude")),
    }
    match = HEIGHT_H.search(text)
    if match:
        found["h"] = _metres(match[1] + match[2])
    return {kind: height for kind, height in found.items() if height is not None}


def _metres(text: str | None) -> float | None:
    match = UNIT_NUMBER.match(text) if text is not None else None
    if match is None:
        return None
    return float(match[1]) * (FEET_M if (match[2] or "").lower() == "ft" else 1.0)


def _number(text: str | None) -> float | None:
    match = re.fullmatch(NUMBER, text) if text is not None else None
    return None if match is None else float(match[0])
