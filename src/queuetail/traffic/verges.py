"""Where the asphalt ends beside the lanes: nobody says how far out, but it does so all along them.

Worn paint on coarse asphalt may show nothing at all, and vehicles may drive a lane aside; yet the
asphalt is seen against what lies beside it, and never ends within a lane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from queuetail.traffic.lane_evidence import LaneEvidence, offsets, turned
from queuetail.types import Approach, Floats, Ints

LEFT, RIGHT = 0, 1
SIGMA_M = (0.6, 0.5, 0.4, 0.3, 0.25, 0.2)  # from the search, on to the last round
SHOULDER_M, SHOULDER_SIGMA_M = 1.8, 1.5
NARROWEST_M, WIDEST_M = 0.1, 3.5  # shoulders; what is less is none, what is more is rare
INSIDE_SIGMA_M, BEYOND_SIGMA_M = 0.4, 2.0
WORST = 9.0  # squared sigmas: a stray counts for no more,
WORST_SIDE = 12.0  # and a whole side that ends where none does for no more than this
OUT_M = np.arange(-6.0, 14.0, 0.3)


@dataclass(frozen=True, slots=True)
class Verges:
    """Places where the asphalt may end, several of them for each stretch of a road's side."""

    seen: LaneEvidence  # (n,) as marks
    side: Ints  # (n,) 2 x approach + LEFT or RIGHT
    stretch: Ints  # (n,) each side has its own, in order

    def __len__(self) -> int:
        return len(self.side)

    def of(self, side: int) -> Verges:
        """Return those of one side."""
        rows = self.side == side
        return Verges(self.seen.where(rows), self.side[rows], self.stretch[rows])


NO_VERGES = Verges(
    LaneEvidence(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0, np.int64), np.zeros(0)),
    np.zeros(0, np.int64),
    np.zeros(0, np.int64),
)


@dataclass(frozen=True, slots=True)
class Trials:
    """Turns about the camera's foot and shifts across the road that a search tries."""

    turn: Floats  # (t,) radians
    shift_m: Floats  # (s,) at the middle of the evidence
    foot_enu: Floats
    middle_enu: Floats
    across: Floats  # unit vector


def beside_cost(
    approaches: Sequence[Approach], verges: Verges, trials: Trials
) -> tuple[Floats, Floats]:
    """Return what each turn and shift costs (t, s), and how far out each side then ends.

    The second value is (t, s, sides), in metres.
    """
    shape = len(trials.turn), len(trials.shift_m)
    total = np.zeros(shape)
    ends = np.full((*shape, 2 * len(approaches)), SHOULDER_M)
    for side in np.unique(verges.side).tolist():
        own = verges.of(side)
        approach, sign = approaches[side // 2], _outward(side)
        offset, left, _ = offsets(approach, own.seen)
        lever = (turned(own.seen.enu - trials.foot_enu) * left).sum(axis=1)
        at_middle = turned(trials.middle_enu - trials.foot_enu) @ trials.across
        drift = lever - at_middle * (left @ trials.across)
        out = sign * (offset + trials.turn[:, None] * drift) - _width_m(approach, side)
        misfit = np.minimum(((out[..., None] - OUT_M) / SIGMA_M[0]) ** 2, WORST)
        first = _starts(own.stretch)
        misfit = np.minimum.reduceat(misfit, first, axis=1)
        agreed = np.einsum("twg,w->tg", misfit, own.seen.weight[first])
        end = OUT_M + sign * trials.shift_m[:, None]
        choices = agreed[:, None] + _unlikely(end)
        best = choices.argmin(axis=2)
        total += np.take_along_axis(choices, best[..., None], 2)[..., 0]
        ends[..., side] = np.take_along_axis(
            np.broadcast_to(end, choices.shape), best[..., None], 2
        )[..., 0]
    return total, ends


def misses(
    approaches: Sequence[Approach], verges: Verges, ends_m: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return how far to the left of where its side ends, by `ends_m` (sides,), each place lies.

    Of each stretch the nearest counts, the others are NaN.  Returns that (n,), unit vectors to the
    left (n, 2), and its derivatives by `ends_m` (n, sides).
    """
    n = len(verges)
    miss, left, J = np.full(n, np.nan), np.zeros((n, 2)), np.zeros((n, len(ends_m)))
    for side in np.unique(verges.side).tolist():
        rows, own = verges.side == side, verges.of(side)
        approach, sign = approaches[side // 2], _outward(side)
        offset, left[rows], _ = offsets(approach, own.seen)
        away = offset - sign * (_width_m(approach, side) + ends_m[side])
        first = _starts(own.stretch)
        nearest = np.minimum.reduceat(np.abs(away), first)
        counts = np.diff([*first, len(away)])
        miss[rows] = np.where(np.abs(away) == np.repeat(nearest, counts), away, np.nan)
        J[rows, side] = -sign
    return miss, left, J


def together(parts: Sequence[Verges]) -> Verges:
    """Return the verges of several approaches as one."""
    if not parts:
        return NO_VERGES
    seen = [p.seen for p in parts]
    return Verges(
        LaneEvidence(
            np.concatenate([s.enu for s in seen]),
            np.concatenate([s.course for s in seen]),
            np.concatenate([s.owner for s in seen]),
            np.concatenate([s.weight for s in seen]),
        ),
        np.concatenate([p.side for p in parts]),
        np.concatenate([p.stretch for p in parts]),
    )


def _starts(stretch: Ints) -> Ints:
    """Return where each stretch's places begin, (n,) in order -> (stretches,)."""
    return np.flatnonzero(np.diff(stretch, prepend=-1))


def _outward(side: int) -> float:
    return 1.0 if side % 2 == LEFT else -1.0


def _width_m(approach: Approach, side: int) -> float:
    """Return how far out from the axis the lanes end on a side."""
    return 0.0 if side % 2 == LEFT else approach.lanes * approach.lane_width_m


def _unlikely(end_m: Floats) -> Floats:
    """Return what it costs that asphalt ends so far out, in squared sigmas."""
    inside = np.maximum(NARROWEST_M - end_m, 0.0) / INSIDE_SIGMA_M
    beyond = np.maximum(end_m - WIDEST_M, 0.0) / BEYOND_SIGMA_M
    return np.asarray(np.minimum(inside**2 + beyond**2, WORST_SIDE))
