"""The vehicles' shapes: each body is a few convex frusta in metres, rear bumper at x = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from queuetail.types import Floats

GLASS = (62, 52, 44)  # BGR
RUBBER = (34, 33, 32)
TRAILER_WHITE = (222, 224, 226)


@dataclass(frozen=True, slots=True)
class Part:
    """A frustum: bottom rectangle x0 … x1, top rectangle inset, and what each face is made of."""

    x0: float
    x1: float
    z0: float
    z1: float
    width: float
    inset_rear: float = 0.0
    inset_front: float = 0.0
    inset_side: float = 0.0
    sides: tuple[int, int, int] | None = None  # BGR; None takes the vehicle's paint
    top: tuple[int, int, int] | None = None
    group: int = 0  # groups stand one behind the other; parts in a group are stacked

    def corners(self) -> Floats:
        """Return the 8 corners: rear left, rear right, front right, front left; bottom first."""
        half, top_half = self.width / 2, self.width / 2 - self.inset_side
        xr, xf = self.x0 + self.inset_rear, self.x1 - self.inset_front
        return np.array(
            [
                (self.x0, half, self.z0),
                (self.x0, -half, self.z0),
                (self.x1, -half, self.z0),
                (self.x1, half, self.z0),
                (xr, top_half, self.z1),
                (xr, -top_half, self.z1),
                (xf, -top_half, self.z1),
                (xf, top_half, self.z1),
            ]
        )


@dataclass(frozen=True, slots=True)
class Body:
    """A kind of vehicle: size, how it drives, and its parts."""

    name: str
    length_m: float
    width_m: float
    height_m: float
    truck: bool
    share: float  # among its own class
    parts: tuple[Part, ...]
    accel_mps2: float = 2.2
    painted: bool = True


def _chassis(length: float, width: float, z1: float = 0.45) -> Part:
    return Part(0.12, length - 0.12, 0.0, z1, width - 0.16, sides=RUBBER, top=RUBBER)


def _car(name: str, length: float, width: float, height: float, share: float, hatch: bool) -> Body:
    waist, deck = 0.62 * height, 0.06 * length if hatch else 0.17 * length
    cabin = Part(
        deck,
        0.74 * length,
        waist,
        height,
        width - 0.08,
        inset_rear=0.05 * length if hatch else 0.13 * length,
        inset_front=0.15 * length,
        inset_side=0.17,
        sides=GLASS,
    )
    shell = Part(0, length, 0.22, waist, width, inset_front=0.05, inset_side=0.04)
    return Body(
        name, length, width, height, False, share, (_chassis(length, width), shell, cabin), 2.4
    )


def _pickup() -> Body:
    length, width, height = 5.7, 2.0, 1.85
    shell = Part(0, length, 0.35, 1.1, width, inset_side=0.03)
    bed = Part(0.12, 2.05, 1.1, 1.11, width - 0.2, sides=RUBBER, top=(48, 47, 46))
    cabin = Part(2.1, 4.25, 1.1, height, width - 0.08, 0.2, 0.65, 0.15, sides=GLASS)
    return Body(
        "pickup", length, width, height, False, 0.2, (_chassis(length, width), shell, bed, cabin)
    )


def _van() -> Body:
    length, width, height = 5.6, 2.0, 2.4
    shell = Part(0, length, 0.3, 1.25, width, inset_front=0.25)
    box = Part(0, 4.5, 1.25, height, width, 0.05, 0.35, 0.08)
    screen = Part(4.05, 5.2, 1.25, 2.05, width - 0.1, 0, 0.75, 0.12, sides=GLASS, top=GLASS)
    return Body(
        "van", length, width, height, False, 0.1, (_chassis(length, width), shell, screen, box)
    )


def _box_truck(length: float, share: float) -> Body:
    width, height = 2.5, 3.5
    cab0 = length - 2.1
    parts = (
        Part(0.1, length, 0, 0.95, width - 0.3, sides=RUBBER, top=RUBBER),
        Part(0, cab0 - 0.15, 0.95, height, width, sides=TRAILER_WHITE, top=(214, 216, 218)),
        Part(cab0, length, 0.45, 1.6, width - 0.15, group=1),
        Part(cab0, length, 1.6, 2.6, width - 0.15, 0, 0.45, 0.1, sides=GLASS, group=1),
    )
    return Body(f"box{length:g}", length, width, height, True, share, parts, 1.3)


def _semi(length: float, share: float, box: tuple[int, int, int]) -> Body:
    width, height = 2.55, 3.9
    cab0 = length - 3.0
    parts = (
        Part(0.3, length - 4.2, 0, 1.05, width - 0.35, sides=RUBBER, top=RUBBER),
        Part(0, cab0 - 0.8, 1.05, height, width, sides=box, top=tuple(int(c * 0.97) for c in box)),  # type: ignore[arg-type]
        Part(length - 5.5, length, 0, 0.9, width - 0.3, sides=RUBBER, top=RUBBER, group=1),
        Part(cab0, length, 0.6, 1.7, width - 0.1, 0, 0.1, 0, group=1),
        Part(cab0, length - 0.2, 1.7, 3.1, width - 0.15, 0, 0.35, 0.12, sides=GLASS, group=1),
    )
    return Body(f"semi{length:g}", length, width, height, True, share, parts, 1.0)


def _bus() -> Body:
    length, width, height = 12.0, 2.55, 3.1
    parts = (
        _chassis(length, width, 0.4),
        Part(0, length, 0.3, 1.3, width),
        Part(0, length, 1.3, 2.5, width, 0.0, 0.1, 0.02, sides=GLASS),
        Part(0.0, length - 0.1, 2.5, height, width - 0.04, 0.1, 0.1, 0.1),
    )
    return Body("bus", length, width, height, True, 0.08, parts, 1.2)


def _tractor() -> Body:
    length, width, height = 4.6, 2.2, 2.8
    parts = (
        Part(0, 1.5, 0, 1.6, 2.2, 0.2, 0.2, sides=RUBBER, top=RUBBER),
        Part(1.5, length, 0.5, 1.45, 0.9, group=1),
        Part(0.5, 2.2, 1.4, height, 1.5, 0.1, 0.2, 0.1, sides=GLASS),
    )
    return Body("tractor", length, width, height, True, 0.0, parts, 0.8)


BODIES: tuple[Body, ...] = (
    _car("hatch", 4.2, 1.78, 1.48, 0.2, True),
    _car("sedan", 4.6, 1.82, 1.45, 0.2, False),
    _car("saloon", 4.95, 1.86, 1.46, 0.15, False),
    _car("suv", 4.7, 1.92, 1.72, 0.2, True),
    _car("suv_long", 5.15, 1.98, 1.8, 0.1, True),
    _pickup(),
    _van(),
    _box_truck(8.0, 0.25),
    _box_truck(10.0, 0.15),
    _semi(16.5, 0.3, (226, 226, 226)),
    _semi(18.0, 0.22, (150, 118, 78)),
    _bus(),
    _tractor(),
)
BODY_INDEX = {body.name: i for i, body in enumerate(BODIES)}

PAINTS: tuple[tuple[int, int, int], ...] = (  # BGR, and how often they are seen on the road
    *(((238, 238, 238),) * 6),
    *(((44, 42, 41),) * 5),
    *(((176, 176, 174),) * 4),
    *(((112, 110, 108),) * 4),
    *(((118, 62, 32),) * 2),
    *(((150, 106, 62),) * 1),
    *(((38, 36, 158),) * 2),
    (72, 96, 58),
    (120, 150, 176),
    (36, 92, 168),
    (40, 160, 200),
)
