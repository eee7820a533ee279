"""Registration: the image motion of a hovering drone, measured on the ground beside the road.

Features of an anchor picture are found again in every later picture (never from picture to picture,
so that nothing drifts); a robust plane homography through them gives the motion.  When an anchor
runs out of view, or is seen turned or scaled too far, the present picture becomes the next anchor
of the same chain: homographies of one plane compose.  The first anchors are taken up again as soon
as they are in view again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import cv2
import numpy as np

from queuetail.types import Floats, Image, Registration
from queuetail.vision.anchors import (
    EDGE,
    LEAST_AGREEING,
    MAX_BEND,
    NOTHING,
    Anchor,
    Fit,
    Picture,
    anchor_at,
    halved,
    measure,
    moved,
    normalised,
)

WORKING_WIDTH_PX = 640  # narrower pictures stay as they are
LEAST_SIDE_PX = 32
LEAST_FEATURES = 24  # an anchor has at least this many
IN_VIEW_SHARE = 0.55  # of its features; below it, the next anchor is taken
RETURN_SHARE = 0.7
AGED = 0.65  # of its best share: relief seen from elsewhere, shadows that went on
AGED_AFTER_S = 1.0
MAX_ANCHORS = 12
HOUSEKEEPING_EVERY_S = 0.5  # looks for a better anchor
SEARCH_EVERY_S = 0.15  # searches without a guess, while lost
NEW_SCENE_AFTER_S = 0.5  # that a picture which fits no anchor must have held still
BLURRED_SHARE = 0.6  # of the anchor's contrast in fine detail
NO_DETAIL = 1.5  # grey levels
SAME_GUESS_PX = 3.0
CLOSE_PX = 1.5  # guesses that were this close need no pyramid
ORB_FEATURES = 600


Told = Callable[[], Floats | None]  # what telemetry says of a motion, when it is asked


def nothing_told() -> None:
    """Say nothing of the motion."""


class GroundRegistration:
    """Measures the motion of one video's pictures, `width_px` × `height_px`."""

    def __init__(self, width_px: int, height_px: int) -> None:
        self._size = (width_px, height_px)
        self._halvings = 0
        while width_px >> (self._halvings + 1) >= WORKING_WIDTH_PX:
            self._halvings += 1
        width, height = width_px >> self._halvings, height_px >> self._halvings
        self._working = (width, height)
        if width > WORKING_WIDTH_PX:
            self._working = (WORKING_WIDTH_PX, max(round(height * WORKING_WIDTH_PX / width), 1))
        across = (width << self._halvings) / self._working[0]
        down = (height << self._halvings) / self._working[1]
        self._H_px_small = np.array([[across, 0, across / 2], [0, down, down / 2], [0, 0, 1.0]])
        self._H_small_px = np.linalg.inv(self._H_px_small)
        self._epoch = 0
        self._anchors: list[Anchor] = []
        self._current = 0
        self._track: list[tuple[float, Floats]] = []  # the last two (t_s, H_frame_ref)
        self._told: Told = nothing_told  # H_frame_ref of telemetry at the last good picture
        self._miss_px = np.inf
        self._housekept_s = -np.inf
        self._searched_s = -np.inf
        self._candidate: Anchor | None = None
        self._candidate_H = np.eye(3)

    def register(
        self,
        luma: Image,
        t_s: float,
        moving_px: Floats | None = None,
        predicted: Told = nothing_told,
    ) -> Registration:
        """Return the motion of a picture taken at `t_s` seconds; quality 0 when it is lost.

        `moving_px` is the road, one polygon (n, 2) or several (k, n, 2) in this picture's pixels,
        where features would ride on vehicles; `predicted` gives telemetry's H_ref_frame, a guess
        that is asked for only where the motion so far gives none that fits.
        Raises ValueError for a picture of another size.
        """
        if (luma.shape[1], luma.shape[0]) != self._size:
            raise ValueError(
                f"a picture of {luma.shape[1]}×{luma.shape[0]} came where "
                f"{self._size[0]}×{self._size[1]} were announced"
            )
        if min(self._working) < LEAST_SIDE_PX:
            return Registration(np.eye(3), 0.0, "the picture is too small", self._epoch)
        picture = normalised(self._small(luma))
        if not self._anchors:
            return self._start(picture, t_s, moving_px)
        told = cache(lambda: self._small_frame_ref(predicted()))
        fit = self._found(picture, t_s, told)
        if not fit.good:
            return self._lost(picture, t_s, moving_px, fit)
        anchor = self._anchors[self._current]
        anchor.note(fit)
        self._candidate = None
        self._miss_px = fit.miss_px
        H_frame_ref = fit.H_frame_anchor @ anchor.H_anchor_ref
        H_frame_ref /= H_frame_ref[2, 2]
        self._track = [*self._track[-1:], (t_s, H_frame_ref)]
        self._told = told
        self._keep_house(picture, t_s, moving_px, fit)
        return self._answer(H_frame_ref, fit.quality)

    def _small(self, luma: Image) -> Image:
        """Halve the picture while it stays wide enough, then scale what is left of the way."""
        small = luma
        for _ in range(self._halvings):
            small = halved(small)
        if (small.shape[1], small.shape[0]) == self._working:
            return small
        return cv2.resize(small, self._working, interpolation=cv2.INTER_LINEAR)

    def _small_frame_ref(self, H_ref_frame: Floats | None) -> Floats | None:
        if H_ref_frame is None:
            return None
        H = self._H_small_px @ H_ref_frame @ self._H_px_small
        if not np.isfinite(H).all() or abs(np.linalg.det(H)) < 1e-12:
            return None
        inverse = np.linalg.inv(H)
        return inverse / inverse[2, 2]

    def _answer(self, H_frame_ref: Floats, quality: float) -> Registration:
        H = self._H_px_small @ np.linalg.inv(H_frame_ref) @ self._H_small_px
        return Registration(H / H[2, 2], quality, epoch=self._epoch)

    def _start(self, picture: Picture, t_s: float, moving_px: Floats | None) -> Registration:
        """Make this picture the reference, when it has features enough."""
        anchor = self._anchor(picture, np.eye(3), t_s, moving_px)
        if len(anchor.points) < LEAST_FEATURES:
            return Registration(np.eye(3), 0.0, "the picture shows too little detail", self._epoch)
        return self._restart(anchor, t_s)

    def _restart(self, anchor: Anchor, t_s: float) -> Registration:
        anchor.H_anchor_ref = anchor.H_ref_anchor = np.eye(3)
        self._anchors, self._current = [anchor], 0
        self._track = [(t_s, np.eye(3))]
        self._told, self._candidate = nothing_told, None
        self._miss_px = np.inf
        return Registration(np.eye(3), 1.0, epoch=self._epoch)

    def _anchor(
        self, picture: Picture, H_anchor_ref: Floats, t_s: float, moving_px: Floats | None
    ) -> Anchor:
        """Pick features beside the road, or all over where too few are beside it."""
        blocked = self._blocked(moving_px)
        anchor = anchor_at(picture, H_anchor_ref, t_s, blocked)
        if blocked is not None and len(anchor.points) < LEAST_FEATURES:
            anchor = anchor_at(picture, H_anchor_ref, t_s)
        return anchor

    def _blocked(self, moving_px: Floats | None) -> Image | None:
        if moving_px is None or moving_px.size == 0:
            return None
        width, height = self._working
        mask = np.zeros((height, width), np.uint8)
        for polygon in moving_px if moving_px.ndim == 3 else moving_px[None]:
            corners = np.clip(moved(self._H_small_px, polygon), -1e4, 1e4)
            cv2.fillPoly(mask, [np.rint(corners).astype(np.int32)], 255)
        return mask

    def _found(self, picture: Picture, t_s: float, told: Told) -> Fit:
        """Find the present anchor near the likeliest guess, then the others, then anywhere."""
        anchor = self._anchors[self._current]
        best = NOTHING
        lost = self._candidate is not None
        for rank, guess in enumerate(self._guesses(t_s, told)):
            levels = 3 if rank or lost or self._miss_px > 3 * CLOSE_PX else 1
            levels = 0 if not rank and not lost and self._miss_px < CLOSE_PX else levels
            fit = measure(anchor, picture.image, guess @ anchor.H_ref_anchor, levels)
            if not fit.good and levels < 3:
                fit = measure(anchor, picture.image, guess @ anchor.H_ref_anchor, 3)
            if fit.good:
                return fit
            best = fit if fit.agree.sum() > best.agree.sum() else best
        if t_s - self._searched_s >= SEARCH_EVERY_S:
            self._searched_s = t_s
            found = self._search(picture)
            if found is not None:
                return found
        return best

    def _guesses(self, t_s: float, told: Told) -> Iterator[Floats]:
        """Yield where the reference may be, the likeliest first, none of them twice."""
        last = self._track[-1][1]
        tried: list[Floats] = []
        for guess in self._all_guesses(t_s, told):
            if not tried or self._differs(guess, tried, last):
                tried.append(guess)
                yield guess / guess[2, 2]

    def _all_guesses(self, t_s: float, told: Told) -> Iterator[Floats]:
        """Motion goes on, or is as telemetry says, or it stopped."""
        last_t_s, last = self._track[-1]
        if len(self._track) == 2:
            before_t_s, before = self._track[0]
            step_s, was_s = t_s - last_t_s, last_t_s - before_t_s
            if was_s > 0 and 0 < step_s < 2 * was_s:
                yield last @ _inverse(before) @ last
        now, then = told(), self._told()
        if now is not None and then is not None:
            yield now @ _inverse(then) @ last
        yield last
        if now is not None:
            yield now

    def _differs(self, guess: Floats, tried: list[Floats], last: Floats) -> bool:
        """Whether a guess puts a corner of the last picture far from where the others do."""
        width, height = self._working
        corners = np.array([[0.0, 0], [width, 0], [width, height], [0, height]])
        on_ground = moved(_inverse(last), corners)
        here = moved(guess, on_ground)
        off = [np.abs(here - moved(other, on_ground)).max() for other in tried]
        return bool(min(off) > SAME_GUESS_PX)

    def _search(self, picture: Picture) -> Fit | None:
        """Match described features of the whole picture against the anchors (ORB, Rublee 2011)."""
        if picture.detail < NO_DETAIL:
            return None
        orb = cv2.ORB.create(ORB_FEATURES, fastThreshold=8)
        here = _described(orb, picture.image)
        order = dict.fromkeys([self._current, 0, *range(len(self._anchors) - 1, -1, -1)])
        for index in list(order)[:4]:
            anchor = self._anchors[index]
            if anchor.described is None:
                anchor.described = _described(orb, anchor.picture.image)
            guess = _matched(anchor.described, here)
            if guess is None:
                continue
            fit = measure(anchor, picture.image, guess, 2)
            if fit.good:
                self._current = index
                return fit
        return None

    def _lost(
        self, picture: Picture, t_s: float, moving_px: Floats | None, fit: Fit
    ) -> Registration:
        """Say why, and begin anew on a picture that fits nothing known but holds still."""
        anchor = self._anchors[self._current]
        if picture.detail < NO_DETAIL:
            reason = "the picture shows no detail"
        elif picture.detail < BLURRED_SHARE * anchor.picture.detail:
            reason = "the picture is blurred"
        else:
            reason = f"too few features agree ({fit.agree.sum()} of {max(fit.seen.sum(), 0)})"
            candidate = self._candidate
            if candidate is not None:
                still = measure(candidate, picture.image, self._candidate_H, 3)
                if still.good and t_s - candidate.t_s >= NEW_SCENE_AFTER_S:
                    self._epoch += 1
                    return self._restart(self._anchor(picture, np.eye(3), t_s, moving_px), t_s)
                if still.good:
                    self._candidate_H = still.H_frame_anchor
                    reason = "the scene changed"
                else:
                    candidate = None
            if candidate is None:
                fresh = self._anchor(picture, np.eye(3), t_s, moving_px)
                self._candidate = fresh if len(fresh.points) >= LEAST_FEATURES else None
                self._candidate_H = np.eye(3)
            return Registration(np.eye(3), 0.0, reason, self._epoch)
        self._candidate = None
        return Registration(np.eye(3), 0.0, reason, self._epoch)

    def _keep_house(self, picture: Picture, t_s: float, moving_px: Floats | None, fit: Fit) -> None:
        """Return to an earlier anchor where one is in view, or take the next one in time."""
        if t_s - self._housekept_s < HOUSEKEEPING_EVERY_S:
            return
        self._housekept_s = t_s
        anchor = self._anchors[self._current]
        H_frame_ref = self._track[-1][1]
        usable = int((fit.seen & anchor.usable()).sum())
        if moving_px is not None and self._clear_road(anchor, fit.H_frame_anchor, moving_px):
            return
        for index in range(self._current):
            if self._is_back(self._anchors[index], picture, H_frame_ref):
                self._current = index
                return
        worn = usable < max(IN_VIEW_SHARE * len(anchor.points), LEAST_FEATURES)
        aged = fit.share < AGED * anchor.best_share and t_s - anchor.t_s >= AGED_AFTER_S
        if aged or ((worn or fit.bend > MAX_BEND) and fit.share > 0.5):
            fresh = self._anchor(picture, H_frame_ref, t_s, moving_px)
            if len(fresh.points) >= max(LEAST_FEATURES, usable // 2):
                self._anchors.append(fresh)
                if len(self._anchors) > MAX_ANCHORS:
                    del self._anchors[1]
                self._current = len(self._anchors) - 1

    def _is_back(self, anchor: Anchor, picture: Picture, H_frame_ref: Floats) -> bool:
        """Whether an anchor is in view, not bent, and found where it is expected."""
        width, height = self._working
        guess = H_frame_ref @ anchor.H_ref_anchor
        at = moved(guess, anchor.points)
        inside = (at > EDGE).all(axis=1) & (at < [width - EDGE, height - EDGE]).all(axis=1)
        usable = anchor.usable()
        if (inside & usable).sum() < max(RETURN_SHARE * len(usable), LEAST_FEATURES):
            return False
        fit = measure(anchor, picture.image, guess, 1)
        return fit.good and fit.share > 0.5 and fit.bend < 0.75 * MAX_BEND

    def _clear_road(self, anchor: Anchor, H_frame_anchor: Floats, moving_px: Floats) -> bool:
        """Drop features on a road that became known, or better known, after they were picked."""
        blocked = self._blocked(moving_px)
        if blocked is None:
            return False
        at = np.rint(moved(H_frame_anchor, anchor.points)).astype(int)
        height, width = blocked.shape
        inside = (at >= 0).all(axis=1) & (at < [width, height]).all(axis=1)
        on_road = np.zeros(len(at), bool)
        on_road[inside] = blocked[at[inside, 1], at[inside, 0]] > 0
        if not on_road.any() or (~on_road).sum() < LEAST_FEATURES:
            return False
        anchor.drop(~on_road)
        return True


def _inverse(H: Floats) -> Floats:
    return np.asarray(np.linalg.inv(H))


def _described(orb: cv2.ORB, image: Image) -> tuple[Floats, Image | None]:
    corners, descriptors = orb.detectAndCompute(image, None)
    return np.array([c.pt for c in corners]).reshape(-1, 2), descriptors


def _matched(
    anchor: tuple[Floats, Image | None], here: tuple[Floats, Image | None]
) -> Floats | None:
    """Return the homography frame from anchor that mutual best matches agree on, if any."""
    if anchor[1] is None or here[1] is None:
        return None
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(anchor[1], here[1])
    if len(pairs) < LEAST_AGREEING:
        return None
    a = anchor[0][[p.queryIdx for p in pairs]]
    b = here[0][[p.trainIdx for p in pairs]]
    H, agree = cv2.findHomography(a, b, cv2.USAC_MAGSAC, 2.0)
    return np.asarray(H, np.float64) if H is not None and agree.sum() >= LEAST_AGREEING else None
