"""Painted marks on a road that was not seen bare yet: lines, arrows, stop lines.

Paint is bright and thin, and has nothing dark beside it; a vehicle has windows, tyres and the shade
below it.
"""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.types import Image

THIN_M = 0.55  # lines are narrower one way; what is not goes on as far again at least
BESIDE_M = 0.7  # from anything dark that is no speck
SPECK = np.ones((2, 2), np.uint8)


def painted(bright: Image, dark: Image, px_per_m: float) -> Image:
    """Return (255) what of the `bright` mask is paint, `dark` being what is darker than road."""
    side = max(round(THIN_M * px_per_m), 2) + 1
    broad = cv2.morphologyEx(bright, cv2.MORPH_OPEN, np.ones((side, side), np.uint8))
    reach = max(round(BESIDE_M * px_per_m), 1)
    parts = cv2.bitwise_or(broad, cv2.morphologyEx(dark, cv2.MORPH_OPEN, SPECK))
    vehicles = cv2.dilate(parts, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    return np.asarray(cv2.bitwise_and(bright, cv2.bitwise_not(vehicles)), np.uint8)
