"""Registration against pictures warped by known homographies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.telemetry import read_telemetry
from queuetail.types import CameraPose, Floats, Image, Origin, Registration, TelemetrySample
from queuetail.video import VideoFile
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


def flown(
    registration: GroundRegistration,
    ground: Image,
    path: list[tuple[float, Floats]],
    spoil: Callable[[float, Image], Image] = lambda t_s, picture: picture,
) -> list[tuple[float, Registration, float]]:
    """Register a flight's pictures: (t_s, answer, corner error relative to the first)."""
    answers = []
    for t_s, H in path:
        answer = registration.register(spoil(t_s, seen(ground, H)), t_s)
        error_px = np.inf
        if answer.quality > 0:
            error_px = corner_error_px(answer.H_ref_frame, path[0][1], H)
        answers.append((t_s, answer, error_px))
    return answers


def hover(seconds: float, rate_hz: float = 15) -> list[tuple[float, Floats]]:
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    return [(t, motion(8 * np.sin(2 * t), 6 * np.sin(3 * t), 0.4 * np.sin(t))) for t in times]


def test_a_long_drift_is_chained_over_anchors_and_leaves_nothing_when_it_returns(
    ground: Image,
) -> None:
    registration = GroundRegistration(*SIZE)
    out = np.concatenate([np.linspace(0, 1, 60), np.linspace(1, 0, 60), np.zeros(30)])
    path = [(i / 15, motion(-1200 + 2300 * s, -900 + 1500 * s)) for i, s in enumerate(out)]
    answers = flown(registration, ground, path)
    assert all(a.quality > 0 and a.epoch == 0 for _, a, _ in answers)
    assert max(error for _, _, error in answers) < 4.0
    assert max(error for _, _, error in answers[-15:]) < 0.3


@pytest.mark.parametrize("telemetry", [False, True])
def test_a_yaw_correction_of_40_degrees_in_3_seconds_keeps_the_chain(
    ground: Image, telemetry: bool
) -> None:
    registration = GroundRegistration(*SIZE)
    errors = []
    for i in range(75):
        t = i / 15
        H = motion(turn_deg=40 * float(np.clip((t - 1) / 3, 0, 1)))
        guess = np.linalg.inv(motion()) @ H if telemetry else None
        answer = registration.register(seen(ground, H), t, predicted=lambda guess=guess: guess)
        assert answer.epoch == 0
        assert answer.quality > 0
        errors.append(corner_error_px(answer.H_ref_frame, motion(), H))
    assert np.median(errors) < 0.5
    assert max(errors) < 2.0


def test_a_zoom_of_1_3_keeps_the_chain(ground: Image) -> None:
    path = [(i / 15, motion(zoom=1 + 0.3 * min(i / 30, 1))) for i in range(45)]
    answers = flown(GroundRegistration(*SIZE), ground, path)
    assert all(a.quality > 0 and a.epoch == 0 for _, a, _ in answers)
    assert max(error for _, _, error in answers) < 1.5


@pytest.mark.parametrize(
    ("name", "reason"),
    [("blurred", "blurred"), ("covered", "no detail"), ("noise", "too few features agree")],
)
def test_a_spoilt_second_is_lost_and_then_the_same_epoch_again(
    ground: Image, name: str, reason: str
) -> None:
    rng = np.random.default_rng(5)

    def spoil(t_s: float, picture: Image) -> Image:
        if not 1.0 <= t_s < 2.0:
            return picture
        if name == "blurred":
            return cv2.GaussianBlur(picture, (0, 0), 25)
        if name == "covered":
            return np.full_like(picture, 90)
        coarse = rng.integers(40, 200, (90, 160)).astype(np.uint8)
        return cv2.resize(coarse, SIZE, interpolation=cv2.INTER_LINEAR)

    answers = flown(GroundRegistration(*SIZE), ground, hover(4.0), spoil)
    for t_s, answer, error_px in answers:
        assert answer.epoch == 0
        if 1.0 <= t_s < 2.0:
            assert answer.quality == 0
            assert reason in answer.reason
        else:
            assert error_px < 1.0, t_s


def test_a_cut_begins_a_new_epoch_within_a_second(ground: Image) -> None:
    other = textured(4000, 3000, 17)
    registration = GroundRegistration(*SIZE)
    flown(registration, ground, hover(1.0))
    answers = []
    for t_s, H in hover(2.0):
        answers.append((t_s, registration.register(seen(other, H), 1.0 + t_s)))
    assert answers[0][1].quality == 0
    assert answers[0][1].reason
    begun = [t_s for t_s, a in answers if a.quality > 0]
    assert begun[0] < 1.0
    assert {a.epoch for t_s, a in answers if t_s >= begun[0]} == {1}
    assert min(a.quality for t_s, a in answers if t_s >= begun[0]) > 0.5


def test_exposure_steps_and_shadow_edges_do_not_pull(ground: Image) -> None:
    def spoil(t_s: float, picture: Image) -> Image:
        light = np.ones((1, SIZE[0]), np.float32)
        light[:, int(300 * t_s) :] = 0.55
        gain = 1.4 if t_s > 1 else 1.0
        return np.clip(picture * light * gain, 0, 255).astype(np.uint8)

    answers = flown(GroundRegistration(*SIZE), ground, hover(3.0), spoil)
    errors = [error for _, _, error in answers]
    assert np.median(errors) < 0.3
    assert max(errors) < 1.0


@pytest.mark.parametrize("road_known", [False, True])
def test_traffic_does_not_carry_the_ground_along(ground: Image, road_known: bool) -> None:
    rng = np.random.default_rng(1)
    cars = [(rng.uniform(0, 1280), 250 + 40 * (i % 5), rng.uniform(60, 200)) for i in range(45)]
    road = np.array([[0.0, 240], [1280, 240], [1280, 470], [0, 470]])
    registration = GroundRegistration(*SIZE)
    errors = []
    for t_s, H in hover(4.0):
        picture = seen(ground, H)
        for x, y, speed in cars:
            left = int(x + speed * t_s) % 1240
            cv2.rectangle(picture, (left, y), (left + 36, y + 22), 235, -1)
            cv2.rectangle(picture, (left + 8, y + 3), (left + 16, y + 19), 30, -1)
        answer = registration.register(picture, t_s, road if road_known else None)
        assert answer.quality > 0.3
        errors.append(corner_error_px(answer.H_ref_frame, motion(), H))
    assert np.median(errors) < 0.3
    assert max(errors) < 1.0


def test_a_picture_without_detail_is_never_the_reference(ground: Image) -> None:
    registration = GroundRegistration(*SIZE)
    answer = registration.register(np.full((720, 1280), 128, np.uint8), 0.0)
    assert answer.quality == 0
    assert answer.reason == "the picture shows too little detail"
    assert registration.register(seen(ground, motion()), 0.1).quality > 0.8


@pytest.mark.parametrize("size", [(1, 1), (31, 400), (40, 30)])
def test_a_tiny_picture_is_lost_with_a_reason(size: tuple[int, int]) -> None:
    answer = GroundRegistration(*size).register(textured(*size, 1), 0.0)
    assert answer.quality == 0
    assert answer.reason == "the picture is too small"


def test_a_picture_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="640×360 came where 1280×720"):
        GroundRegistration(*SIZE).register(np.zeros((360, 640), np.uint8), 0.0)


def test_the_bundled_flight_agrees_with_its_exact_telemetry(flagger: Path) -> None:
    log = read_telemetry(flagger / "telemetry.csv")
    first = log.at(0.0)
    assert first.lat_deg is not None
    assert first.lon_deg is not None
    origin = Origin(first.lat_deg, first.lon_deg)
    points = np.array([[0.2, 0.3], [0.8, 0.3], [0.5, 0.55], [0.2, 0.85], [0.8, 0.85]]) * SIZE
    registration = GroundRegistration(*SIZE)
    reference = None
    off_m = []
    video = VideoFile(flagger / "flight.mp4")
    for frame in video.frames():
        if frame.t_s > 6:
            break
        answer = registration.register(frame.luma, frame.t_s)
        mapping = mapping_from_pose(pose_from(log.at(frame.t_s)), origin)
        reference = reference or mapping
        told = px_to_enu(mapping, points)
        measured = px_to_enu(reference, moved(answer.H_ref_frame, points))
        off_m.append(np.linalg.norm(told - measured, axis=1))
    video.close()
    assert np.median(off_m) < 0.1
    assert np.max(off_m) < 0.4


def pose_from(said: TelemetrySample) -> CameraPose:
    return CameraPose(
        lat_deg=said.lat_deg or 0.0,
        lon_deg=said.lon_deg or 0.0,
        height_agl_m=said.height_agl_m or 0.0,
        yaw_deg=said.heading_deg or 0.0,
        pitch_deg=said.gimbal_pitch_deg or 0.0,
        roll_deg=said.gimbal_roll_deg or 0.0,
        intrinsics=intrinsics_from_hfov(*SIZE, said.hfov_deg or 0.0),
    )
