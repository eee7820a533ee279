"""Registration against pictures warped by known homographies."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from queuetail.types import Floats, Image
from queuetail.vision.anchors import moved
from queuetail.vision.register import GroundRegistration

SIZE = (1280, 720)
CORNERS = np.array([[0.0, 0], [SIZE[0], 0], [SIZE[0], SIZE[1]], [0, SIZE[1]]])


def textured(width: int, height: int, seed: int) -> Image:
    """Draw ground: noise of several sizes, as grass, bushes and marks are."""
    rng = np.random.default_rng(seed)
    ground = np.full((height, width), 110.0, np.float32)
    for cell, depth in ((3, 7), (8, 10), (24, 14), (90, 18)):
        noise = rng.normal(0, depth, (height // cell + 2, width // cell + 2)).astype(np.float32)
        ground += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(ground, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def ground() -> Image:
    """A picture of the ground, larger than the frame."""
    return textured(4000, 3000, 3)


def motion(
    dx_px: float = 0, dy_px: float = 0, turn_deg: float = 0, zoom: float = 1, tilt: float = 0
) -> Floats:
    """Return H_ground_frame: a camera that moved, turned about its picture's centre and tilted."""
    angle = np.radians(turn_deg)
    c, s = np.cos(angle) / zoom, np.sin(angle) / zoom
    centred = np.array([[1, 0, -SIZE[0] / 2], [0, 1, -SIZE[1] / 2], [0, 0, 1.0]])
    tilted = np.array([[1, 0, 0], [0, 1, 0], [tilt * 1e-4, -tilt * 2e-4, 1.0]])
    turned = np.array([[c, -s, 2000 + dx_px], [s, c, 1500 + dy_px], [0, 0, 1.0]])
    return np.asarray(turned @ tilted @ centred)


def seen(ground: Image, H_ground_frame: Floats) -> Image:
    """Take the frame's picture; (0, 0) is the outer corner of a pixel, 0.5 its centre."""
    half = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])
    H = np.linalg.inv(half) @ H_ground_frame @ half
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return cv2.warpPerspective(ground, H, SIZE, flags=flags, borderMode=cv2.BORDER_REFLECT)


def corner_error_px(H_ref_frame: Floats, H_ground_ref: Floats, H_ground_frame: Floats) -> float:
    truth = moved(np.linalg.inv(H_ground_ref) @ H_ground_frame, CORNERS)
    return float(np.linalg.norm(moved(H_ref_frame, CORNERS) - truth, axis=1).max())


def test_the_same_picture_is_the_identity(ground: Image) -> None:
    registration = GroundRegistration(*SIZE)
    picture = seen(ground, motion())
    for i in range(3):
        answer = registration.register(picture, i / 30)
        assert answer.quality > 0.8
        assert np.allclose(answer.H_ref_frame, np.eye(3), atol=1e-3)


def test_hover_jitter_is_measured_to_a_fraction_of_a_pixel(ground: Image) -> None:
    registration = GroundRegistration(*SIZE)
    errors = []
    for i in range(40):
        t = i / 30
        H = motion(
            14 * np.sin(5 * t), 11 * np.sin(7 * t), np.sin(4 * t), 1 + 0.02 * t, np.sin(3 * t)
        )
        answer = registration.register(seen(ground, H), t)
        assert answer.quality > 0.5
        errors.append(corner_error_px(answer.H_ref_frame, motion(), H))
    assert np.median(errors) < 0.3
    assert max(errors) < 1.0
