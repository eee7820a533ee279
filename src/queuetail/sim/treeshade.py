"""Shadows of trees that stand beside the road and sway in the wind, over road and vehicles."""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.sim.flight import GroundPlane, View
from queuetail.sim.scenario import Scenario
from queuetail.sim.scenery import crown, roadside_trees, sun_vector
from queuetail.types import Floats, Image

RING = 14  # corners of a leafy lump's outline
LEAF_SWAY_M, TREE_SWAY_M = 0.25, 0.35
DEPTH = 0.9  # of the shadow setting: leaves let some light through


class TreeShade:
    """Leafy shadows: each lump of a crown rocks with its own rhythm, each tree with another."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        plane, sun = GroundPlane.of(scenario.road), sun_vector(scenario.picture)
        rng = np.random.default_rng([seed, 59])
        self._depth = DEPTH * scenario.picture.shadow
        lumps = [crown(tree, plane) for tree in roadside_trees(scenario, seed)]
        centres = [c for c, _ in lumps] or [np.zeros((0, 3))]
        tree = np.repeat(np.arange(len(lumps)), [len(r) for _, r in lumps])
        top = np.concatenate(centres)
        fall = top[:, 2] - plane.height_m(top[:, :2])
        self._feet_enu = top[:, :2] - sun[:2] / sun[2] * fall[:, None]
        self._radius_m = np.concatenate([r for _, r in lumps] or [np.zeros(0)])
        self._omega = rng.uniform(1.2, 3.0, (len(top), 2))
        self._phase = rng.uniform(0, 2 * np.pi, (len(top), 2))
        self._tree_phase = rng.uniform(0, 2 * np.pi, (len(lumps), 2))[tree]

    def draw(self, picture: Image, view: View, t_s: float) -> None:
        """Darken a frame in place."""
        if not len(self._radius_m) or not self._depth:
            return
        px = self._outlines_px(view, t_s)
        height, width = picture.shape[:2]
        x0, y0 = np.clip(np.floor(px.min(axis=(0, 1))), 0, [width, height]).astype(int)
        x1, y1 = np.clip(np.ceil(px.max(axis=(0, 1))) + 1, 0, [width, height]).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        for polygon in np.round((px - [x0 + 0.5, y0 + 0.5]) * 16).astype(np.int32):
            cv2.fillConvexPoly(mask, polygon, 255, cv2.LINE_AA, 4)
        mask = cv2.GaussianBlur(mask, (5, 5), 0)
        factor = 255 - cv2.convertScaleAbs(mask, alpha=self._depth)
        cut = picture[y0:y1, x0:x1]
        cut[:] = cv2.multiply(cut, cv2.merge([factor] * 3), scale=1 / 255)

    def _outlines_px(self, view: View, t_s: float) -> Floats:
        """Return the lumps' outlines near the picture, (n, RING, 2)."""
        sway = LEAF_SWAY_M * np.sin(self._omega * t_s + self._phase)
        sway = sway + TREE_SWAY_M * np.sin(0.8 * t_s + self._tree_phase)
        ring = np.linspace(0, 2 * np.pi, RING, endpoint=False)
        circle = np.stack([np.cos(ring), np.sin(ring)], axis=-1)
        around = (self._feet_enu + sway)[:, None, :] + self._radius_m[:, None, None] * circle
        px = view.ground_px(around.reshape(-1, 2)).reshape(-1, RING, 2)
        lens = view.pose.intrinsics
        near = np.isfinite(px).all(axis=(1, 2)) & (px > -200).all(axis=(1, 2))
        near &= (px < [lens.width_px + 200, lens.height_px + 200]).all(axis=(1, 2))
        kept = px[near]
        return kept if len(kept) else np.full((1, RING, 2), -1000.0)
