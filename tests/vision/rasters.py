"""Cameras above a road, pictures painted on its ground, and road-view rasters made by hand."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.types import (
    Approach,
    Band,
    CameraPose,
    Floats,
    Frame,
    GroundMapping,
    Image,
    Masks,
    Origin,
    RoadRaster,
)

ORIGIN = Origin(36.11, -97.057)
STRAIGHT = Approach("NB", np.array([[-300.0, 4.0], [300.0, 4.0]]), 100.0, 2, 3.6)
PX_PER_M = 5.0


def arc(radius_m: float = 200.0, turn_deg: float = 70.0) -> Approach:
    """Return a bend to the left that passes below the camera."""
    angle = np.radians(np.linspace(-turn_deg / 2, turn_deg / 2, 41))
    points = radius_m * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return Approach("bend", points, 0.0, 2, 3.6)


def camera(
    height_m: float = 120.0,
    pitch_deg: float = -90.0,
    yaw_deg: float = 0.0,
    size: tuple[int, int] = (1280, 720),
    at: tuple[float, float] = (ORIGIN.lat_deg, ORIGIN.lon_deg),
) -> GroundMapping:
    lens = intrinsics_from_hfov(*size, 84.0)
    pose = CameraPose(*at, height_m, yaw_deg, pitch_deg, 0.0, lens)
    return mapping_from_pose(pose, ORIGIN)


def frame(luma: Image, t_s: float = 0.0) -> Frame:
    return Frame(0, t_s, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))


def painted(
    mapping: GroundMapping, size: tuple[int, int], brightness: Callable[[Floats], Floats]
) -> Image:
    """Return the picture of a ground whose brightness at ENU points (n, 2) is given."""
    u, v = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    enu = px_to_enu(mapping, np.column_stack([u.ravel(), v.ravel()]))
    luma = np.nan_to_num(brightness(enu), nan=0.0)
    return np.clip(luma, 1, 255).astype(np.uint8).reshape(size[1], size[0])


def band(
    columns: int = 600,
    lanes: int = 2,
    first_column: int = 0,
    lean_px: tuple[float, float] = (0.0, 0.0),
    visible: tuple[int, int] | None = None,
) -> Band:
    """Return the one band of a raster with shoulders of 2.5 m beside lanes of 3.6 m."""
    rows = round((2 * 2.5 + lanes * 3.6) * PX_PER_M)
    return Band(
        approach_index=0,
        rows=(0, rows),
        columns=columns,
        first_column=first_column,
        visible_columns=visible or (0, columns),
        lane_rows=tuple((2.5 + (n + 0.5) * 3.6) * PX_PER_M for n in range(lanes)),
        lane_width_px=3.6 * PX_PER_M,
        lean_px=np.tile(np.array(lean_px, float), (12, 1)),
    )


def raster(image: Image, of: Band, plan: int = 1) -> RoadRaster:
    return RoadRaster(image, PX_PER_M, (of,), plan, ROAD)


ROAD = (STRAIGHT,)  # one tuple: another one would be another road


def asphalt(of: Band, seed: int = 0, level: float = 90.0, noise: float = 1.5) -> Image:
    """Return bare road: grain that stays with the place, and a broken marking between lanes."""
    rng = np.random.default_rng(seed)
    grain = rng.normal(0.0, 2.5, (of.rows[1], of.columns))
    road = level + cv2.GaussianBlur(grain, (0, 0), 1.0)
    row = round((2.5 + 3.6) * PX_PER_M)
    for start in range(20, of.columns, 60):
        road[row - 1 : row + 1, start : start + 15] = 190.0
    return np.asarray(road, np.float32)


def seen(road: Image, rng: np.random.Generator, gain: float | Floats = 1.0) -> Image:
    """Return one noisy picture of a road (with what stands on it), in some light.

    Where the road is 0 the picture shows none of it.
    """
    noisy = road * gain + rng.normal(0.0, 1.2, road.shape)
    return np.where(road > 0, np.clip(np.rint(noisy), 1, 255), 0).astype(np.uint8)


def with_car(
    road: Image, of: Band, lane: int, rear: int, level: float = 170.0, length: int = 23
) -> Image:
    """Paint a car, 4.6 m by 1.8 m unless told otherwise, with its windscreen."""
    out = road.copy()
    middle, half = round(of.lane_rows[lane - 1]), round(0.9 * PX_PER_M)
    out[middle - half : middle + half + 1, max(rear, 0) : rear + length] = level
    glass = rear + round(length * 0.65)
    out[middle - half + 1 : middle + half, max(glass, 0) : max(glass + 4, 0)] = 40.0
    return out


def car_box(of: Band, lane: int, rear: int, length: int = 23) -> tuple[slice, slice]:
    middle, half = round(of.lane_rows[lane - 1]), round(0.9 * PX_PER_M)
    return np.s_[middle - half : middle + half + 1, max(rear, 0) : rear + length]


def no_protection(of: Band) -> Image:
    return np.zeros((of.rows[1], of.columns), np.uint8)


def masks_of(foreign: Image, bright: Image | None = None, shade: Image | None = None) -> Masks:
    shine = foreign if bright is None else bright
    none = np.zeros_like(foreign) if shade is None else shade
    return Masks(foreign, shine, none, foreign.astype(np.float32) / 500)
