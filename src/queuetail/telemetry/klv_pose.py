"""From MISB ST 0601 angles and elevations to the camera's own orientation and height."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from pymap3d.vincenty import vdist

from queuetail.types import Floats

PLATFORM_HEADING, RELATIVE_AZIMUTH, RELATIVE_ELEVATION, RELATIVE_ROLL = 5, 18, 19, 20
PLATFORM_PITCH, PLATFORM_ROLL = (90, 6), (91, 7)  # the full-range tag first (ST 0601.8-16)
SENSOR_MSL, SENSOR_HAE, CENTRE_MSL, CENTRE_HAE = (15,), (104, 75), 25, 78
SLANT_RANGE = 21
SENSOR_LATITUDE, SENSOR_LONGITUDE, CENTRE_LATITUDE, CENTRE_LONGITUDE = 13, 14, 23, 24
STRAIGHT_DOWN = 1e-6  # the horizontal part of the optical axis below which yaw needs the picture

Angles = tuple[float | None, float | None, float | None, tuple[str, ...]]


def rotation_ned(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Floats:
    """Return the 3×3 rotation from body axes (forward, right, down) to north, east, down.

    Source: MISB ST 0601, the aerospace order yaw, pitch, roll.
    """
    yaw, pitch, roll = np.radians([yaw_deg, pitch_deg, roll_deg])
    cy, sy, cp, sp = math.cos(yaw), math.sin(yaw), math.cos(pitch), math.sin(pitch)
    cr, sr = math.cos(roll), math.sin(roll)
    about_down = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    about_right = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_forward = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return np.asarray(about_down @ about_right @ about_forward)


def angles_of(R: Floats) -> tuple[float, float, float]:
    """Return yaw (0 … 360), pitch and roll in degrees of a rotation from :func:`rotation_ned`.

    Straight up or down, where yaw and roll cannot be told apart, roll is 0.
    """
    level = math.hypot(R[0, 0], R[1, 0])
    pitch = math.degrees(math.atan2(-R[2, 0], level))
    if level < STRAIGHT_DOWN:
        yaw = math.degrees(math.atan2(-R[0, 1], R[1, 1]))
        return yaw % 360.0, pitch, 0.0
    yaw = math.degrees(math.atan2(R[1, 0], R[0, 0]))
    return yaw % 360.0, pitch, math.degrees(math.atan2(R[2, 1], R[2, 2]))


def sensor_angles_deg(values: Mapping[int, float]) -> Angles:
    """Return the camera's yaw, pitch and roll, and notes on what had to be derived.

    The platform's attitude (5, 90 or 6, 91 or 7) is composed with the sensor's relative angles (18,
    19, 20).  Without them the line from the sensor to the frame centre gives yaw and pitch.
    """
    heading, elevation = values.get(PLATFORM_HEADING), values.get(RELATIVE_ELEVATION)
    if heading is not None and elevation is not None:
        notes = []
        pitch, roll = _first(values, PLATFORM_PITCH), _first(values, PLATFORM_ROLL)
        if pitch is None or roll is None:
            notes.append("the platform's pitch or roll is missing from KLV and was taken as level")
        azimuth = values.get(RELATIVE_AZIMUTH)
        if azimuth is None:
            notes.append("the sensor's azimuth is missing from KLV and was taken as straight ahead")
        platform = rotation_ned(heading, pitch or 0.0, roll or 0.0)
        sensor = rotation_ned(azimuth or 0.0, elevation, values.get(RELATIVE_ROLL, 0.0))
        return *angles_of(platform @ sensor), tuple(notes)
    return _angles_to_frame_centre(values)


def height_agl_m(
    values: Mapping[int, float], pitch_deg: float | None
) -> tuple[float | None, tuple[str, ...]]:
    """Return the sensor's height above the ground at the frame centre, and how it was found."""
    msl, hae = _first(values, SENSOR_MSL), _first(values, SENSOR_HAE)
    if msl is not None and CENTRE_MSL in values:
        return msl - values[CENTRE_MSL], (
            "heights are the sensor's altitude less the frame centre's elevation (both above "
            "sea level)",
        )
    if hae is not None and CENTRE_HAE in values:
        return hae - values[CENTRE_HAE], (
            "heights are the sensor's less the frame centre's height above the ellipsoid",
        )
    slant_m = values.get(SLANT_RANGE)
    if slant_m is not None and slant_m > 0 and pitch_deg is not None and pitch_deg < 0:
        return slant_m * math.sin(math.radians(-pitch_deg)), (
            "heights are from slant range and depression angle",
        )
    if msl is not None or hae is not None:
        return None, (
            "KLV gives the sensor's altitude but not the ground's: give height_agl_m in the site "
            "file's [telemetry]",
        )
    return None, ()


def _angles_to_frame_centre(values: Mapping[int, float]) -> Angles:
    tags = (SENSOR_LATITUDE, SENSOR_LONGITUDE, CENTRE_LATITUDE, CENTRE_LONGITUDE)
    if any(tag not in values for tag in tags):
        return None, None, None, ()
    distance_m, bearing_deg = vdist(*(values[tag] for tag in tags))
    distance, bearing = float(distance_m), float(bearing_deg)
    note = "camera angles are missing from KLV; yaw and pitch follow from the frame centre"
    height, _ = height_agl_m({**values, SLANT_RANGE: 0.0}, None)
    pitch = None if height is None else -math.degrees(math.atan2(height, distance))
    return bearing, pitch, None, (note,)


def _first(values: Mapping[int, float], tags: tuple[int, ...]) -> float | None:
    return next((values[tag] for tag in tags if tag in values), None)
