"""Hypothesis strategies for cameras above level ground."""

from __future__ import annotations

import dataclasses

from hypothesis import strategies as st

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.types import CameraPose, Intrinsics, Origin

ORIGIN = Origin(36.11, -97.057)

SIZES = [(640, 360), (1280, 720), (3840, 2160), (4000, 3000)]


@st.composite
def lenses(draw: st.DrawFn, distorted: bool | None = None) -> Intrinsics:
    """Return lenses of a phone to a cinema camera, 20° to 100° wide.

    With distortion as consumer drones have it before their own correction: at the picture's corner
    a barrel of up to 12 % or a pincushion of up to 15 %, and a little of it tangential.
    """
    width_px, height_px = draw(st.sampled_from(SIZES))
    lens = intrinsics_from_hfov(width_px, height_px, draw(st.floats(20.0, 100.0)))
    if not (draw(st.booleans()) if distorted is None else distorted):
        return lens
    corner2 = (width_px**2 + height_px**2) / 4 / lens.fx_px**2
    k1 = draw(st.floats(-0.12, 0.15)) / corner2
    k2 = draw(st.floats(0.0, 0.05)) / corner2**2
    p1, p2 = draw(st.floats(-0.002, 0.002)), draw(st.floats(-0.002, 0.002))
    k3 = draw(st.sampled_from([(), (0.01 / corner2**3,)]))
    return dataclasses.replace(lens, distortion=(k1, k2, p1, p2, *k3))


def poses(
    lens: st.SearchStrategy[Intrinsics] | None = None,
    roll_deg: st.SearchStrategy[float] | None = None,
    pitch_deg: st.SearchStrategy[float] | None = None,
) -> st.SearchStrategy[CameraPose]:
    """Return poses over the whole range of every angle, 5 m to 500 m high."""
    return st.builds(
        CameraPose,
        st.floats(36.0, 36.2),
        st.floats(-97.1, -97.0),
        st.floats(5.0, 500.0),
        st.floats(-180.0, 360.0),
        pitch_deg if pitch_deg is not None else st.floats(-90.0, 30.0),
        roll_deg if roll_deg is not None else st.floats(-180.0, 180.0),
        lens if lens is not None else lenses(),
    )


def pixel_grid(lens: Intrinsics, steps: int = 7) -> list[tuple[float, float]]:
    """Return pixels all over the picture, its corners among them."""
    across = [lens.width_px * k / (steps - 1) for k in range(steps)]
    down = [lens.height_px * k / (steps - 1) for k in range(steps)]
    return [(u, v) for u in across for v in down]
