"""Cast shadow: one depth for the whole scene, learnt from what is darker than road."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.types import Floats, Image
from queuetail.vision.shade import TOLERANCE, CastShade


def scene(depth: float, bodies: list[float], seed: int = 0) -> tuple[Floats, Image]:
    """Return a road's shares with one shadow of 40 × 40 and bodies of 12 × 20 pixels."""
    share = np.ones((80, 300), np.float32)
    share[20:60, 10:50] = depth
    for i, body in enumerate(bodies):
        share[30:42, 70 + 30 * i : 90 + 30 * i] = body
    share += np.random.default_rng(seed).normal(0, 0.02, share.shape).astype(np.float32)
    return share, ((share < 0.9) * np.uint8(255)).astype(np.uint8)


@settings(max_examples=25, deadline=None)
@given(depth=st.floats(0.3, 0.75), seed=st.integers(0, 99))
def test_the_depth_is_learnt_and_the_shadow_marked(depth: float, seed: int) -> None:
    share, dark = scene(depth, [0.15, 0.25], seed)
    shade = CastShade()
    mask = shade.mask(share, dark)
    assert shade.depth == pytest.approx(depth, abs=0.02)
    assert (mask[22:58, 12:48] > 0).mean() > 0.95
    if depth > 0.25 + 2 * TOLERANCE:
        assert (mask[30:42, 70:120] > 0).mean() < 0.05


def test_bodies_of_all_kinds_are_no_shadow() -> None:
    share, dark = scene(1.0, [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
    shade = CastShade()
    for _ in range(10):
        assert not shade.mask(share, dark).any()
    assert shade.depth is None


def test_an_empty_road_tells_nothing() -> None:
    share, dark = scene(1.0, [])
    shade = CastShade()
    assert not shade.mask(share, dark).any()
    assert shade.depth is None


def test_what_is_not_dark_is_never_marked() -> None:
    share, dark = scene(0.5, [])
    shade = CastShade()
    shade.mask(share, dark)
    assert not shade.mask(share, np.zeros_like(dark)).any()
