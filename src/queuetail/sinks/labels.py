"""Small text tiles for pictures: rendered once, then blended by two integer operations."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from queuetail.types import Image

Colour = tuple[int, int, int]  # blue, green, red
CACHE_SIZE = 500
WHITE: Colour = (255, 255, 255)
PLATE_ALPHA = 0.62


class Labels:
    """Writes text into BGR pictures on dark plates, with OpenCV's own outline font."""

    def __init__(self) -> None:
        self._font: Any = cv2.FontFace("sans")
        self._widths: dict[tuple[str, int], int] = {}
        self._tiles: dict[tuple[str, int, Colour], tuple[Image, Image]] = {}

    def width(self, text: str, size_px: int) -> int:
        """Return how wide the plate of `text` is in pixels."""
        width = self._widths.get((text, size_px))
        if width is None:
            box = cv2.getTextSize((1, 1), text, (0, 0), self._font, size_px, _weight(size_px))
            width = int(box[2]) + 2 * _pad(size_px)
            if len(self._widths) >= CACHE_SIZE:
                self._widths.clear()
            self._widths[text, size_px] = width
        return width

    def height(self, size_px: int) -> int:
        """Return how high a plate is in pixels."""
        return round(1.5 * size_px)

    def fitted(self, text: str, size_px: int, width_px: int) -> str:
        """Return `text`, cut with an ellipsis where it is wider than `width_px`."""
        if self.width(text, size_px) <= width_px:
            return text
        low, high = 0, len(text)
        while low < high:
            middle = (low + high + 1) // 2
            if self.width(text[:middle] + "…", size_px) <= width_px:
                low = middle
            else:
                high = middle - 1
        return text[:low].rstrip() + "…" if low else ""

    def draw(
        self, image: Image, text: str, corner: tuple[int, int], size_px: int, ink: Colour
    ) -> None:
        """Put the plate's top-left corner at `corner` (x, y); what lies outside is cut."""
        x, y = corner
        shade, light = self._tile(text, size_px, ink)
        height, width = shade.shape[:2]
        left, top = max(x, 0), max(y, 0)
        right, bottom = min(x + width, image.shape[1]), min(y + height, image.shape[0])
        if left >= right or top >= bottom:
            return
        part = np.s_[top - y : bottom - y, left - x : right - x]
        under = image[top:bottom, left:right]
        cv2.multiply(under, shade[part], dst=under, scale=1 / 255)
        cv2.add(under, light[part], dst=under)

    def _tile(self, text: str, size_px: int, ink: Colour) -> tuple[Image, Image]:
        """Return what remains of the picture below (0 … 255) and what is added to it."""
        key = (text, size_px, ink)
        tile = self._tiles.get(key)
        if tile is None:
            shape = (self.height(size_px), max(self.width(text, size_px), 1), 3)
            letters = np.zeros(shape, np.uint8)
            base = (_pad(size_px), round(1.1 * size_px))
            cv2.putText(letters, text, base, WHITE, self._font, size_px, _weight(size_px))
            alpha = letters.astype(np.float32) / 255
            shade = ((1 - PLATE_ALPHA) * (1 - alpha) * 255).astype(np.uint8)
            tile = (shade, (alpha * np.array(ink, np.float32)).astype(np.uint8))
            if len(self._tiles) >= CACHE_SIZE:
                self._tiles.clear()
            self._tiles[key] = tile
        return tile


def _pad(size_px: int) -> int:
    return max(round(0.3 * size_px), 1)


def _weight(size_px: int) -> int:
    """Return the stroke weight: small letters need more of it on a restless picture."""
    return 600 if size_px < 14 else 500
