"""Drops and counts what no flight can have said, the same way for every format."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace

from queuetail.errors import InputError
from queuetail.types import TelemetrySample

FIELDS = (
    "lat_deg",
    "lon_deg",
    "height_agl_m",
    "heading_deg",
    "gimbal_pitch_deg",
    "gimbal_roll_deg",
    "hfov_deg",
)
NO_FIX_DEG = 1e-6  # (0, 0) is what receivers write without a fix, to the last digit they print
PITCH_TOLERANCE_DEG = 1.0  # gimbals looking straight down report up to -90.1

# What each value must be, and how to say that it is not.
LIMITS: dict[str, tuple[Callable[[float], bool], str]] = {
    "lat_deg": (lambda v: -90 <= v <= 90, "latitude dropped (outside ±90°)"),
    "lon_deg": (lambda v: -180 <= v <= 180, "longitude dropped (outside ±180°)"),
    "height_agl_m": (lambda v: -500 <= v <= 10_000, "height dropped (outside -500 … 10000 m)"),
    "heading_deg": (lambda v: -360 <= v <= 360, "heading dropped (outside ±360°)"),
    "gimbal_pitch_deg": (
        lambda v: abs(v) <= 90 + PITCH_TOLERANCE_DEG,
        "gimbal pitch dropped (outside ±90°)",
    ),
    "gimbal_roll_deg": (lambda v: -360 <= v <= 360, "gimbal roll dropped (outside ±360°)"),
    "hfov_deg": (lambda v: 0 < v < 180, "field of view dropped (not between 0° and 180°)"),
}


def clean(
    samples: Sequence[TelemetrySample], source: str
) -> tuple[tuple[TelemetrySample, ...], tuple[str, ...]]:
    """Return the samples without impossible values, and one sentence for each kind of drop.

    A bad value costs its field (latitude and longitude go together), not the whole sample.
    Raises InputError when no sample is left that says anything.
    """
    counts: Counter[str] = Counter()
    kept = []
    for sample in samples:
        if not math.isfinite(sample.t_s):
            counts["dropped (the time is not a number)"] += 1
            continue
        tidy, reasons = _tidy(sample)
        counts.update(reasons)
        if any(getattr(tidy, name) is not None for name in FIELDS):
            kept.append(tidy)
    notes = tuple(
        f"{count} of {len(samples)} samples: {reason}" for reason, count in counts.most_common()
    )
    if not kept:
        why = "; ".join(notes) or "they say nothing of position, height, heading, pitch or lens"
        raise InputError(f"{source}: none of its {len(samples)} samples can be used ({why})")
    return tuple(kept), notes


def _tidy(sample: TelemetrySample) -> tuple[TelemetrySample, set[str]]:
    """Return the sample with its impossible values removed, and the reasons."""
    gone: dict[str, float | None] = {}
    reasons = set()
    for name, (is_possible, reason) in LIMITS.items():
        value = getattr(sample, name)
        if value is None:
            continue
        if not math.isfinite(value):
            gone[name] = None
            reasons.add(f"{name} dropped (not a number)")
        elif not is_possible(value):
            gone[name] = None
            reasons.add(reason)
    lat, lon = sample.lat_deg, sample.lon_deg
    if lat is not None and lon is not None and abs(lat) < NO_FIX_DEG and abs(lon) < NO_FIX_DEG:
        gone["lat_deg"] = None
        reasons.add("position (0, 0) dropped (no satellite fix)")
    if "lat_deg" in gone or "lon_deg" in gone:
        gone |= {"lat_deg": None, "lon_deg": None}
    pitch = sample.gimbal_pitch_deg
    if pitch is not None and "gimbal_pitch_deg" not in gone and abs(pitch) > 90:
        gone["gimbal_pitch_deg"] = math.copysign(90.0, pitch)
    return (replace(sample, **gone) if gone else sample), reasons  # type: ignore[arg-type]
