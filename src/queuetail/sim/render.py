"""Frames of a flight: the still world by homography, vehicles, light, noise."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.sim.axis import Axis
from queuetail.sim.cars import VehiclePainter, place
from queuetail.sim.flight import GroundPlane, TruePath, View
from queuetail.sim.ground import Noise, key_view, shade_key
from queuetail.sim.light import Light
from queuetail.sim.occluder import Occluder
from queuetail.sim.scenario import Scenario
from queuetail.sim.scenery import draw_scenery, plan_scenery, sun_vector
from queuetail.sim.traffic import Traffic
from queuetail.sim.treeshade import TreeShade
from queuetail.types import Floats, Image

KEY_MARGIN = 0.10  # of the picture's width, on each side
NOISE_BANK = 6
NOISE_PAD = 64


@dataclass(frozen=True, slots=True)
class Key:
    """One drawing of the still world and the view that it was drawn from."""

    view: View
    picture: Image

    def to_frame(self, view: View) -> Floats:
        """Return the homography from key pixels to a frame's pixels."""
        return view.ground_homography() @ np.linalg.inv(self.view.ground_homography())

    def covers(self, view: View) -> bool:
        """Tell whether the key shows everything that a frame shows."""
        lens, own = view.pose.intrinsics, self.view.pose.intrinsics
        width, height = lens.width_px, lens.height_px
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1.0]])
        seen = corners @ np.linalg.inv(self.to_frame(view)).T
        px = seen[:, :2] / seen[:, 2:]
        size = np.array([own.width_px, own.height_px])
        return bool((seen[:, 2] > 0).all() and (px > 1).all() and (px < size - 1).all())


class Renderer:
    """Draws any frame of a flight; safe to call from several threads."""

    def __init__(self, scenario: Scenario, traffic: Traffic, path: TruePath, seed: int) -> None:
        self._scenario, self._traffic, self._path = scenario, traffic, path
        self._axis = Axis.of(scenario.road)
        self._plane = GroundPlane.of(scenario.road)
        self._noise = Noise(seed)
        self._scenery = plan_scenery(scenario, seed)
        picture = scenario.picture
        self._cars = VehiclePainter(traffic, self._plane, sun_vector(picture), picture.shadow)
        self._light = Light(scenario, seed)
        self._trees = TreeShade(scenario, seed)
        self._occluder = Occluder.of(scenario)
        self._scale = 1.3 if picture.width_px <= 1920 else 1.0
        self._keys: list[Key] = []
        self._lock = threading.Lock()
        self._grain = _grain(picture.width_px, picture.height_px, picture.noise, seed)
        self._seed = seed

    def frame_yuv(self, index: int, t_s: float) -> Image:
        """Return frame `index` at time `t_s` as planar YUV 4:2:0, (height · 3 / 2, width)."""
        view = self._path.view(t_s)
        key = self._key_for(view)
        lens = view.pose.intrinsics
        size = lens.width_px, lens.height_px
        shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
        H = shift @ key.to_frame(view) @ np.linalg.inv(shift)
        picture = cv2.warpPerspective(key.picture, H, size, flags=cv2.INTER_LINEAR)
        standing = place(self._traffic, self._axis, t_s)
        self._cars.draw(picture, standing, view)
        self._trees.draw(picture, view, t_s)
        if self._occluder:
            self._occluder.draw(picture, view)
        yuv = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV_I420)
        self._light.apply(yuv, view, t_s)
        self._add_grain(yuv, index)
        return np.asarray(yuv)

    def _key_for(self, view: View) -> Key:
        with self._lock:
            for key in reversed(self._keys):
                if key.covers(view):
                    return key
            wide = key_view(view, KEY_MARGIN, self._scale)
            picture = shade_key(self._scenario, wide, self._noise)
            draw_scenery(picture, self._scenario, self._scenery, wide)
            if self._occluder:
                self._occluder.cast(picture, wide, self._scenario.picture)
            self._keys = [*self._keys[-2:], Key(wide, picture)]
            return self._keys[-1]

    def _add_grain(self, yuv: Image, index: int) -> None:
        """Add the sensor's noise to the luma plane: a bank of tiles at random offsets."""
        if not len(self._grain):
            return
        rng = np.random.default_rng([self._seed, 23, index])
        tile = self._grain[int(rng.integers(len(self._grain)))]
        y, x = (int(k) for k in rng.integers(0, NOISE_PAD, 2))
        height, width = yuv.shape[0] * 2 // 3, yuv.shape[1]
        luma = yuv[:height]
        cv2.add(luma, tile[y : y + height, x : x + width], dst=luma, dtype=cv2.CV_8U)


def _grain(width: int, height: int, sigma: float, seed: int) -> list[NDArray[np.int8]]:
    if not sigma:
        return []
    rng = np.random.default_rng([seed, 19])
    shape = (height + NOISE_PAD, width + NOISE_PAD)
    return [
        np.clip(np.round(rng.normal(0, sigma, shape).astype(np.float32)), -127, 127).astype(np.int8)
        for _ in range(NOISE_BANK)
    ]
