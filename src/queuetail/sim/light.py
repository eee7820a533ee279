"""Light over a frame: brightness, cloud shadows that drift over the ground, haze."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.geo.ground import apply_homography
from queuetail.sim.flight import View
from queuetail.sim.scenario import Scenario
from queuetail.types import Floats, Image

F32 = NDArray[np.float32]
COARSE = 16  # pixels per node of the light field
CLOUD_CELL_M = 45.0
CLOUD_TILE = 128
HAZE_LUMA = 200.0
HAZE_FULL_M = 1500.0  # at haze = 1 a third of the light gets through this far


class Light:
    """A field of gain and offset on the luma plane, and of gain on the colours."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        rng = np.random.default_rng([seed, 29])
        self._picture = scenario.picture
        tile = rng.normal(0, 1, (CLOUD_TILE, CLOUD_TILE)).astype(np.float32)
        tile = np.tile(tile, (3, 3))
        tile = cv2.GaussianBlur(tile, (0, 0), 1.6)[
            CLOUD_TILE : 2 * CLOUD_TILE, CLOUD_TILE : 2 * CLOUD_TILE
        ]
        self._clouds = (tile / tile.std()).astype(np.float32)
        self._drift_rad = rng.uniform(0, 2 * np.pi)
        self._phase = rng.uniform(0, 2 * np.pi, 3)

    def apply(self, yuv: Image, view: View, t_s: float) -> None:
        """Light a planar YUV 4:2:0 frame in place (luma 16 … 235)."""
        picture = self._picture
        gain = picture.brightness * self._change(t_s)
        if gain == 1.0 and not picture.clouds and not picture.haze:
            return
        width, height = view.pose.intrinsics.width_px, view.pose.intrinsics.height_px
        columns, rows = max(width // COARSE, 2), max(height // COARSE, 2)
        v, u = np.meshgrid(
            (np.arange(rows) + 0.5) * height / rows,
            (np.arange(columns) + 0.5) * width / columns,
            indexing="ij",
        )
        H = np.asarray(np.linalg.inv(view.ground_homography()), np.float64)
        ground = apply_homography(H, np.stack([u, v], axis=-1))
        field = np.full((rows, columns), gain, np.float32)
        if picture.clouds:
            field *= self._cloud_gain(ground, t_s)
        clear = np.ones_like(field)
        if picture.haze:
            away = np.linalg.norm(ground - view.camera_enu[:2], axis=-1)
            away = np.where(np.isnan(away), 1e5, np.hypot(away, view.pose.height_agl_m))
            clear = np.exp(-1.1 * picture.haze * away / HAZE_FULL_M).astype(np.float32)
        slope = field * clear
        haze = HAZE_LUMA * min(gain, 1.0) * (1 - clear) + 16 * (1 - slope)
        _affine(yuv[:height], slope, haze)
        for plane in _chroma(yuv, width, height):
            _affine(plane, slope, 128 * (1 - slope))

    def _change(self, t_s: float) -> float:
        if not self._picture.brightness_change:
            return 1.0
        waves = [
            math.sin(2 * math.pi * t_s / p + f)
            for p, f in zip((37, 13, 5), self._phase, strict=True)
        ]
        return 1.0 + self._picture.brightness_change * (
            0.6 * waves[0] + 0.3 * waves[1] + 0.1 * waves[2]
        )

    def _cloud_gain(self, ground: Floats, t_s: float) -> F32:
        """Return the sunlight that clouds leave, 0.4 … 1, for ground points."""
        move = self._picture.cloud_speed_mps * t_s
        at = ground - move * np.array([math.cos(self._drift_rad), math.sin(self._drift_rad)])
        at = np.nan_to_num(at) / CLOUD_CELL_M
        x, y = (np.mod(at[..., i], CLOUD_TILE).astype(np.float32) for i in (0, 1))
        value = cv2.remap(self._clouds, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        cover = 1 / (1 + np.exp(-6.0 * (value - 1.3 + 2.2 * self._picture.clouds)))
        return np.asarray((1 - 0.55 * cover).astype(np.float32))


def _affine(plane: Image, slope: F32, offset: F32) -> None:
    """Replace plane by slope × plane + offset, both fields given coarsely."""
    size = plane.shape[1], plane.shape[0]
    if np.ptp(slope) < 1e-4 and np.ptp(offset) < 1e-2:
        lut = np.clip(np.arange(256) * slope.flat[0] + offset.flat[0] + 0.5, 0, 255)
        plane[:] = cv2.LUT(plane, lut.astype(np.uint8))
        return
    wide = cv2.resize(slope.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    wide = cv2.multiply(plane, wide, dtype=cv2.CV_32F)
    wide += cv2.resize(offset.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    cv2.convertScaleAbs(wide, dst=plane)


def _chroma(yuv: Image, width: int, height: int) -> list[Image]:
    """Return the two colour planes as views of a planar frame."""
    flat = yuv.reshape(-1)
    size = width * height
    shape = (height // 2, width // 2)
    quarter = shape[0] * shape[1]
    return [
        flat[size : size + quarter].reshape(shape),
        flat[size + quarter : size + 2 * quarter].reshape(shape),
    ]
