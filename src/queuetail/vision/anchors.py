"""Anchors: pictures whose ground features are found again in later pictures, and the plane fit.

Everything here is in pixels of the small working picture, in OpenCV's convention: integers are the
centres of pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from queuetail.types import Bools, Floats, Image

WINDOW = (15, 15)  # pixels of a template
EDGE = 8.0  # pixels from the border that a template needs
GRID = (12, 7)  # buckets across and down, one feature each
CONTRAST = 22.0  # grey levels: the standard deviation that pictures are brought to
MAX_GAIN = 8.0
MEAN_GREY = 128
CORNER_FLOOR = 0.02  # of the median over the buckets' best: weaker corners slide along edges
MAX_MISMATCH = 0.85  # share of a template's own contrast; unrelated patches differ by 1.4
AGREE_PX = 1.0  # a feature that agrees lies this close to where the plane puts it,
AGREE_MOST_PX = 2.0  # or this close where relief and the lens bend the plane for most of them
LEAST_AGREEING = 10
LEAST_SHARE = 0.3
LEAST_COVERAGE = 0.15
MAX_BEND = 0.2  # |J - 1| of the local map: 0.2 is a turn of 11° or a zoom of 1.2
FAULT_RATE = 0.05  # share of each new picture in a feature's record of disagreeing
MAX_FAULT = 0.8
# One standard deviation of noise over that of each parameter of the change from guess to truth, in
# half pictures: only decides what the features leave open, as when they are few or on a line.
STIFFNESS = np.array([0.01, 0.01, 1e-3, 0.01, 0.01, 1e-3, 0.04, 0.04]) ** 2
IDENTITY = np.array([1.0, 0, 0, 0, 1.0, 0, 0, 0])
CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 10, 0.02)


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture without its slow changes of brightness: shadows and exposure leave it alone."""

    image: Image
    detail: float  # grey levels: its contrast before it was brought to CONTRAST


@dataclass(slots=True)
class Anchor:
    """A picture and its features; `faults` is each feature's record of disagreeing, 0 … 1."""

    picture: Picture
    points: Floats  # (n, 2)
    contrast: Floats  # (n,) mean absolute grey level of each template
    H_anchor_ref: Floats
    t_s: float
    faults: Floats  # (n,)
    H_ref_anchor: Floats
    best_share: float = 0.0  # of its features that agreed in the picture it fitted best
    described: tuple[Floats, Image | None] | None = None  # for the search without a guess

    def usable(self) -> Bools:
        """Which features have not disagreed for long: those on vehicles and clouds have."""
        return np.asarray(self.faults < MAX_FAULT)

    def note(self, fit: Fit) -> None:
        """Remember which features agreed."""
        seen = fit.seen
        self.best_share = max(self.best_share, fit.share)
        self.faults[seen] += FAULT_RATE * (~fit.agree[seen] - self.faults[seen])

    def drop(self, keep: Bools) -> None:
        """Keep only some features."""
        self.points, self.contrast = self.points[keep], self.contrast[keep]
        self.faults = self.faults[keep]


@dataclass(frozen=True, slots=True)
class Fit:
    """How an anchor was found in a picture: `H_frame_anchor` maps its pixels to the picture's."""

    H_frame_anchor: Floats
    seen: Bools  # (n,) of the anchor's features
    agree: Bools  # (n,)
    share: float
    coverage: float
    bend: float
    miss_px: float  # how far the guess was off

    @property
    def good(self) -> bool:
        """Whether enough features agree, and not all in one corner."""
        return (
            int(self.agree.sum()) >= LEAST_AGREEING
            and self.share >= LEAST_SHARE
            and self.coverage >= LEAST_COVERAGE
        )

    @property
    def quality(self) -> float:
        """Share of the features that agree times their spread over the picture."""
        return self.share * self.coverage


NOTHING = Fit(np.eye(3), np.zeros(0, bool), np.zeros(0, bool), 0.0, 0.0, np.inf, np.inf)


def normalised(small: Image) -> Picture:
    """Take the slow changes of brightness out of a picture and bring its contrast to CONTRAST.

    A feature's template then has no mean, so that a changed gain cannot pull it aside either.
    """
    height, width = small.shape
    coarse = cv2.blur(halved(halved(small)), (7, 7))
    slow = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    sample = (small[::6, ::6].astype(np.float32) - slow[::6, ::6]).ravel()
    detail = math.sqrt(float(sample @ sample) / len(sample))
    gain = min(CONTRAST / max(detail, 1e-6), MAX_GAIN)
    return Picture(cv2.addWeighted(small, gain, slow, -gain, MEAN_GREY), detail)


def halved(image: Image) -> Image:
    """Return a picture half as wide and high, each pixel the mean of four: fast, not aliased."""
    width, height = image.shape[1] // 2, image.shape[0] // 2
    even = image[: 2 * height, : 2 * width]
    return cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA)


def anchor_at(
    picture: Picture, H_anchor_ref: Floats, t_s: float, blocked: Image | None = None
) -> Anchor:
    """Pick the best corner of every bucket of the picture where `blocked` is 0."""
    image = picture.image
    points = _corners(image, blocked)
    contrast = cv2.blur(cv2.absdiff(image, np.full_like(image, MEAN_GREY)), WINDOW)
    column, row = points[:, 0].astype(int), points[:, 1].astype(int)
    return Anchor(
        picture=picture,
        points=points,
        contrast=contrast[row, column].astype(float),
        H_anchor_ref=H_anchor_ref,
        t_s=t_s,
        faults=np.zeros(len(points)),
        H_ref_anchor=np.asarray(np.linalg.inv(H_anchor_ref)),
    )


def measure(anchor: Anchor, image: Image, guess: Floats, levels: int) -> Fit:
    """Find an anchor's features in a picture, near where `guess` (frame from anchor) puts them.

    Pyramidal Lucas–Kanade (Bouguet 2001) from the anchor, so that nothing drifts; where the guess
    turns or scales the templates too far, the picture is first brought back to the anchor's view.
    """
    height, width = image.shape
    points = anchor.points
    start = moved(guess, points)
    inside = (start > EDGE).all(axis=1) & (start < [width - EDGE, height - EDGE]).all(axis=1)
    seen = inside & anchor.usable()
    nothing = np.zeros(len(points), bool)
    if seen.sum() < LEAST_AGREEING:
        return Fit(guess, seen, nothing, 0.0, 0.0, np.inf, np.inf)
    bend = _bend(guess, points[seen])
    base, target = np.eye(3), image
    start = start[seen]
    if bend > MAX_BEND:
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        target = cv2.warpPerspective(image, guess, (width, height), flags=flags, borderValue=128)
        base, start, guess = guess, points[seen], np.eye(3)
    end, matched = _follow(anchor, seen, target, start, levels)
    D, agree_seen = _fit_plane(start, end, matched, width, height)
    agree = nothing
    agree[seen] = agree_seen
    H = base @ D @ guess
    miss_px = (
        float(_middle(np.abs(end - start)[agree_seen].ravel())) if agree_seen.any() else np.inf
    )
    coverage = _coverage(start[agree_seen], width, height)
    share = float(agree_seen.mean())
    if not _is_sane(D, width, height):
        share = 0.0
    return Fit(H / H[2, 2], seen, agree, share, coverage, bend, miss_px)


def moved(H: Floats, points: Floats) -> Floats:
    """Map points by a homography, (n, 2) -> (n, 2); far away where they lie on its far side."""
    xyw = points @ H[:, :2].T + H[:, 2]
    w = xyw[:, 2:]
    return np.where(w > 0, xyw[:, :2] / np.where(w > 0, w, 1.0), -1e6)


def _corners(image: Image, blocked: Image | None) -> Floats:
    """Return the strongest corner of each bucket (Shi & Tomasi 1994), (n, 2)."""
    height, width = image.shape
    strength = cv2.cornerMinEigenVal(cv2.GaussianBlur(image, (3, 3), 0), 5, ksize=3)
    strength[: int(EDGE) + 2] = strength[-int(EDGE) - 2 :] = 0
    strength[:, : int(EDGE) + 2] = strength[:, -int(EDGE) - 2 :] = 0
    if blocked is not None:
        strength[blocked > 0] = 0
    across, down = GRID
    rows = np.linspace(0, height, down + 1).astype(int)
    columns = np.linspace(0, width, across + 1).astype(int)
    best, where = [], []
    for top, bottom in pairwise(rows):
        for left, right in pairwise(columns):
            _, peak, _, (x, y) = cv2.minMaxLoc(strength[top:bottom, left:right])
            best.append(peak)
            where.append((left + x, top + y))
    value = np.array(best)
    if not (value > 0).any():
        return np.empty((0, 2))
    strong = value > CORNER_FLOOR * np.median(value[value > 0])
    return np.array(where, float)[strong]


def _follow(
    anchor: Anchor, seen: Bools, target: Image, start: Floats, levels: int
) -> tuple[Floats, Bools]:
    points = np.ascontiguousarray(anchor.points[seen], np.float32).reshape(-1, 1, 2)
    end, status, error = cv2.calcOpticalFlowPyrLK(
        anchor.picture.image,
        target,
        points,
        np.ascontiguousarray(start, np.float32).reshape(-1, 1, 2),
        winSize=WINDOW,
        maxLevel=levels,
        criteria=CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    matched = (status[:, 0] > 0) & (error[:, 0] < MAX_MISMATCH * anchor.contrast[seen])
    return end[:, 0].astype(float), matched


def _fit_plane(
    start: Floats, end: Floats, matched: Bools, width: int, height: int
) -> tuple[Floats, Bools]:
    """Fit the homography start -> end that most matched features agree with; and which do."""
    S = np.array([[2 / width, 0, -1], [0, 2 / width, -height / width], [0, 0, 1]])
    agree = np.zeros(len(start), bool)
    if matched.sum() < LEAST_AGREEING:
        return np.eye(3), agree
    a = start[matched] * (2 / width) + [-1, -height / width]
    b = end[matched] * (2 / width) + [-1, -height / width]
    shift = b - a
    off = np.hypot(shift[:, 0] - _middle(shift[:, 0]), shift[:, 1] - _middle(shift[:, 1]))
    px = 2 / width
    h, residual = _reweighted(a, b, off, px)
    if (residual < AGREE_PX * px).mean() < 0.6:
        consensus, chosen = cv2.findHomography(a, b, cv2.USAC_MAGSAC, AGREE_PX * px)
        if consensus is not None and chosen.sum() >= LEAST_AGREEING:
            again, other = _reweighted(a, b, np.where(chosen[:, 0] > 0, 0.0, 1.0), px)
            if (other < AGREE_PX * px).sum() > (residual < AGREE_PX * px).sum():
                h, residual = again, other
    limit = min(max(AGREE_PX * px, 2.5 * _middle(residual)), AGREE_MOST_PX * px)
    agree[matched] = residual < limit
    D = np.linalg.inv(S) @ np.append(h, 1.0).reshape(3, 3) @ S
    return D, agree


def _reweighted(a: Floats, b: Floats, off: Floats, px: float) -> tuple[Floats, Floats]:
    """Least squares with Geman–McClure weights that narrow from round to round."""
    n = len(a)
    A = np.zeros((2 * n, 8))
    A[:n, :2], A[:n, 2], A[n:, 3:5], A[n:, 5] = a, 1, a, 1
    A[:n, 6:], A[n:, 6:] = -a * b[:, :1], -a * b[:, 1:]
    target = b.T.ravel()
    h, residual = IDENTITY, off
    for floor in (1.0, 0.4, 0.3):
        scale = max(2.0 * _middle(residual), floor * px)
        weight = 1 / (1 + (residual / scale) ** 2) ** 2
        weighted = A * np.concatenate([weight, weight])[:, None]
        h = np.linalg.solve(
            weighted.T @ A + np.diag(STIFFNESS), weighted.T @ target + STIFFNESS * IDENTITY
        )
        error = A @ h - target
        residual = np.hypot(error[:n], error[n:])
    return h, residual


def _bend(H: Floats, points: Floats) -> float:
    """Return how far the map's local Jacobian is from 1, where it is worst but for a tenth."""
    xyw = points @ H[:, :2].T + H[:, 2]
    w = xyw[:, 2]
    uv = xyw[:, :2] / w[:, None]
    J = (H[None, :2, :2] - uv[:, :, None] * H[None, 2:, :2]) / w[:, None, None]
    off = np.abs(J - np.eye(2)).max(axis=(1, 2))
    return float(np.partition(off, int(0.9 * (len(off) - 1)))[int(0.9 * (len(off) - 1))])


def _coverage(points: Floats, width: int, height: int) -> float:
    """Return the spread of points over that of an evenly covered picture, 0 … 1."""
    if len(points) < LEAST_AGREEING:
        return 0.0
    centred = points - points.mean(axis=0)
    (xx, xy), (_, yy) = centred.T @ centred / len(points)
    evenly = (width * height / 12.0) ** 2
    return float(min(max((xx * yy - xy * xy) / evenly, 0.0) ** 0.25, 1.0))


def _is_sane(D: Floats, width: int, height: int) -> bool:
    """Whether a correction keeps the picture's corners in front, in order and of like size."""
    corners = np.array([[0.0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]])
    xyw = corners @ D.T
    if xyw[:, 2].min() <= 0.2:
        return False
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = (xyw[:, :2] / xyw[:, 2:]).tolist()
    area = 0.5 * ((cx - ax) * (dy - by) - (cy - ay) * (dx - bx))
    return 0.4 < area / (width * height) < 2.5


def _middle(values: Floats) -> float:
    """Return the upper median: np.median takes longer than the fit that needs it."""
    half = len(values) // 2
    return float(np.partition(values, half)[half])
