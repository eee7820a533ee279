"""MAVLink messages as quantities of the link; source: the dialect `common` (mavlink.io)."""

from __future__ import annotations

import math
from typing import Any

from queuetail.link.messages import (
    Altitude,
    Attitude,
    ClockSource,
    ClockTime,
    Gimbal,
    Heading,
    Lens,
    Lidar,
    Position,
    Quantity,
)

NO_HEADING = 65_535
YAW_LOCK, YAW_IN_VEHICLE_FRAME, YAW_IN_EARTH_FRAME = 16, 32, 64  # GIMBAL_DEVICE_FLAGS
DOWN = 25  # MAV_SENSOR_ROTATION_PITCH_270
INVALID_SIGNAL = 1  # percent; 0 says that the quality is not known
FRESH_S = 1.0
STRAIGHT_DOWN = 1e-6  # the horizontal part of the optical axis below which yaw and roll are one


class MavlinkReader:
    """Turns one vehicle's messages into quantities; it remembers what later ones refer to."""

    def __init__(self) -> None:
        self._heading: tuple[float, float] | None = None  # time, degrees
        self._attitude_s = -math.inf
        self._gimbal_s = -math.inf
        self._lens_s = -math.inf

    def quantities(self, message: Any, t_s: float) -> list[Quantity]:
        """Return what a message (of pymavlink) that came at `t_s` says of drone and camera."""
        read = {
            "GLOBAL_POSITION_INT": self._position,
            "ATTITUDE": self._attitude,
            "GIMBAL_DEVICE_ATTITUDE_STATUS": self._gimbal,
            "MOUNT_ORIENTATION": self._mount,
            "DISTANCE_SENSOR": self._distance,
            "SYSTEM_TIME": self._time,
            "CAMERA_FOV_STATUS": self._fov,
            "CAMERA_INFORMATION": self._camera,
        }.get(message.get_type())
        return read(message, t_s) if read is not None else []

    def _position(self, m: Any, t_s: float) -> list[Quantity]:
        found: list[Quantity] = [Altitude(m.relative_alt / 1000, m.alt / 1000)]
        if m.lat or m.lon:  # both are 0 without a fix
            found.insert(0, Position(m.lat / 1e7, m.lon / 1e7))
        if m.hdg != NO_HEADING and t_s - self._attitude_s > FRESH_S:
            found.append(self._headed(m.hdg / 100, t_s))
        return found

    def _attitude(self, m: Any, t_s: float) -> list[Quantity]:
        if not all(map(math.isfinite, (m.roll, m.pitch, m.yaw))):
            return []
        self._attitude_s = t_s
        return [
            Attitude(math.degrees(m.roll), math.degrees(m.pitch)),
            self._headed(math.degrees(m.yaw) % 360.0, t_s),
        ]

    def _headed(self, deg: float, t_s: float) -> Heading:
        self._heading = t_s, deg
        return Heading(deg)

    def _from_north(self, relative_deg: float, t_s: float) -> float | None:
        """Return a yaw relative to the nose as one from north, where the nose's is known now."""
        if self._heading is None or t_s - self._heading[0] > FRESH_S:
            return None
        return (self._heading[1] + relative_deg) % 360.0

    def _gimbal(self, m: Any, t_s: float) -> list[Quantity]:
        angles = euler_deg(m.q)
        if angles is None:
            return []
        self._gimbal_s = t_s
        yaw, pitch, roll = angles
        absolute: float | None = yaw % 360.0
        in_earth_frame = bool(m.flags & YAW_IN_EARTH_FRAME)
        if not m.flags & (YAW_IN_VEHICLE_FRAME | YAW_IN_EARTH_FRAME):
            in_earth_frame = bool(m.flags & YAW_LOCK)  # so it was before the two flags
        if not in_earth_frame:
            absolute = self._from_north(yaw, t_s)
        return [Gimbal(absolute, pitch, roll)]

    def _mount(self, m: Any, t_s: float) -> list[Quantity]:
        if t_s - self._gimbal_s <= FRESH_S:
            return []  # the message that replaced this one is there
        yaw: float | None = m.yaw_absolute
        if not math.isfinite(m.yaw_absolute):
            yaw = self._from_north(m.yaw, t_s) if math.isfinite(m.yaw) else None
        pitch = m.pitch if math.isfinite(m.pitch) else None
        roll = m.roll if math.isfinite(m.roll) else None
        return [Gimbal(None if yaw is None else yaw % 360.0, pitch, roll)]

    def _distance(self, m: Any, t_s: float) -> list[Quantity]:
        if m.orientation != DOWN:
            return []
        is_valid = m.min_distance <= m.current_distance < m.max_distance
        if not is_valid or getattr(m, "signal_quality", 0) == INVALID_SIGNAL:
            return [Lidar(None)]
        return [Lidar(m.current_distance / 100)]

    def _time(self, m: Any, t_s: float) -> list[Quantity]:
        if not m.time_unix_usec:
            return []
        return [ClockTime(m.time_unix_usec / 1e6, ClockSource.GPS)]

    def _fov(self, m: Any, t_s: float) -> list[Quantity]:
        if not math.isfinite(m.hfov) or not 0 < m.hfov < 180:
            return []
        self._lens_s = t_s
        return [Lens(m.hfov)]

    def _camera(self, m: Any, t_s: float) -> list[Quantity]:
        """Return the field of view from focal length and sensor, where no message tells it."""
        wide_mm, focal_mm = m.sensor_size_h, m.focal_length
        if t_s - self._lens_s <= 10 * FRESH_S or not (wide_mm > 0 and focal_mm > 0):
            return []
        return [Lens(math.degrees(2 * math.atan(wide_mm / (2 * focal_mm))))]


def euler_deg(q: Any) -> tuple[float, float, float] | None:
    """Return yaw, pitch and roll of a quaternion (w, x, y, z); None where it is none.

    Straight down or up, where yaw and roll cannot be told apart, roll is 0.
    """
    w, x, y, z = (float(part) for part in q)
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not math.isfinite(length) or not 0.9 < length < 1.1:
        return None
    w, x, y, z = w / length, x / length, y / length, z / length
    forward_north, forward_east = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z)
    sine = max(-1.0, min(1.0, 2 * (w * y - x * z)))
    pitch = math.degrees(math.asin(sine))
    if math.hypot(forward_north, forward_east) < STRAIGHT_DOWN:
        right_north, right_east = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z)
        return math.degrees(math.atan2(-right_north, right_east)), pitch, 0.0
    yaw = math.degrees(math.atan2(forward_east, forward_north))
    roll = math.degrees(math.atan2(2 * (y * z + w * x), 1 - 2 * (x * x + y * y)))
    return yaw, pitch, roll
