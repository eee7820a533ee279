"""Shadows of trees that stand beside the road and sway in the wind, over road and vehicles."""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.flight import View
from queuetail.sim.scenario import Scenario
from queuetail.types import Image

LEAVES = 26
CORNERS = 14


class TreeShade:
    """Leafy shadows: each is a cloud of ellipses that rocks with its own rhythm."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        rng = np.random.default_rng([seed, 31])
        count = scenario.picture.tree_shadows
        road = scenario.road
        self._depth = 0.75 * scenario.picture.shadow
        right = road.lanes * road.lane_width_m
        spread = rng.uniform(-150, 150, count)
        reach = rng.uniform(-right - 4.0, 1.0, count)
        centre = Axis.of(road).enu(VIEW_STATION_M + spread, reach).reshape(-1, 2)
        size = rng.uniform(1.6, 4.0, count)
        turn = rng.uniform(0, 2 * np.pi, (count, LEAVES))
        out = np.sqrt(rng.uniform(0, 1, (count, LEAVES))) * size[:, None]
        leaves = np.stack([out * np.cos(turn), out * np.sin(turn)], axis=-1)
        self._leaf_enu = centre[:, None, :] + leaves
        self._leaf_m = rng.uniform(0.15, 0.4, (count, LEAVES)) * size[:, None]
        self._omega = rng.uniform(1.2, 3.0, (count, LEAVES, 2))
        self._phase = rng.uniform(0, 2 * np.pi, (count, LEAVES, 2))
        self._plane_height = scenario.flight.height_m

    def draw(self, picture: Image, view: View, t_s: float) -> None:
        """Darken a frame in place."""
        if not self._leaf_m.size:
            return
        sway = 0.28 * np.sin(self._omega * t_s + self._phase)
        sway += 0.35 * np.sin(0.8 * t_s + self._phase[:, :1])
        centre = (self._leaf_enu + sway).reshape(-1, 2)
        ring = np.linspace(0, 2 * np.pi, CORNERS, endpoint=False)
        circle = np.stack([np.cos(ring), np.sin(ring)], axis=-1)
        around = centre[:, None, :] + self._leaf_m.reshape(-1, 1, 1) * circle
        px = view.ground_px(around.reshape(-1, 2)).reshape(-1, CORNERS, 2)
        height, width = picture.shape[:2]
        finite = np.isfinite(px).all(axis=(1, 2))
        seen = (
            finite
            & (px > -200).all(axis=(1, 2))
            & (px < [width + 200, height + 200]).all(axis=(1, 2))
        )
        if not seen.any():
            return
        kept = px[seen]
        x0, y0 = np.clip(np.floor(kept.min(axis=(0, 1))), 0, [width, height]).astype(int)
        x1, y1 = np.clip(np.ceil(kept.max(axis=(0, 1))) + 1, 0, [width, height]).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        for polygon in np.round((kept - [x0 + 0.5, y0 + 0.5]) * 16).astype(np.int32):
            cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_AA, 4)
        mask = cv2.GaussianBlur(mask, (5, 5), 0)
        factor = 255 - cv2.convertScaleAbs(mask, alpha=self._depth)
        cut = picture[y0:y1, x0:x1]
        cut[:] = cv2.multiply(cut, cv2.merge([factor] * 3), scale=1 / 255)
