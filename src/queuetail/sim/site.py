"""What lies beside a simulated flight: the site file, the resolved scenario, the true poses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from queuetail.settings import Settings
from queuetail.sim.axis import Axis
from queuetail.sim.flight import TruePath
from queuetail.sim.scenario import Scenario
from queuetail.sim.truth import axis_points
from queuetail.types import Floats, Origin


def write_site(scenario: Scenario, path: Path) -> None:
    """Write a site file: the approach with its axis, and what is posted."""
    station, lat, lon = axis_points(Axis.of(scenario.road), Origin(*scenario.scenario.origin))
    lines = [
        "[site]",
        f"name = {json.dumps(scenario.scenario.name)}",
        f"posted_speed_mph = {scenario.traffic.posted_speed_mph:g}",
    ]
    if scenario.traffic.queue_speed_mph is not None:
        lines += ["[queue]", f"speed_mph = {scenario.traffic.queue_speed_mph:g}"]
    lines += [
        "[[approach]]",
        'name = "main"',
        f"lanes = {scenario.road.lanes}",
        f"lane_width_m = {scenario.road.lane_width_m:g}",
        f"start_station_m = {station[0]:.1f}",
        "axis = [",
        *(f"  [{a:.8f}, {b:.8f}]," for a, b in zip(lat, lon, strict=True)),
        "]",
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Write the resolved scenario as TOML: every key, also those left at their defaults."""
    path.write_text(scenario_toml(scenario), encoding="utf-8")


def scenario_toml(scenario: Scenario) -> str:
    """Return a scenario as TOML that reads back to the same settings."""
    lines: list[str] = []
    for table in type(scenario).model_fields:
        _table(lines, table, getattr(scenario, table))
    return "\n".join(lines) + "\n"


def _table(lines: list[str], name: str, settings: Settings) -> None:
    nested = []
    lines.append(f"[{name}]")
    for key in type(settings).model_fields:
        value = getattr(settings, key)
        if isinstance(value, Settings):
            nested.append((f"{name}.{key}", value))
        elif value is not None:
            lines.append(f"{key} = {_toml(value)}")
    for inner_name, inner in nested:
        _table(lines, inner_name, inner)


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    return repr(value)


def write_pose(path: TruePath, times_s: Floats, out: Path) -> None:
    """Write the renderer's own camera at every frame, unrounded: for checks, not for detectors."""
    names = "t_s,lat,lon,height_agl_m,yaw_deg,pitch_deg,roll_deg"
    lines = [names]
    for t_s in times_s:
        pose = path.view(float(t_s)).pose
        cells = (
            pose.lat_deg,
            pose.lon_deg,
            pose.height_agl_m,
            pose.yaw_deg,
            pose.pitch_deg,
            pose.roll_deg,
        )
        lines.append(f"{t_s:.6f}," + ",".join(repr(c) for c in cells))
    out.write_text("\n".join(lines) + "\n", encoding="utf-8")
