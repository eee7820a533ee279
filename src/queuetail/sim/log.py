"""The flight log that the drone would have written: sampled, biased, with gaps; CSV and SRT."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.sim.flight import TruePath
from queuetail.sim.scenario import Scenario
from queuetail.types import Origin, TelemetrySample

SENSOR_WIDTH_MM = 36.0  # DJI gives focal lengths as for 35 mm film
TAKEOFF_ALTITUDE_M = 270.0


def flight_log(scenario: Scenario, path: TruePath, seed: int) -> list[TelemetrySample]:
    """Return what the drone logs: true poses plus the scenario's errors, at its rates."""
    told = scenario.telemetry
    rng = np.random.default_rng([seed, 37])
    duration_s = scenario.scenario.duration_s
    origin = Origin(*scenario.scenario.origin)
    omega = 2 * np.pi / rng.uniform([25, 60, 140], [40, 100, 260], (2, 3))
    phase = rng.uniform(0, 2 * np.pi, (2, 3))
    ticks = sorted(
        {
            round(k / rate, 6)
            for rate in (told.position_rate_hz, told.attitude_rate_hz)
            for k in range(int(duration_s * rate) + 1)
        }
    )
    samples = []
    for t_s in ticks:
        if any(start <= t_s < end for start, end in told.gaps):
            continue
        pose = path.view(t_s).pose
        walk = np.sin(omega * t_s + phase) @ np.array([0.5, 0.7, 0.8]) * told.gps_walk_m
        enu = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), origin) + walk
        lat, lon = geodetic_from_enu(enu, origin)
        place = _falls_on(t_s, told.position_rate_hz)
        turn = _falls_on(t_s, told.attitude_rate_hz)
        samples.append(
            TelemetrySample(
                t_s=t_s + told.time_offset_s,
                lat_deg=float(lat) if place else None,
                lon_deg=float(lon) if place else None,
                height_agl_m=pose.height_agl_m + told.height_error_m if place else None,
                heading_deg=(pose.yaw_deg + told.heading_bias_deg) % 360 if turn else None,
                gimbal_pitch_deg=max(pose.pitch_deg + told.pitch_bias_deg, -90.0) if turn else None,
                gimbal_roll_deg=pose.roll_deg if turn else None,
                hfov_deg=scenario.flight.hfov_deg,
            )
        )
    return samples


def _falls_on(t_s: float, rate_hz: float) -> bool:
    return abs(t_s * rate_hz - round(t_s * rate_hz)) < 1e-3


def write_csv(samples: list[TelemetrySample], path: Path) -> None:
    """Write queuetail's own telemetry format (design.md)."""
    digits = {"t_s": 3, "lat": 8, "lon": 8, "height_agl_m": 3, "hfov_deg": 3}
    names = {"lat_deg": "lat", "lon_deg": "lon"}
    fields = [f.name for f in dataclasses.fields(TelemetrySample)]
    lines = [",".join(names.get(f, f) for f in fields)]
    for sample in samples:
        cells = []
        for field in fields:
            value = getattr(sample, field)
            places = digits.get(names.get(field, field), 3)
            cells.append("" if value is None else f"{value:.{places}f}")
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@dataclass(frozen=True, slots=True)
class Known:
    """All that the drone has said by one time: each field its last value."""

    t_s: float
    lat_deg: float
    lon_deg: float
    height_agl_m: float
    heading_deg: float
    gimbal_pitch_deg: float
    gimbal_roll_deg: float
    hfov_deg: float


def last_known(samples: list[TelemetrySample]) -> list[Known]:
    """Return the samples with what they leave out filled in from earlier ones."""
    values: dict[str, float] = {}
    found = []
    names = [field.name for field in dataclasses.fields(Known)]
    for sample in samples:
        for name in names:
            value = getattr(sample, name)
            if value is not None:
                values[name] = value
        if len(values) == len(names):
            found.append(Known(**values))
    return found


def write_srt(samples: list[TelemetrySample], scenario: Scenario, path: Path) -> None:
    """Write DJI's subtitle format (dialect of 2025 on, with gimbal angles): last known values."""
    start = datetime.fromisoformat(scenario.scenario.start_utc.replace("Z", "+00:00"))
    focal_mm = 0.5 * SENSOR_WIDTH_MM / np.tan(np.radians(scenario.flight.hfov_deg) / 2)
    rate_hz = scenario.picture.frame_rate_hz
    told = [known for known in last_known(samples) if known.t_s >= 0]
    pieces: list[str] = []
    for i, known in enumerate(told):
        end_s = told[i + 1].t_s if i + 1 < len(told) else known.t_s + 0.1
        when = start + timedelta(seconds=known.t_s)
        yaw_deg = (known.heading_deg + 180) % 360 - 180
        altitude_m = known.height_agl_m + TAKEOFF_ALTITUDE_M
        pieces.append(
            f"{i + 1}\n{_clock(known.t_s)} --> {_clock(end_s)}\n"
            f'<font size="28">FrameCnt: {round(known.t_s * rate_hz) + 1}, '
            f"DiffTime: {round(1000 / rate_hz)}ms\n"
            f"{when:%Y-%m-%d %H:%M:%S}.{when.microsecond // 1000:03d}\n"
            f"[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [ev: 0] [color_md: default] "
            f"[focal_len: {focal_mm:.2f}] [latitude: {known.lat_deg:.6f}] "
            f"[longitude: {known.lon_deg:.6f}] [rel_alt: {known.height_agl_m:.3f} "
            f"abs_alt: {altitude_m:.3f}] [ct: 5500] [gb_yaw: {yaw_deg:.1f} "
            f"gb_pitch: {known.gimbal_pitch_deg:.1f} gb_roll: {known.gimbal_roll_deg:.1f}] "
            "</font>\n\n"
        )
    path.write_text("".join(pieces), encoding="utf-8")


def _clock(t_s: float) -> str:
    ms = round(t_s * 1000)
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"
