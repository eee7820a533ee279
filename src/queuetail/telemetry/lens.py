"""A DJI lens as its metadata tells it: the 35 mm equivalent focal length and the zoom."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

FULL_FRAME_WIDTH_MM = 36.0
SHORTEST_EQUIVALENT_MM = 12.0  # the widest DJI camera (FPV) has 12.7 mm; below it is the real one
WIDEST_BY_CROP_MM = 18.0  # a zoomed-out equivalent below this means that zoom is not yet applied
FNUM_IN_HUNDREDTHS = 50.0  # no lens has f/50: such numbers are hundredths, and focal_len tenths
TENTHS_FROM_MM = 100.0
ZOOM_IN_TEN_THOUSANDTHS = 1000.0


def hfov_from_equivalent(focal_mm: float) -> float | None:
    """Return the horizontal field of view of a 35 mm equivalent focal length; None if it is none.

    The frame is taken as 36 mm wide: of the conventions in use it fits the measured scale of a real
    nadir flight best (docs/telemetry.md).
    """
    if not math.isfinite(focal_mm) or focal_mm < SHORTEST_EQUIVALENT_MM:
        return None
    return math.degrees(2 * math.atan(FULL_FRAME_WIDTH_MM / (2 * focal_mm)))


def focal_length_mm(focal_len: str, fnum: float | None) -> float | None:
    """Return DJI's `focal_len` in millimetres: 24.00, or 240 where `fnum` is written as 280 too."""
    try:
        value = float(focal_len)
    except ValueError:
        return None
    if not math.isfinite(value) or value <= 0:
        return None
    if fnum is not None:
        in_tenths = fnum >= FNUM_IN_HUNDREDTHS
    else:
        in_tenths = "." not in focal_len and value >= TENTHS_FROM_MM
    return value / 10 if in_tenths else value


def zoom_ratio(dzoom: float | None) -> float:
    """Return `dzoom_ratio` as a factor; 10000 stands for 1 in older files."""
    if dzoom is None or not dzoom > 0:
        return 1.0
    return dzoom / 10_000 if dzoom >= ZOOM_IN_TEN_THOUSANDTHS else dzoom


def effective_focals(
    focals_mm: Sequence[float | None], zooms: Sequence[float]
) -> list[float | None]:
    """Return focal lengths with the digital zoom applied once.

    Some firmware writes the lens and the zoom apart, some multiplies the zoom into focal_len
    already.  Where the zoom changes, focal_len tells by moving with it; where it does not, the
    zoom is taken as applied unless the lens would then be wider than any.
    """
    pairs = [(f, z) for f, z in zip(focals_mm, zooms, strict=True) if f is not None]
    if not pairs or all(zoom == 1.0 for _, zoom in pairs):
        return list(focals_mm)
    if _is_applied(pairs):
        return list(focals_mm)
    return [None if f is None else f * z for f, z in zip(focals_mm, zooms, strict=True)]


def _is_applied(pairs: Sequence[tuple[float, float]]) -> bool:
    """Tell whether focal / zoom varies less than focal itself, lens by lens."""
    zooms = {zoom for _, zoom in pairs}
    if len(zooms) == 1:
        return min(focal / zoom for focal, zoom in pairs) >= WIDEST_BY_CROP_MM
    apart, together = 0.0, 0.0
    for (f0, z0), (f1, z1) in pairwise(pairs):
        if z0 != z1:
            apart += min(abs(math.log(f1 / f0)), 1.0)
            together += min(abs(math.log((f1 / z1) / (f0 / z0))), 1.0)
    return together < apart or math.isclose(apart, together)
