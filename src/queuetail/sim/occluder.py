"""A sign gantry or a bridge over the road, which hides what is under it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.flight import GroundPlane, View
from queuetail.sim.scenario import Picture, Scenario
from queuetail.sim.scenery import ONE, SHADE_DARK, SHIFT, darken, sun_vector
from queuetail.types import Bools, Floats, Image

FACES = ((4, 5, 6, 7), (2, 3, 7, 6), (0, 1, 5, 4), (3, 0, 4, 7), (1, 2, 6, 5))
BRIDGE_REACH_M = 130.0  # beyond the road on both sides: out of the picture
CONCRETE, DECK, STEEL = (150, 154, 156), (104, 104, 103), (136, 134, 130)
TONES = (1.0, 0.8, 0.72, 0.66, 0.6)


@dataclass(frozen=True, slots=True)
class Occluder:
    """Boxes in ENU, (n, 8, 3) corners, drawn from the last to the first, and their colours."""

    boxes: Floats
    colours: tuple[tuple[int, int, int], ...]

    @classmethod
    def of(cls, scenario: Scenario) -> Occluder | None:
        """Return a scenario's occluder; None where it has none."""
        kind, road, other = scenario.picture.occluder, scenario.road, scenario.opposite
        if kind == "none":
            return None
        at_m = VIEW_STATION_M + scenario.picture.occluder_at_m
        low = -(road.lanes * road.lane_width_m + road.shoulder_m)
        high = 1.5
        if other.lanes:
            high = other.median_m + other.lanes * road.lane_width_m + road.shoulder_m
        if kind == "bridge":
            ends = low - BRIDGE_REACH_M, high + BRIDGE_REACH_M
            spans = [
                (at_m + 4.4, at_m + 5.0, *ends, 5.2, 7.5),
                (at_m - 5.0, at_m - 4.4, *ends, 5.2, 7.5),
                (at_m - 4.4, at_m + 4.4, *ends, 5.2, 6.5),
            ]
            colours = [CONCRETE, CONCRETE, DECK]
        else:
            spans = [(at_m - 0.6, at_m + 0.6, low - 1.0, high + 1.0, 6.0, 7.4)]
            spans += [
                (at_m - 0.3, at_m + 0.3, e - 0.3, e + 0.3, 0.0, 6.0) for e in (low - 1, high + 1)
            ]
            colours = [STEEL] * len(spans)
        plane, axis = GroundPlane.of(road), Axis.of(road)
        return cls(np.stack([_box(axis, plane, at_m, span) for span in spans]), tuple(colours))

    def draw(self, picture: Image, view: View) -> None:
        """Draw the boxes over a frame, posts first, in place."""
        for box, base in zip(self.boxes[::-1], self.colours[::-1], strict=True):
            px = view.px_of(box)
            if not np.isfinite(px).all():
                continue
            for ring, tone in zip(FACES, TONES, strict=True):
                corners = px[list(ring)]
                x, y = corners[:, 0], corners[:, 1]
                if (x * np.roll(y, -1) - np.roll(x, -1) * y).sum() < 0:
                    points = np.round((corners - 0.5) * ONE).astype(np.int32)
                    colour = tuple(int(c * tone) for c in base)
                    cv2.fillConvexPoly(picture, points, colour, cv2.LINE_AA, SHIFT)

    def cast(self, picture: Image, view: View, settings: Picture) -> None:
        """Darken the still ground where the boxes hide the sun."""
        sun = sun_vector(settings)
        mask = np.zeros(picture.shape[:2], np.uint8)
        for box in self.boxes:
            fall = box[:, 2] - view.plane.height_m(box[:, :2])
            px = view.ground_px(box[:, :2] - sun[:2] / sun[2] * fall[:, None])
            if np.isfinite(px).all():
                hull = cv2.convexHull(np.round((px - 0.5) * ONE).astype(np.int32))
                cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_AA, SHIFT)
        darken(picture, mask, SHADE_DARK * settings.shadow / 0.6)

    def hides(self, view: View, px: Floats) -> Bools:
        """Tell which pixels lie behind a box, (n, 2) -> (n,)."""
        hidden = np.zeros(len(px), bool)
        for box in self.boxes:
            corners = view.px_of(box)
            if np.isfinite(corners).all():
                hull = cv2.convexHull(corners.astype(np.float32))
                for i, (u, v) in enumerate(px):
                    if np.isfinite(u + v):
                        hidden[i] |= cv2.pointPolygonTest(hull, (float(u), float(v)), False) >= 0
        return hidden


def _box(
    axis: Axis,
    plane: GroundPlane,
    at_m: float,
    span: tuple[float, float, float, float, float, float],
) -> Floats:
    s0, s1, o0, o1, z0, z1 = span
    heading = float(axis.heading_rad(np.array(at_m)))
    middle = axis.enu(np.array(at_m), np.array(0.0))
    ahead = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-ahead[1], ahead[0]])
    flat = [
        middle + (s - at_m) * ahead + o * left for s, o in ((s0, o1), (s0, o0), (s1, o0), (s1, o1))
    ]
    ground = float(plane.height_m(middle))
    return np.array([[*p, ground + z] for z in (z0, z1) for p in flat])
