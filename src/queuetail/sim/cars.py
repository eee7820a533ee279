"""Vehicles drawn as frusta with cabins and glass, with correct occlusion, and their shadows."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.sim.axis import Axis
from queuetail.sim.bodies import BODIES, PAINTS, Body
from queuetail.sim.flight import GroundPlane, View
from queuetail.sim.scenery import ONE, SHIFT
from queuetail.sim.traffic import Traffic
from queuetail.types import Floats, Image, Ints

FACES = ((4, 5, 6, 7), (2, 3, 7, 6), (0, 1, 5, 4), (3, 0, 4, 7), (1, 2, 6, 5))
TOP = 0  # top, front, rear, left, right
AMBIENT = 0.62


@dataclass(frozen=True, slots=True)
class Standing:
    """The vehicles of one instant, placed in the world."""

    index: Ints  # into the traffic's columns
    centre_enu: Floats  # (n, 2) of the footprint
    heading_rad: Floats  # (n,) from east
    speed_mps: Floats
    rear_enu: Floats  # (n, 2) middle of the rear bumper on the road


def place(traffic: Traffic, axis: Axis, t_s: float) -> Standing:
    """Return where every vehicle stands at a time: boxes centred on the road's axis frame."""
    index, front, offset, speed = traffic.at(t_s)
    length, back = traffic.length_m[index], traffic.opposite[index]
    station = np.where(back, front + length / 2, front - length / 2)
    centre = axis.enu(station, offset)
    heading = axis.heading_rad(station) + np.where(back, np.pi, 0.0)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return Standing(index, centre, heading, speed, centre - ahead * (length / 2)[:, None])


def corners_enu(standing: Standing, traffic: Traffic, plane: GroundPlane, row: int) -> Floats:
    """Return the corners of every part of one vehicle, (parts, 8, 3) in ENU."""
    body = BODIES[traffic.body[standing.index[row]]]
    local = np.stack([part.corners() for part in body.parts])
    cos, sin = np.cos(standing.heading_rad[row]), np.sin(standing.heading_rad[row])
    x, y = local[..., 0] - body.length_m / 2, local[..., 1]
    enu = standing.centre_enu[row] + np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)
    return np.concatenate([enu, (local[..., 2] + plane.height_m(enu))[..., None]], axis=-1)


class VehiclePainter:
    """Draws the vehicles of an instant into a picture."""

    def __init__(self, traffic: Traffic, plane: GroundPlane, sun: Floats, shadow: float) -> None:
        self._traffic, self._plane, self._sun = traffic, plane, sun
        self._shadow = shadow

    def draw(self, picture: Image, standing: Standing, view: View) -> None:
        """Draw shadows, then vehicles from the farthest to the nearest, in place."""
        lens = view.pose.intrinsics
        px = view.ground_px(standing.centre_enu)
        pad = 0.06 * lens.width_px + 20.0 * lens.fx_px / view.pose.height_agl_m
        near = (px > -pad).all(1) & (px < [lens.width_px + pad, lens.height_px + pad]).all(1)
        rows = np.flatnonzero(near)
        if not len(rows):
            return
        camera = view.camera_enu
        far = np.hypot(*(standing.centre_enu[rows] - camera[:2]).T)
        rows = rows[np.argsort(-far)]
        boxes = [corners_enu(standing, self._traffic, self._plane, int(row)) for row in rows]
        if self._shadow > 0:
            self._cast(picture, boxes, view)
        all_px = view.px_of(np.concatenate([b.reshape(-1, 3) for b in boxes]))
        start = 0
        for row, box in zip(rows, boxes, strict=True):
            count = box.shape[0] * 8
            flat = all_px[start : start + count].reshape(-1, 8, 2)
            start += count
            self._draw_one(picture, standing, int(row), box, flat, camera)

    def _cast(self, picture: Image, boxes: list[Floats], view: View) -> None:
        """Darken the ground where boxes hide the sun."""
        slope = self._sun[:2] / self._sun[2]
        outlines, counts = [], []
        for box in boxes:
            fall = box[..., 2] - self._plane.height_m(box[..., :2])
            outlines.append((box[..., :2] - slope * fall[..., None]).reshape(-1, 2))
            counts.append(len(box))
        px = view.ground_px(np.concatenate(outlines))
        height, width = picture.shape[:2]
        x0, y0 = np.clip(np.nanmin(px, axis=0) - 3, 0, [width, height]).astype(int)
        x1, y1 = np.clip(np.nanmax(px, axis=0) + 4, 0, [width, height]).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
        points = np.round((px - [x0 + 0.5, y0 + 0.5]) * ONE)
        start = 0
        for count in counts:
            for part in range(start, start + 8 * count, 8):
                corners = points[part : part + 8]
                if np.isfinite(corners).all():
                    hull = cv2.convexHull(corners.astype(np.int32))
                    cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_AA, SHIFT)
            start += 8 * count
        mask = cv2.GaussianBlur(mask, (3, 3), 0)
        factor = cv2.convertScaleAbs(mask, alpha=self._shadow)
        np.subtract(255, factor, out=factor)
        cut = picture[y0:y1, x0:x1]
        cut[:] = cv2.multiply(cut, cv2.merge([factor] * 3), scale=1 / 255)

    def _draw_one(
        self,
        picture: Image,
        standing: Standing,
        row: int,
        box: Floats,
        px: Floats,
        camera: Floats,
    ) -> None:
        """Draw one vehicle on a finer patch and blend it in: coverage exact to a quarter pixel."""
        if not np.isfinite(px).all():
            return
        height, width = picture.shape[:2]
        x0, y0 = np.maximum(np.floor(px.min(axis=(0, 1))).astype(int) - 1, 0)
        x1, y1 = np.minimum(np.ceil(px.max(axis=(0, 1))).astype(int) + 1, [width, height])
        if x1 <= x0 or y1 <= y0:
            return
        fine = 4 if (x1 - x0) * (y1 - y0) < 10_000 else 2
        patch = np.zeros(((y1 - y0) * fine, (x1 - x0) * fine, 4), np.uint8)
        column = int(standing.index[row])
        body = BODIES[self._traffic.body[column]]
        paint = PAINTS[self._traffic.paint[column]]
        points = np.round(((px - [x0, y0]) * fine - 0.5) * ONE).astype(np.int32)
        heading = float(standing.heading_rad[row])
        shades = self._shades(heading)
        for part in _part_order(body, box, camera):
            colours = body.parts[part].sides or paint, body.parts[part].top or paint
            for face, ring in enumerate(FACES):
                corners = points[part][list(ring)]
                if _clockwise(px[part][list(ring)]):
                    tone = shades[face] * (1.0 if face == TOP else 0.92)
                    base = colours[1] if face == TOP else colours[0]
                    colour = tuple(min(255.0, c * tone) for c in base)
                    cv2.fillConvexPoly(patch, corners, (*colour, 255), cv2.LINE_8, SHIFT)
        small = cv2.resize(patch, (x1 - x0, y1 - y0), interpolation=cv2.INTER_AREA)
        cut = picture[y0:y1, x0:x1]
        keep = 255 - small[..., 3:].astype(np.uint16)
        cut[:] = small[..., :3] + ((cut * keep + 127) // 255).astype(np.uint8)

    def _shades(self, heading: float) -> list[float]:
        """Return how bright each face is: ambient light and Lambert's law."""
        cos, sin = np.cos(heading), np.sin(heading)
        normals = np.array(
            [[0, 0, 1], [cos, sin, 0.2], [-cos, -sin, 0.2], [-sin, cos, 0.1], [sin, -cos, 0.1]]
        )
        lit = np.maximum(normals @ self._sun, 0.0) * (0.3 + 0.7 * min(self._shadow / 0.5, 1.0))
        return [float(s) for s in AMBIENT + (1.08 - AMBIENT) * lit / max(self._sun[2], 0.55)]


def _part_order(body: Body, box: Floats, camera: Floats) -> list[int]:
    """Return the parts in painting order: far groups first, in a group from below upwards."""
    groups = sorted({part.group for part in body.parts})
    if len(groups) == 1:
        return list(range(len(body.parts)))
    far = {
        g: max(
            float(np.linalg.norm(box[i].mean(axis=0) - camera))
            for i, part in enumerate(body.parts)
            if part.group == g
        )
        for g in groups
    }
    return sorted(range(len(body.parts)), key=lambda i: -far[body.parts[i].group])


def _clockwise(ring: Floats) -> bool:
    """Tell whether a projected face looks at the camera (v runs downwards)."""
    x, y = ring[:, 0], ring[:, 1]
    area = 0.0
    for i in range(4):
        j = (i + 1) % 4
        area += x[i] * y[j] - x[j] * y[i]
    return area < 0
