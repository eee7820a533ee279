"""The still world drawn once: land, asphalt, markings, trees and their shadows.

A *key picture* is a wider and finer picture from one pose; each frame is a homography of it, which
is exact for everything on the ground plane.  Every pixel is shaded by formulas with a box filter of
the pixel's own footprint, so that thin markings far away fade as they do in a real picture.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.flight import View
from queuetail.sim.scenario import Scenario
from queuetail.types import Floats, Image

F32 = NDArray[np.float32]
BAND_ROWS = 128
TILE = 512
MARK_WIDTH_M = 0.13
DASH_M, DASH_MODULE_M = 3.0, 12.0
SKY = np.array((226, 206, 186), np.float32)
WHITE = np.array((222, 224, 224), np.float32)
YELLOW = np.array((60, 172, 214), np.float32)
OCTAVES_M = (23.0, 9.0, 3.7, 1.6, 0.7, 0.32, 0.15)

LANDS: dict[str, tuple[tuple[int, int, int], ...]] = {  # BGR: lush, common, worn, bare
    "grass": ((42, 82, 66), (60, 104, 90), (84, 122, 116), (96, 124, 136)),
    "dry": ((92, 122, 132), (116, 148, 162), (136, 166, 182), (98, 128, 150)),
    "fields": ((48, 98, 72), (66, 122, 104), (104, 150, 158), (88, 112, 134)),
}


@dataclasses.dataclass(frozen=True, slots=True)
class Pixels:
    """Where a band of key pixels lies on the ground, and how much ground each covers."""

    east: F32
    north: F32
    station: F32
    offset: F32
    span_station: F32  # metres of station under one pixel
    span_offset: F32
    span: F32  # the longer side of the footprint


class Noise:
    """Smooth noise on the ground: octaves of periodic tiles, faded where a pixel covers them."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng([seed, 13])
        self._tiles = [rng.normal(0, 1, (TILE, TILE)).astype(np.float32) for _ in range(4)]

    def at(self, px: Pixels, cell_m: float, salt: int = 0) -> F32:
        """Return noise of unit variance at nodes with this cell size, (rows, columns)."""
        angle = 0.7 + 1.3 * salt + cell_m
        cos, sin = np.float32(math.cos(angle) / cell_m), np.float32(math.sin(angle) / cell_m)
        x = np.mod(px.east * cos + px.north * sin + 37.0 * salt, TILE).astype(np.float32)
        y = np.mod(px.north * cos - px.east * sin + 91.0 * salt, TILE).astype(np.float32)
        value = cv2.remap(self._tiles[salt % 4], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        fade = np.clip(2.0 * cell_m / np.maximum(px.span, 1e-3) - 1.0, 0.0, 1.0)
        return np.asarray(1.5 * value * fade, np.float32)


def covered(x: F32, low: float, high: float, span: F32) -> F32:
    """Return the share of each pixel (centre x, width span) between low and high."""
    inside = np.minimum(x + span / 2, high) - np.maximum(x - span / 2, low)
    return np.asarray(np.clip(inside / span, 0.0, 1.0), np.float32)


def dashed(x: F32, length_m: float, module_m: float, span: F32) -> F32:
    """Return the share of each pixel inside a periodic dash: exact box filter of a pulse train."""

    def integral(at: F32) -> F32:
        return np.asarray(
            np.floor(at / module_m) * length_m + np.minimum(np.mod(at, module_m), length_m),
            np.float32,
        )

    return np.asarray(
        (integral(np.float32(0.5) * span + x) - integral(x - np.float32(0.5) * span)) / span,
        np.float32,
    )


def mix(colour: F32, other: F32, share: F32) -> F32:
    """Blend a picture towards another picture or colour."""
    return np.asarray(colour + (other - colour) * share[..., None], np.float32)


def key_view(view: View, margin: float, scale: float) -> View:
    """Return the same pose with a wider (by margin of the width on each side) and finer picture."""
    lens = view.pose.intrinsics
    width = int(lens.width_px * (1 + 2 * margin) * scale)
    height = int((lens.height_px + 2 * margin * lens.width_px) * scale)
    wider = dataclasses.replace(
        lens,
        width_px=width,
        height_px=height,
        fx_px=lens.fx_px * scale,
        fy_px=lens.fy_px * scale,
        cx_px=width / 2,
        cy_px=height / 2,
    )
    return dataclasses.replace(view, pose=dataclasses.replace(view.pose, intrinsics=wider))


def shade_key(scenario: Scenario, view: View, noise: Noise) -> Image:
    """Return the still ground as seen by a view, (height, width, 3) BGR, without trees."""
    lens = view.pose.intrinsics
    H = np.asarray(np.linalg.inv(view.ground_homography()), np.float64)
    axis = Axis.of(scenario.road)
    picture = np.empty((lens.height_px, lens.width_px, 3), np.uint8)
    land = _land(scenario, noise)
    road = RoadShader(scenario, noise)
    for top in range(0, lens.height_px, BAND_ROWS):
        rows = np.arange(top, min(top + BAND_ROWS, lens.height_px), dtype=np.float64) + 0.5
        v, u = np.meshgrid(rows, np.arange(lens.width_px) + 0.5, indexing="ij")
        w = H[2, 0] * u + H[2, 1] * v + H[2, 2]
        sky = w < 1e-5
        px = _pixels(H, axis, u, v, np.where(sky, 1e-5, w))
        colour = road.paint(land(px), px)
        colour[sky] = SKY
        picture[top : top + len(rows)] = np.clip(colour + 0.5, 0, 255).astype(np.uint8)
    return picture


def _pixels(H: Floats, axis: Axis, u: Floats, v: Floats, w: Floats) -> Pixels:
    east = (H[0, 0] * u + H[0, 1] * v + H[0, 2]) / w
    north = (H[1, 0] * u + H[1, 1] * v + H[1, 2]) / w
    eu, ev = (H[0, 0] - east * H[2, 0]) / w, (H[0, 1] - east * H[2, 1]) / w
    nu, nv = (H[1, 0] - north * H[2, 0]) / w, (H[1, 1] - north * H[2, 1]) / w
    station, offset = axis.locate(np.stack([east, north], axis=-1))
    heading = axis.heading_rad(station)
    cos, sin = np.cos(heading), np.sin(heading)
    span_s = np.abs(cos * eu + sin * nu) + np.abs(cos * ev + sin * nv)
    span_o = np.abs(cos * nu - sin * eu) + np.abs(cos * nv - sin * ev)
    span = np.maximum(np.hypot(eu, nu), np.hypot(ev, nv))
    fields = (east, north, station, offset, span_s, span_o, span)
    return Pixels(*(np.asarray(a, np.float32) for a in fields))


def _land(scenario: Scenario, noise: Noise) -> Callable[[Pixels], F32]:
    colours = [np.array(c, np.float32) for c in LANDS[scenario.picture.land]]
    fields = scenario.picture.land == "fields"

    def paint(px: Pixels) -> F32:
        lush, common, worn, bare = colours
        slow, slower = noise.at(px, 23.0, 1), noise.at(px, 61.0, 2)
        base = np.broadcast_to(common, (*px.east.shape, 3)).astype(np.float32)
        base = mix(base, lush, np.clip(0.5 * slower + 0.2 * slow, 0, 1))
        base = mix(base, worn, np.clip(-0.5 * slower + 0.3 * slow, 0, 0.9))
        if fields:
            base = _parcels(base, px, noise, colours)
        patches = noise.at(px, 4.7, 3) + 0.8 * noise.at(px, 1.9, 2)
        base = mix(base, bare, np.clip(0.8 * (patches - 1.9), 0, 0.8))
        tufts = noise.at(px, 1.1, 0) + 0.7 * noise.at(px, 0.45, 1)
        base = mix(base, lush * 0.6, np.clip(0.7 * (tufts - 1.6), 0, 0.75))
        grain = np.zeros_like(px.span)
        for i, cell_m in enumerate(OCTAVES_M):
            grain += 0.045 * noise.at(px, cell_m, i)
        stones = np.clip(noise.at(px, 0.8, 3) - 2.9, 0, 1)
        return np.asarray(base * (1 + grain)[..., None] + 70 * stones[..., None], np.float32)

    return paint


def _parcels(base: F32, px: Pixels, noise: Noise, colours: list[F32]) -> F32:
    """Paint rectangular fields with crop rows, each with its own colour."""
    x = px.east * 0.94 + px.north * 0.34 + 40
    y = px.north * 0.94 - px.east * 0.34 + 25
    column, row = np.floor(x / 150.0), np.floor(y / 95.0)
    draw = np.mod(np.abs(np.sin(column * 12.9898 + row * 78.233) * 43758.5453), 1.0)
    for low, colour in (
        (0.0, colours[0]),
        (0.35, colours[1]),
        (0.6, colours[2]),
        (0.8, colours[3]),
    ):
        inside = ((draw >= low) & (draw < low + 0.35)).astype(np.float32)
        base = mix(base, colour, 0.75 * inside)
    rows = np.sin(x * (2 * np.pi / 2.8)) * np.clip(2.8 / px.span - 2, 0, 1)
    base = base * (1 + 0.06 * rows * (draw > 0.5))[..., None]
    edge = np.minimum(np.mod(x, 150.0), np.mod(y, 95.0))
    hedge = np.clip(2.2 + 0.8 * noise.at(px, 1.6, 2) - edge, 0, 1)
    return mix(np.asarray(base, np.float32), np.array((38, 66, 52), np.float32), hedge)


class RoadShader:
    """Asphalt, markings, verges: everything that follows the axis."""

    def __init__(self, scenario: Scenario, noise: Noise) -> None:
        self._noise = noise
        self._road, self._other = scenario.road, scenario.opposite
        self._queue = scenario.traffic.queue
        self._right_m = scenario.road.lanes * scenario.road.lane_width_m
        self._wear = 0.25 if scenario.road.markings == "new" else 1.0
        light = scenario.road.asphalt == "light"
        self._asphalt = np.array((150, 152, 153) if light else (98, 98, 97), np.float32)

    def paint(self, land: F32, px: Pixels) -> F32:
        """Lay the road on the land."""
        reach_m = 30.0 + self._other.median_m + self._other.lanes * self._road.lane_width_m
        near = np.abs(px.offset) < reach_m + self._right_m
        if self._road.ramp != "none":
            near |= np.abs(px.offset) < 160.0
        if not near.any():
            return land
        rows, columns = np.flatnonzero(near.any(1)), np.flatnonzero(near.any(0))
        cut = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
        part = Pixels(*(getattr(px, f.name)[cut] for f in dataclasses.fields(px)))
        land[cut] = self._lay(land[cut], part)
        return land

    def _lay(self, colour: F32, px: Pixels) -> F32:
        noise, right, width = self._noise, self._right_m, self._road.lane_width_m
        ragged = px.offset + 0.25 * noise.at(px, 1.3, 1) + 0.3 * noise.at(px, 5.0, 2)
        gravel = np.array((118, 132, 142), np.float32)
        low, high = -(right + self._road.shoulder_m), 0.7
        bands = [(low, high)]
        if self._other.lanes:
            far = self._other.median_m + self._other.lanes * width + self._road.shoulder_m
            inner = self._other.median_m - 0.7
            bands = [(low, far)] if inner < high + 0.6 else [(low, high), (inner, far)]
        for a, b in bands:
            verge = covered(ragged, a - 1.6, b + 1.6, np.maximum(px.span_offset, 0.5))
            colour = mix(colour, gravel * (1 + 0.1 * noise.at(px, 0.4, 3))[..., None], 0.8 * verge)
        tarmac = self._tarmac(px)
        ramp = self._ramp(px)
        if ramp is not None:
            colour = mix(colour, tarmac, ramp)
        for a, b in bands:
            colour = mix(colour, tarmac, covered(px.offset, a, b, px.span_offset))
        return self._mark(colour, px)

    def _ramp(self, px: Pixels) -> F32 | None:
        """Return the share of a ramp's asphalt: a strip that leaves or joins at a small angle."""
        if self._road.ramp == "none":
            return None
        along = px.station - VIEW_STATION_M - self._road.ramp_at_m
        if self._road.ramp == "off":
            along = -along
        away = np.maximum(0.0, -along) * 0.14 - np.maximum(0.0, along - 60) * 0.05
        centre = -self._right_m - 2.2 - away
        return covered(px.offset - centre, -2.4, 2.4, px.span_offset) * (along < 150)

    def _tarmac(self, px: Pixels) -> F32:
        noise, width = self._noise, self._road.lane_width_m
        across = np.mod(px.offset, width) - width / 2
        tracks = np.exp(-(((np.abs(across) - 0.85) / 0.35) ** 2))
        drip = np.exp(-((across / 0.3) ** 2))
        tone = 1 + 0.05 * tracks - 0.05 * drip
        tone = tone + 0.035 * noise.at(px, 7.0, 1) + 0.05 * noise.at(px, 0.5, 2)
        tone = tone + 0.05 * noise.at(px, 0.17, 3) + 0.03 * noise.at(px, 2.1, 0)
        patch = noise.at(px, 9.0, 3) > 2.6
        tone = tone - 0.16 * patch
        crack = np.abs(noise.at(px, 3.1, 2)) < 0.02 * np.clip(0.3 / px.span, 0, 1)
        tone = tone - 0.14 * crack * (noise.at(px, 11.0, 0) > 0.4)
        stain = np.clip(noise.at(px, 1.7, 1) - 2.4, 0, 0.6)
        tone = tone - 0.35 * stain
        if self._road.concrete_joints:
            tone = tone - 0.3 * dashed(px.station, 0.06, 5.0, px.span_station)
            tone = tone - 0.2 * dashed(px.offset + 0.03, 0.05, width, px.span_offset)
        return np.asarray(self._asphalt * tone[..., None], np.float32)

    def _mark(self, colour: F32, px: Pixels) -> F32:
        right, width, noise = self._right_m, self._road.lane_width_m, self._noise
        worn = np.clip(0.95 - self._wear * (0.35 + 0.3 * noise.at(px, 0.45, 1)), 0, 0.97)

        def line(centre: float) -> F32:
            half = MARK_WIDTH_M / 2
            return covered(px.offset, centre - half, centre + half, px.span_offset)

        dashes = dashed(px.station, DASH_M, DASH_MODULE_M, px.span_station)
        colour = mix(colour, YELLOW, worn * line(0.0))
        colour = mix(colour, WHITE, worn * line(-right))
        for i in range(1, self._road.lanes):
            colour = mix(colour, WHITE, worn * dashes * line(-i * width))
        if self._other.lanes:
            base = self._other.median_m
            colour = mix(colour, YELLOW, worn * line(base))
            colour = mix(colour, WHITE, worn * line(base + self._other.lanes * width))
            for i in range(1, self._other.lanes):
                colour = mix(colour, WHITE, worn * dashes * line(base + i * width))
        if self._queue.cause == "signal":
            at_m = VIEW_STATION_M + self._queue.at_m
            bar = covered(px.station, at_m + 0.3, at_m + 0.75, px.span_station)
            across = covered(px.offset, -right, 0.0, px.span_offset)
            colour = mix(colour, WHITE, worn * bar * across)
        return colour
