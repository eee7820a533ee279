"""Trees, bushes, posts, cones and the occluder: still things that stand on the ground."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.flight import GroundPlane, View
from queuetail.sim.scenario import Picture, Scenario
from queuetail.types import Floats, Image

SHIFT = 4
ONE = 1 << SHIFT
REACH_M = 420.0
BUSH_COUNT, TREE_COUNT = 1500, 130
CONE = (28, 92, 232)
SHADE_DARK = 0.45  # of what is lit, in full sun and with shadow = 1


@dataclass(frozen=True, slots=True)
class Plant:
    """A tree or a bush: place, crown radius and height in metres, colour BGR, and its own seed."""

    east_m: float
    north_m: float
    radius_m: float
    height_m: float
    colour: tuple[int, int, int]
    seed: int


@dataclass(frozen=True, slots=True)
class Scenery:
    """Everything still that is not flat."""

    plants: tuple[Plant, ...]
    roadside: tuple[Plant, ...]  # their shadows sway, so they are drawn on each frame
    posts_enu: Floats  # (n, 2)
    cones_enu: Floats  # (n, 2)


def sun_vector(picture: Picture) -> Floats:
    """Return the unit vector towards the sun in ENU, (3,)."""
    azimuth, elevation = map(math.radians, (picture.sun_azimuth_deg, picture.sun_elevation_deg))
    flat = math.cos(elevation)
    return np.array([flat * math.sin(azimuth), flat * math.cos(azimuth), math.sin(elevation)])


def plan_scenery(scenario: Scenario, seed: int) -> Scenery:
    """Scatter plants beside the road, and put posts and cones where they belong."""
    rng = np.random.default_rng([seed, 17])
    axis, road, other = Axis.of(scenario.road), scenario.road, scenario.opposite
    right = road.lanes * road.lane_width_m
    low = -(right + road.shoulder_m)
    high = (
        other.median_m + other.lanes * road.lane_width_m + road.shoulder_m if other.lanes else 1.0
    )
    plants = []
    count = BUSH_COUNT + TREE_COUNT
    spots = rng.normal(0, 0.5 * REACH_M, (count, 2))
    _, offsets = axis.locate(spots)
    clear = 6.0 if road.ramp == "none" else 30.0
    for i, ((east, north), offset) in enumerate(zip(spots, offsets, strict=True)):
        tree = i >= BUSH_COUNT
        radius = rng.uniform(1.6, 4.2) if tree else rng.uniform(0.25, 1.1)
        if low - clear - radius < offset < high + clear + radius:
            continue
        height = radius * rng.uniform(1.8, 2.6) if tree else radius * 1.2
        tone = rng.uniform(0.7, 1.25)
        shade = [(36, 66, 50), (42, 82, 66), (52, 84, 84)][int(rng.integers(3))]
        colour = (int(shade[0] * tone), int(shade[1] * tone), int(shade[2] * tone))
        plants.append(Plant(east, north, radius, height, colour, int(rng.integers(1 << 30))))
    stations = VIEW_STATION_M + np.arange(-400, 401, 50.0)
    posts = axis.enu(stations, np.full(len(stations), low - 1.4))
    return Scenery(tuple(plants), roadside_trees(scenario, seed), posts, _cones(scenario, axis))


def roadside_trees(scenario: Scenario, seed: int) -> tuple[Plant, ...]:
    """Return the trees whose shadows sway over the road: a row on the side where the sun stands."""
    rng = np.random.default_rng([seed, 31])
    axis, road, other = Axis.of(scenario.road), scenario.road, scenario.opposite
    heading = float(axis.heading_rad(np.array(VIEW_STATION_M)))
    sun = sun_vector(scenario.picture)
    from_left = sun[1] * math.cos(heading) - sun[0] * math.sin(heading) > 0
    low = -(road.lanes * road.lane_width_m + road.shoulder_m)
    high = (
        other.median_m + other.lanes * road.lane_width_m + road.shoulder_m if other.lanes else 1.0
    )
    trees = []
    for _ in range(scenario.picture.tree_shadows):
        radius = rng.uniform(1.8, 3.6)
        beside = radius + rng.uniform(0.5, 4.0)
        offset = high + beside if from_left else low - beside
        enu = axis.enu(np.array(VIEW_STATION_M + rng.uniform(-150, 150)), np.array(offset))
        tone = rng.uniform(0.8, 1.2)
        colour = (int(42 * tone), int(78 * tone), int(60 * tone))
        height = radius * rng.uniform(2.0, 3.2)
        trees.append(
            Plant(float(enu[0]), float(enu[1]), radius, height, colour, int(rng.integers(1 << 30)))
        )
    return tuple(trees)


def _cones(scenario: Scenario, axis: Axis) -> Floats:
    """Return cones: a taper that closes the left lane, or a few at the flagger's stop line."""
    queue, road = scenario.traffic.queue, scenario.road
    at_m, right = VIEW_STATION_M + queue.at_m, road.lanes * road.lane_width_m
    if queue.cause == "lane_drop":
        taper = np.arange(0, 60.0, 5.0)
        beyond = np.arange(60.0, 400.0, 12.0)
        station = at_m + np.concatenate([taper - 60.0 + 70.0, beyond + 10.0])
        offset = np.concatenate(
            [-road.lane_width_m * (0.03 + 0.95 * taper / 60.0), beyond * 0 - road.lane_width_m]
        )
        return axis.enu(station, offset)
    if queue.cause == "flagger":
        station = at_m + np.array([6.0, 12.0, 18.0, 24.0, 30.0])
        return axis.enu(station, np.full(5, -right - 0.6))
    return np.zeros((0, 2))


def draw_scenery(picture: Image, scenario: Scenario, scenery: Scenery, view: View) -> None:
    """Draw the still things and their shadows onto a key picture, far ones first."""
    camera = view.camera_enu
    focal = view.pose.intrinsics.fx_px
    lens = view.pose.intrinsics
    sun = sun_vector(scenario.picture)
    plants = scenery.plants + scenery.roadside
    places = np.array([(p.east_m, p.north_m) for p in plants]).reshape(-1, 2)
    px = view.ground_px(places)
    pad = 60.0
    seen = (px > -pad).all(1) & (px < [lens.width_px + pad, lens.height_px + pad]).all(1)
    far = np.hypot(*(places - camera[:2]).T)
    order = [int(i) for i in np.argsort(-far) if bool(np.asarray(seen)[i])]
    _shade_plants(
        picture, scenario, [plants[i] for i in order if i < len(scenery.plants)], view, sun, focal
    )
    for i in order:
        _draw_plant(picture, plants[i], view, sun, focal)
    for enu, radius, height, colour in (
        *((e, 0.09, 1.1, (236, 238, 238)) for e in scenery.posts_enu),
        *((e, 0.18, 0.75, CONE) for e in scenery.cones_enu),
    ):
        _draw_stake(picture, enu, radius, height, colour, view)


def _depth(view: View, point: Floats) -> float:
    return float(np.linalg.norm(point - view.camera_enu))


def crown(plant: Plant, plane: GroundPlane) -> tuple[Floats, Floats]:
    """Return lumps of a crown, (n, 3) centres in ENU and (n,) radii in metres."""
    rng = np.random.default_rng(plant.seed)
    count = int(np.clip(plant.radius_m * 12, 6, 40))
    turn, out = rng.uniform(0, 2 * np.pi, count), np.sqrt(rng.uniform(0, 1, count))
    up = rng.uniform(-0.35, 0.45, count) + 0.3 * (1 - out)
    ground = float(plane.height_m(np.array([plant.east_m, plant.north_m])))
    centres = np.column_stack(
        [
            plant.east_m + 0.75 * plant.radius_m * out * np.cos(turn),
            plant.north_m + 0.75 * plant.radius_m * out * np.sin(turn),
            ground + plant.height_m * (0.6 + 0.4 * up),
        ]
    )
    return centres[np.argsort(centres[:, 2])], rng.uniform(0.25, 0.45, count) * plant.radius_m


def _shade_plants(
    picture: Image, scenario: Scenario, plants: list[Plant], view: View, sun: Floats, focal: float
) -> None:
    mask = np.zeros(picture.shape[:2], np.uint8)
    squash = max(0.35, abs(math.sin(math.radians(view.pose.pitch_deg))))
    for plant in plants:
        centres, radii = crown(plant, view.plane)
        fall = centres[:, 2] - view.plane.height_m(centres[:, :2])
        feet = centres[:, :2] - sun[:2] / sun[2] * fall[:, None]
        px = view.ground_px(feet)
        scale = focal / _depth(view, centres[0])
        for (u, v), radius in zip(px, radii, strict=True):
            if np.isfinite(u + v):
                axes = (int(radius * scale * ONE), int(radius * scale * squash * ONE))
                at = (int((u - 0.5) * ONE), int((v - 0.5) * ONE))
                cv2.ellipse(mask, at, axes, 0, 0, 360, 255, -1, cv2.LINE_AA, SHIFT)
    mask = cv2.GaussianBlur(mask, (3, 3), 0)
    darken(picture, mask, SHADE_DARK * scenario.picture.shadow / 0.6)


def darken(picture: Image, mask: Image, depth: float) -> None:
    """Multiply a picture by 1 − depth × mask / 255, in place."""
    factor = cv2.convertScaleAbs(mask, alpha=-min(depth, 0.9), beta=0)
    np.subtract(255, factor, out=factor)
    cv2.multiply(picture, cv2.merge([factor] * 3), dst=picture, scale=1 / 255)


def _draw_plant(picture: Image, plant: Plant, view: View, sun: Floats, focal: float) -> None:
    centres, radii = crown(plant, view.plane)
    rng = np.random.default_rng(plant.seed + 1)
    px = view.px_of(centres)
    scale = focal / _depth(view, centres[0])
    middle = centres.mean(axis=0)
    for (u, v), centre, radius in zip(px, centres, radii, strict=True):
        if not np.isfinite(u + v):
            continue
        lit = float((centre - middle) @ sun) / (plant.radius_m + 0.1)
        tone = 0.85 + 0.4 * lit + rng.uniform(-0.12, 0.12)
        colour = tuple(int(np.clip(c * tone, 0, 255)) for c in plant.colour)
        at = (int((u - 0.5) * ONE), int((v - 0.5) * ONE))
        cv2.circle(picture, at, int(radius * scale * ONE), colour, -1, cv2.LINE_AA, SHIFT)


def _draw_stake(
    picture: Image,
    enu: Floats,
    radius_m: float,
    height_m: float,
    colour: tuple[int, int, int],
    view: View,
) -> None:
    ground = float(view.plane.height_m(enu))
    ends = view.px_of(np.array([[*enu, ground], [*enu, ground + height_m]]))
    lens = view.pose.intrinsics
    if not (np.isfinite(ends).all() and (abs(ends - [lens.cx_px, lens.cy_px]) < 6000).all()):
        return
    scale = lens.fx_px / _depth(view, np.array([*enu, ground]))
    half = max(radius_m * scale, 0.45)
    along = ends[1] - ends[0]
    side = np.array([-along[1], along[0]]) / (np.linalg.norm(along) + 1e-6) * half
    corners = np.array([ends[0] - side, ends[0] + side, ends[1] + side, ends[1] - side])
    if np.linalg.norm(along) < 2 * half:
        corners = ends[0] + np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    points = np.round((corners - 0.5) * ONE).astype(np.int32)
    cv2.fillConvexPoly(picture, points, colour, cv2.LINE_AA, SHIFT)
