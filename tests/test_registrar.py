"""The registrars: none, and that of the ground with telemetry's word as the prior."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from queuetail.config import CameraOverride
from queuetail.geo.ground import apply_homography
from queuetail.mapping import TelemetryMapper
from queuetail.registrar import FrameRegistrar, NoRegistration
from queuetail.types import Floats, Frame, Image, Origin, TelemetrySample

SIZE = (640, 360)
ORIGIN = Origin(36.11, -97.057)
CORNERS = np.array([[0.0, 0.0], [640, 0], [640, 360], [0, 360]])


def ground(seed: int = 0) -> Image:
    """Return a textured ground larger than the picture."""
    rng = np.random.default_rng(seed)
    coarse = cv2.resize(rng.normal(0, 40, (60, 100)), (1000, 600), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(0, 60, (600, 1000)), (0, 0), 1.5)
    return np.clip(120 + coarse + fine, 1, 255).astype(np.uint8)


def shot(of: Image, right: int, down: int, t_s: float) -> Frame:
    luma = of[100 + down : 460 + down, 150 + right : 790 + right].copy()
    return Frame(0, t_s, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))


def said(t_s: float, **changed: float) -> TelemetrySample:
    fields: dict[str, float] = {
        "lat_deg": 36.11,
        "lon_deg": -97.057,
        "height_agl_m": 100.0,
        "heading_deg": 0.0,
        "gimbal_pitch_deg": -90.0,
        "gimbal_roll_deg": 0.0,
        "hfov_deg": 84.0,
        **changed,
    }
    return TelemetrySample(t_s, **fields)


def registrar(with_telemetry: bool = True) -> FrameRegistrar:
    mapper = TelemetryMapper(*SIZE, CameraOverride(), ORIGIN)
    return FrameRegistrar(*SIZE, mapper if with_telemetry else None)


def moved_px(H_ref_frame: Floats) -> Floats:
    return apply_homography(H_ref_frame, CORNERS) - CORNERS


def test_no_registration_is_the_identity_and_sure() -> None:
    found = NoRegistration().register(shot(ground(), 0, 0, 0.0), said(0.0))
    assert np.array_equal(found.H_ref_frame, np.eye(3))
    assert found.quality == 1.0
    assert found.reason == ""


@pytest.mark.parametrize("with_telemetry", [True, False])
def test_motion_is_measured_with_and_without_a_prior(with_telemetry: bool) -> None:
    picture, parts = ground(), registrar(with_telemetry)
    for n in range(8):
        found = parts.register(shot(picture, 3 * n, -2 * n, n / 10), said(n / 10))
        assert found.reason == ""
    assert moved_px(found.H_ref_frame) == pytest.approx(np.tile([21.0, -14.0], (4, 1)), abs=0.3)
    assert found.quality > 0.5
    assert found.epoch == 0


def test_a_wrong_prior_does_no_harm() -> None:
    picture, parts = ground(), registrar()
    parts.register(shot(picture, 0, 0, 0.0), said(0.0))
    found = parts.register(shot(picture, 4, 4, 0.1), said(0.1, heading_deg=25.0))
    assert found.reason == ""
    assert moved_px(found.H_ref_frame) == pytest.approx(np.full((4, 2), 4.0), abs=0.4)


def test_silent_telemetry_does_no_harm() -> None:
    picture, parts = ground(), registrar()
    for n in range(4):
        found = parts.register(shot(picture, n, 0, n / 10), TelemetrySample(n / 10))
        assert found.reason == ""


def test_a_black_picture_is_lost_and_the_next_good_one_is_found_again() -> None:
    picture, parts = ground(), registrar()
    parts.register(shot(picture, 0, 0, 0.0), said(0.0))
    black = Frame(
        0, 0.1, np.zeros((360, 640), np.uint8), lambda w, h: np.zeros((h, w, 3), np.uint8)
    )
    lost = parts.register(black, said(0.1))
    assert lost.reason
    assert lost.quality == 0.0
    found = [parts.register(shot(picture, 5, 0, 0.2 + n / 10), said(0.2)) for n in range(10)]
    assert found[-1].reason == ""
    assert found[-1].epoch == lost.epoch == 0
    assert moved_px(found[-1].H_ref_frame)[:, 0] == pytest.approx(np.full(4, 5.0), abs=0.4)


def test_another_scene_begins_another_epoch_and_never_reuses_the_old_one() -> None:
    parts = registrar()
    parts.register(shot(ground(0), 0, 0, 0.0), said(0.0))
    found = [parts.register(shot(ground(7), 0, 0, 0.1 + n / 10), said(0.1)) for n in range(20)]
    assert found[0].reason
    assert found[-1].reason == ""
    assert found[-1].epoch == 1
    assert moved_px(found[-1].H_ref_frame) == pytest.approx(np.zeros((4, 2)), abs=0.4)
