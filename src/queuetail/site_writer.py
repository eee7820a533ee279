"""The road that was found, as the text of a site file that the user can keep and edit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from queuetail.config import MPS_PER_MPH
from queuetail.geo.earth import geodetic_from_enu
from queuetail.types import Approach, Origin

ESCAPES = {
    '"': '\\"',
    "\\": "\\\\",
    "\b": "\\b",
    "\t": "\\t",
    "\n": "\\n",
    "\f": "\\f",
    "\r": "\\r",
}
LEAST_LANE_WIDTH_M, MOST_LANE_WIDTH_M = 1.6, 9.9  # what a site file takes
MOST_LANES = 12


def site_toml(
    approaches: Sequence[Approach],
    origin: Origin,
    name: str,
    posted_speed_mph: float | None = None,
) -> str:
    """Return a site file with these approaches, in degrees; `config.read_site` reads it back."""
    lines = ["[site]", f"name = {_quoted(name)}"]
    if posted_speed_mph is not None:
        third = posted_speed_mph / 3
        lines.append(
            f"posted_speed_mph = {posted_speed_mph:g}  "
            f"# queued below a third of it: {third:.1f} mph, {third * MPS_PER_MPH:.1f} m/s"
        )
    for approach in approaches:
        lines += ["", *_approach_lines(approach, origin)]
    return "\n".join(lines) + "\n"


def _approach_lines(approach: Approach, origin: Origin) -> list[str]:
    width_m = np.clip(approach.lane_width_m, LEAST_LANE_WIDTH_M, MOST_LANE_WIDTH_M)
    lines = [
        "[[approach]]",
        f"name = {_quoted(approach.name)}",
        f"lanes = {min(max(approach.lanes, 1), MOST_LANES)}",
        f"lane_width_m = {width_m:.2f}",
        f"start_station_m = {approach.start_station_m:.2f}  # of the axis' first point",
        "# in the direction of travel, along the left edge of the left lane",
    ]
    lat_deg, lon_deg = geodetic_from_enu(approach.axis_enu, origin)
    rows = [f"  [{a:.8f}, {b:.8f}]," for a, b in zip(lat_deg, lon_deg, strict=True)]
    return [*lines, "axis = [", *_no_repeats(rows), "]"]


def _no_repeats(rows: list[str]) -> list[str]:
    """Leave out points that rounding made equal to the one before: a site file refuses them."""
    return [row for i, row in enumerate(rows) if i == 0 or row != rows[i - 1]]


def _quoted(text: str) -> str:
    escaped = "".join(ESCAPES.get(c, c) for c in text)
    plain = (c if c >= " " and c != "\x7f" else f"\\u{ord(c):04x}" for c in escaped)
    return '"' + "".join(plain) + '"'
