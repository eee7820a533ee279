"""DJI still pictures: where the camera was and how it looked, from EXIF and XMP."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image, UnidentifiedImageError

from queuetail.errors import InputError
from queuetail.telemetry.clean import clean
from queuetail.telemetry.lens import SHORTEST_EQUIVALENT_MM
from queuetail.types import TelemetrySample

FULL_FRAME_DIAGONAL_MM = math.hypot(36, 24)
BETWEEN_4_3_AND_3_2 = 1.42
WIDER_THAN_3_2 = 1.6
ONE_INCH_DIAGONAL_MM = (14.5, 17.5)
# Attributes or elements, in any quotes: drone-dji:RelativeAltitude="+98.90"
XMP_VALUE = re.compile(
    rb"drone-dji:(?P<key>\w+)\s*(?:=\s*[\"'](?P<attribute>[^\"']*)[\"']|>(?P<element>[^<]*)<)"
)


@dataclass(frozen=True, slots=True)
class Still:
    """A still picture's size, its telemetry at ``t_s`` = 0, and notes for the user."""

    width_px: int
    height_px: int
    sample: TelemetrySample
    notes: tuple[str, ...] = ()


def read_still(path: Path) -> Still:
    """Read a picture's pose from its metadata (drone-dji XMP, else EXIF GPS).

    The height is that above the take-off point.  Raises InputError when the file is no picture or
    its metadata says nothing of the flight.
    """
    try:
        with Image.open(path) as picture:
            size = picture.size
            exif = picture.getexif()
            xmp = _xmp_values(picture.info.get("xmp") or b"")
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such picture") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder, not a picture") from None
    except UnidentifiedImageError:
        raise InputError(f"{path} is not a picture that can be read") from None
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(f"{path}: the picture cannot be read ({error})") from None
    lat, lon = _position(xmp, exif.get_ifd(ExifTags.IFD.GPSInfo))
    height = xmp.get("relativealtitude")
    hfov = _hfov_deg(xmp, exif.get_ifd(ExifTags.IFD.Exif), size)
    sample = TelemetrySample(
        t_s=0.0,
        lat_deg=lat,
        lon_deg=lon,
        height_agl_m=height,
        heading_deg=xmp.get("gimbalyawdegree"),
        gimbal_pitch_deg=xmp.get("gimbalpitchdegree"),
        gimbal_roll_deg=xmp.get("gimbalrolldegree"),
        hfov_deg=hfov,
    )
    if all(value is None for value in (lat, height, sample.heading_deg, hfov)):
        raise InputError(
            f"{path}: its metadata says nothing of position, height or lens; "
            "use the file as the drone wrote it, not a copy from a messenger or an editor"
        )
    samples, notes = clean([sample], str(path))
    if height is not None:
        notes = (*notes, "the height is that above the take-off point")
    return Still(*size, samples[0], notes)


def _xmp_values(packet: bytes) -> dict[str, float]:
    values = {}
    for match in XMP_VALUE.finditer(packet):
        text = match["attribute"] if match["attribute"] is not None else match["element"]
        number = _number(text.decode("ascii", errors="replace"))
        if number is not None:
            values[match["key"].decode("ascii", errors="replace").lower()] = number
    return values


def _position(
    xmp: Mapping[str, float], gps: Mapping[int, Any]
) -> tuple[float | None, float | None]:
    lat = xmp.get("gpslatitude")
    lon = xmp.get("gpslongitude", xmp.get("gpslongtitude"))  # so misspelt by older firmware
    if lat is not None and lon is not None:
        return lat, lon
    tags = ExifTags.GPS
    lat = _degrees(gps.get(tags.GPSLatitude), gps.get(tags.GPSLatitudeRef), "S")
    lon = _degrees(gps.get(tags.GPSLongitude), gps.get(tags.GPSLongitudeRef), "W")
    return (lat, lon) if lat is not None and lon is not None else (None, None)


def _degrees(parts: Any, reference: Any, negative: str) -> float | None:
    """Return EXIF degrees, minutes and seconds as signed degrees."""
    try:
        degrees, minutes, seconds = (float(part) for part in parts)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    size = degrees + minutes / 60 + seconds / 3600
    if not math.isfinite(size):
        return None
    return -size if str(reference or "").strip("\0 ").upper() == negative else size


def _hfov_deg(
    xmp: Mapping[str, float], exif: Mapping[int, Any], size: tuple[int, int]
) -> float | None:
    """Return the field of view from DJI's calibrated focal length in pixels, else from EXIF."""
    calibrated_px = xmp.get("calibratedfocallength")
    if calibrated_px is not None and calibrated_px > 0:
        return math.degrees(2 * math.atan(size[0] / (2 * calibrated_px)))
    equivalent_mm = _number(exif.get(ExifTags.Base.FocalLengthIn35mmFilm))
    if equivalent_mm is None or equivalent_mm < SHORTEST_EQUIVALENT_MM:
        return None
    zoom = max(_number(exif.get(ExifTags.Base.DigitalZoomRatio)) or 1.0, 1.0)
    focal_mm = _number(exif.get(ExifTags.Base.FocalLength)) or 0.0
    long_mm = _long_side_mm(size, FULL_FRAME_DIAGONAL_MM * focal_mm / equivalent_mm)
    focal_px = max(size) * zoom * equivalent_mm / long_mm
    return math.degrees(2 * math.atan(size[0] / (2 * focal_px)))


def _long_side_mm(size: tuple[int, int], sensor_diagonal_mm: float) -> float:
    """Return how long the picture's long side is, on the scale of a full frame's diagonal.

    The equivalence of stills goes by the diagonal of the whole sensor (CIPA DCG-001): 3:2 for
    one-inch sensors, 4:3 for the others.  Wider pictures are cut from it at full length.
    """
    is_three_to_two = max(size) / min(size) < WIDER_THAN_3_2 and (
        max(size) / min(size) > BETWEEN_4_3_AND_3_2
    )
    low_mm, high_mm = ONE_INCH_DIAGONAL_MM
    if is_three_to_two or low_mm < sensor_diagonal_mm < high_mm:
        return FULL_FRAME_DIAGONAL_MM * 3 / math.hypot(3, 2)
    return FULL_FRAME_DIAGONAL_MM * 4 / math.hypot(4, 3)


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) else None
