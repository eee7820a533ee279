"""Bodies the colour of asphalt, told by their outlines: what they enclose, and their sills."""

from __future__ import annotations

import cv2
import numpy as np

from queuetail.types import Band, Bools, Image
from queuetail.vision.occlusion import LEAST_LEAN_M

CLOSE_M = 0.7  # holes in a vehicle (windscreens the colour of asphalt) up to this length
UNDER_M, BRIDGE_M, UNBROKEN = 2.2, 2.6, 0.9  # across and along: the line of shade under a sill
MARKING_M = (0.7, 2.3)  # from a lane's middle: where the line at its edge may lie
SILL_M, SILL_CLEAR_M, LEAST_SILL_M = (0.7, 1.5), 0.4, 3.5  # a truck's, from its lane's middle
LONGEST_M = 23.5
JOIN_M = 0.5  # breaks in an outline
HOLE_WIDTH_M = 2.2  # across the road: the widest hole that is filled, a vehicle's body
TRUCK_HOLE_M, TRUCK_HOLE_WIDTH_M, TRUCK_HOLE_SHARE = (4.0, 21.0), 4.5, 0.5


def joint_px(px_per_m: float) -> int:
    """Return the odd number of columns over which parts of one vehicle are joined."""
    return 2 * (max(round(CLOSE_M * px_per_m), 1) // 2) + 1


def without_gaps(on: Image, px_per_m: float) -> Image:
    """Join runs of columns (n,) that are `on` over what a windscreen leaves out."""
    kernel = np.ones((1, joint_px(px_per_m)), np.uint8)
    return np.asarray(cv2.morphologyEx(on[None], cv2.MORPH_CLOSE, kernel)[0])


def bridged(on: Image, under: Bools, longest: float) -> Image:
    """Join runs of columns (n,) that are `on` where a dark line goes on from one to the next.

    A body the colour of asphalt shows its windows, and the line of shade along its sill.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], on, [0]])))
    joined = on.copy()
    for end, begin in zip(edges[1:-1:2].tolist(), edges[2::2].tolist(), strict=True):
        shaded = np.count_nonzero(under[end:begin])
        if begin - end <= longest and shaded >= UNBROKEN * (begin - end):
            joined[end:begin] = 1
    return joined


def silled(on: Image, sill: Bools, px_per_m: float) -> Image:
    """Lengthen runs of columns (n,) that are `on` along an unbroken sill, as far as a truck's.

    A trailer the colour of asphalt shows its cab or its rear, and the line of shade along its side.
    """
    joint = joint_px(px_per_m)
    closed = without_gaps(sill.astype(np.uint8), px_per_m)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], closed, [0]])))
    joined = on.copy()
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        begin, end = max(first - joint, 0), last + joint
        before, after = np.flatnonzero(on[begin:first]), np.flatnonzero(on[last:end])
        is_truck = LEAST_SILL_M * px_per_m <= last - first <= LONGEST_M * px_per_m
        if is_truck and (len(before) or len(after)):
            joined[begin + int(before[0]) if len(before) else first : last] = 1
            joined[last : last + int(after[-1]) + 1 if len(after) else last] = 1
    return joined


def under_sill(dark: Image, middle: float, px_per_m: float) -> Bools:
    """Return at which columns something dark lies about a lane's middle: the shade of a sill."""
    half = UNDER_M / 2 * px_per_m
    return _any_between(dark, middle - half, middle + half)


def sill_line(
    dark: Image, bright: Image, filled: Image, band: Band, middle: float, px_per_m: float
) -> Bools:
    """Return at which columns something dark runs along a lane's near side, and nothing beside it.

    The near side is the camera's; from straight above none shows.  What runs beside something
    bright is the edge of a marking.
    """
    lean = float(band.lean_px[:, 1].mean()) / px_per_m
    if abs(lean) < LEAST_LEAN_M:
        return np.zeros(dark.shape[1], np.bool_)
    side = -1 if lean > 0 else 1
    line = _any_between(dark, *(middle + side * reach * px_per_m for reach in SILL_M))
    marking = _any_between(bright, *(middle + side * reach * px_per_m for reach in MARKING_M))
    half = max(SILL_CLEAR_M * px_per_m, 1.0)
    return line & ~_any_between(filled, middle - half, middle + half) & ~marking


def _any_between(mask: Image, one: float, other: float) -> Bools:
    """Return at which columns a mask has anything between two rows, given in either order."""
    first, last = sorted((round(one), round(other)))
    return np.asarray(np.any(mask[max(first, 0) : last + 1], axis=0))


def fill_outlines(foreign: Image, px_per_m: float, lean: float = 0.0) -> tuple[Image, Image]:
    """Fill what an outline encloses, a body the colour of asphalt; -> the whole, what was filled.

    Columns are closed across the road, where the two sides of a car's outline are a car apart; the
    sides of trucks are farther, so what their outline encloses altogether is filled as well.
    `lean` is the row by which what is a metre high is displaced.
    """
    join = 2 * (max(round(JOIN_M * px_per_m), 1) // 2) + 1
    joined = cv2.morphologyEx(foreign, cv2.MORPH_CLOSE, np.ones((join, join), np.uint8))
    across = 2 * (max(round(HOLE_WIDTH_M * px_per_m), 1) // 2) + 1
    closed = cv2.morphologyEx(joined, cv2.MORPH_CLOSE, np.ones((across, 1), np.uint8))
    filled = enclosed(joined, px_per_m, lean)
    return cv2.bitwise_or(closed, filled), filled


def enclosed(outlines: Image, px_per_m: float, lean: float) -> Image:
    """Return (255) the holes in outlines that are as long and as wide as a truck's body.

    Where trucks lean out of the picture, its edge is the fourth side.
    """
    # Half the size shows a truck's body as well; no outline breaks when its pixels spread first.
    small = cv2.dilate(outlines, np.ones((2, 2), np.uint8))[::2, ::2]
    px_per_m /= 2
    edges = int(lean < 0), int(lean > 0)
    framed = cv2.copyMakeBorder(small, *edges, 0, 0, cv2.BORDER_CONSTANT, value=255)
    contours, nesting = cv2.findContours(framed, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
    bodies = np.zeros_like(framed)
    for i, contour in enumerate(contours):
        if nesting[0, i, 3] < 0:
            continue  # the outer edge of an outline, not that of a hole in it
        _, _, width, height = cv2.boundingRect(contour)  # of the outline around the hole
        if not (
            TRUCK_HOLE_M[0] * px_per_m <= width - 2 <= TRUCK_HOLE_M[1] * px_per_m
            and 0.8 * px_per_m <= height - 2 <= TRUCK_HOLE_WIDTH_M * px_per_m
        ):
            continue
        hole = np.zeros_like(framed)
        cv2.drawContours(hole, [contour], 0, 255, cv2.FILLED)
        hole = cv2.bitwise_and(hole, cv2.bitwise_not(framed))
        if cv2.countNonZero(hole) >= TRUCK_HOLE_SHARE * (width - 2) * (height - 2):
            bodies |= hole
    if not bodies.any():
        return np.zeros_like(outlines)
    bodies = bodies[edges[0] : len(bodies) - edges[1]]
    return np.asarray(cv2.resize(bodies, outlines.shape[::-1], interpolation=cv2.INTER_NEAREST))
