"""The time between video and telemetry, measured from the picture itself.

Registration tells how the ground moved in the picture; telemetry tells how it should have.  Both
are turned into the same thing, the displacement in pixels of a few points low in the picture over
half a second, and the shift in time at which they agree best is the offset that remains.  Its
sigma comes from leaving out one eighth of the time after the other (a block jackknife; Kuensch,
Annals of Statistics 17, 1989), so that a few lucky gusts do not pass for certainty.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from queuetail.config import CameraOverride
from queuetail.geo.ground import mapping_from_pose
from queuetail.mapping import camera_pose
from queuetail.types import (
    Bools,
    Floats,
    Frame,
    Observation,
    Origin,
    Registration,
    TelemetrySample,
    Unknown,
)

STEP_S = 0.05
SPAN_S = 0.5  # over which the displacement is taken: longer than telemetry's usual step
MOST_S = 5.0  # offsets beyond it are not looked for
WINDOW_S = 180.0
BRIDGED_S = 0.4  # between two pictures of one track
BLOCKS = 8
LEAST_S = 20.0  # of time in which both say something
LEAST_PX = 0.3  # of motion, root mean square over half a second
LEAST_AGREEMENT = 0.35
RIVAL_SHARE = 0.92  # of the best agreement, elsewhere: the motion repeats itself
RIVAL_AFTER_S = 1.0
FLOOR_S = 0.02  # of sigma: exposure, read-out and a log's own rounding are not modelled
# Coders of low bit rate show motions below a pixel late: 0.065 s at 0.5 px in the bundled flight.
LATE_PX_S = 0.04
MOST_SIGMA_S = 0.25
# Changes of slope, per second, above which a value was told anew.
BENT = {"lat_deg": 1e-8, "lon_deg": 1e-8, "heading_deg": 1e-5, "gimbal_pitch_deg": 1e-5}
TOO_STILL = "the drone does not move enough to tell"
TOO_COARSE = "the drone does not move enough, or telemetry is too coarse, to tell"
DISAGREE = "the picture does not move as telemetry says, at any offset"
AMBIGUOUS = "the motion fits more than one offset"


TelemetryAt = Callable[[float], TelemetrySample]


@dataclass(frozen=True, slots=True)
class ClockOffset:
    """What is to be added to telemetry's times, as `[telemetry] offset_s` is; or why unknown."""

    offset_s: float | None
    sigma_s: float | None = None
    agreement: float = 0.0  # correlation of the two motions at that offset, up to 1
    reason: str = ""

    @property
    def is_significant(self) -> bool:
        """Whether it is beyond doubt and large enough to move a queue's end."""
        if self.offset_s is None or self.sigma_s is None:
            return False
        return abs(self.offset_s) > max(3 * self.sigma_s, 0.2)


@dataclass(frozen=True, slots=True)
class Seen:
    """How one picture lay to the reference."""

    t_s: float
    epoch: int
    H_ref_frame: Floats | None  # None while the picture is lost


class OffsetEstimator:
    """Collects the pictures' motion of the last minutes; compares it with telemetry when asked."""

    def __init__(
        self,
        width_px: int,
        height_px: int,
        camera: CameraOverride | None = None,
        window_s: float = WINDOW_S,
    ) -> None:
        self._size = width_px, height_px
        self._camera = camera or CameraOverride()
        self._window_s = window_s
        self._seen: deque[Seen] = deque()
        across, down = np.array([0.15, 0.85, 0.5, 0.85, 0.15]), np.array([0.5, 0.5, 0.7, 0.9, 0.9])
        self._points_px = np.column_stack([across * width_px, down * height_px])

    def add(self, t_s: float, registration: Registration) -> None:
        """Take one picture's registration; its time is on the clock that telemetry is asked by."""
        H = None if registration.reason else registration.H_ref_frame
        self._seen.append(Seen(t_s, registration.epoch, H))
        while self._seen[0].t_s < t_s - self._window_s:
            self._seen.popleft()

    def copy(self) -> OffsetEstimator:
        """Return one that knows the same, for another thread to ask."""
        twin = OffsetEstimator(*self._size, self._camera, self._window_s)
        twin._seen.extend(self._seen)
        return twin

    def estimate(self, telemetry_at: TelemetryAt) -> ClockOffset:
        """Return what is to be added to telemetry's times, or why that cannot be known."""
        seen = list(self._seen)
        if len(seen) < 2 or seen[-1].t_s - seen[0].t_s < LEAST_S:
            return ClockOffset(None, reason=f"less than {LEAST_S:.0f} s were seen")
        times = np.arange(seen[0].t_s, seen[-1].t_s, STEP_S)
        samples = [telemetry_at(t_s) for t_s in times.tolist()]
        told = self._told_motion(samples)
        if told is None:
            return ClockOffset(None, reason="telemetry does not tell the camera's pose")
        return best_shift(self._seen_motion(seen, times), told, told_every_s(samples))

    def _seen_motion(self, seen: Sequence[Seen], times: Floats) -> Floats:
        """Return how the points moved in the picture around each time; NaN where unknown."""
        H = np.full((len(times), 3, 3), np.nan)
        epochs = np.full(len(times), np.nan)
        for a, b in pairwise(seen):
            if a.H_ref_frame is None or b.H_ref_frame is None:
                continue
            if a.epoch != b.epoch or b.t_s - a.t_s > BRIDGED_S:
                continue
            rows = slice(*np.searchsorted(times, [a.t_s, b.t_s]).tolist())
            share = ((times[rows] - a.t_s) / (b.t_s - a.t_s))[:, None, None]
            H[rows] = a.H_ref_frame + share * (b.H_ref_frame - a.H_ref_frame)
            epochs[rows] = a.epoch
        half = round(SPAN_S / STEP_S / 2)
        before, after = _around(H, half)
        first, last = _around(epochs, half)
        known = first == last  # NaN, which is unknown, is equal to nothing
        moved = self._displacements(np.linalg.inv(_or_identity(before)) @ _or_identity(after))
        return _padded(np.where(known[:, None], moved, np.nan), half)

    def _told_motion(self, samples: Sequence[TelemetrySample]) -> Floats | None:
        """Return how the points should have moved by telemetry; None where it tells no pose."""
        to_enu = np.full((len(samples), 3, 3), np.nan)
        to_px = np.full((len(samples), 3, 3), np.nan)
        origin: Origin | None = None
        for i, sample in enumerate(samples):
            pose = camera_pose(sample, *self._size, self._camera)
            if isinstance(pose, Unknown):
                continue
            origin = origin or Origin(pose.lat_deg, pose.lon_deg)
            mapping = mapping_from_pose(pose, origin)
            to_enu[i], to_px[i] = mapping.H_enu_px, mapping.H_px_enu
        if origin is None:
            return None
        half = round(SPAN_S / STEP_S / 2)
        before, after = _around(to_px, half)[0], _around(to_enu, half)[1]
        known = _is_known(before) & _is_known(after)
        moved = self._displacements(_or_identity(before) @ _or_identity(after))
        return _padded(np.where(known[:, None], moved, np.nan), half)

    def _displacements(self, H: Floats) -> Floats:
        """Return by how much each homography moves the points, (n, 3, 3) -> (n, 2 · points)."""
        x, y = self._points_px.T
        moved = H @ np.stack([x, y, np.ones_like(x)])
        w = np.where(moved[:, 2] > 0, moved[:, 2], np.nan)  # not beyond the horizon
        return np.concatenate([moved[:, 0] / w - x, moved[:, 1] / w - y], axis=1)


class OffsetWatch:
    """A sink of a run that says at its end where the log's clock is surely off."""

    def __init__(self, telemetry_at: TelemetryAt, camera: CameraOverride) -> None:
        self._telemetry_at, self._camera = telemetry_at, camera
        self._estimator: OffsetEstimator | None = None

    def write(self, frame: Frame, observation: Observation) -> None:
        """Take one frame's registration."""
        if self._estimator is None:
            self._estimator = OffsetEstimator(*frame.size, self._camera)
        self._estimator.add(frame.t_s, observation.registration)

    def close(self) -> None:
        """Nothing is open."""

    def notes(self, set_s: float) -> tuple[str, ...]:
        """Return a sentence where the offset is beyond doubt; `set_s` is what the site file has."""
        if self._estimator is None:
            return ()
        note = offset_note(self._estimator.estimate(self._telemetry_at), set_s)
        return (note,) if note else ()


def offset_note(found: ClockOffset, set_s: float) -> str:
    """Return what a user should do about an offset; nothing where it is small or unsure."""
    if not found.is_significant or found.offset_s is None:
        return ""
    late = "late" if found.offset_s < 0 else "early"
    return (
        f"telemetry's times are {abs(found.offset_s):.2f} ± {found.sigma_s:.2f} s too {late} for "
        f"the video, by how the picture moves: set offset_s = {set_s + found.offset_s:.2f} under "
        "[telemetry] in the site file"
    )


def best_shift(seen: Floats, told: Floats, told_every_s: float = STEP_S) -> ClockOffset:
    """Return by how much `told` (n, k) is to be shifted to fit `seen` (n, k).

    Rows are STEP_S apart; those with NaN are unknown.  Telemetry was given `told_every_s`.
    """
    both = _is_known(told) & _is_known(seen)
    if both.sum() * STEP_S < LEAST_S:
        return ClockOffset(None, reason=f"less than {LEAST_S:.0f} s are known of both")
    motion_px = min(_rms(seen[both]), _rms(told[both]))
    if motion_px < LEAST_PX:
        return ClockOffset(None, reason=TOO_STILL)
    sums = _block_sums(seen - np.nanmean(seen, axis=0), told - np.nanmean(told, axis=0))
    curve = _agreement(sums.sum(axis=1))
    shift_s, agreement = _peak(curve)
    if agreement < LEAST_AGREEMENT:
        return ClockOffset(None, None, agreement, DISAGREE)
    left_out = [_peak(_agreement(np.delete(sums, b, axis=1).sum(axis=1)))[0] for b in range(BLOCKS)]
    known = np.array([s for s in left_out if s is not None])
    if shift_s is None or len(known) < BLOCKS or _has_rival(curve, shift_s):
        return ClockOffset(None, None, agreement, AMBIGUOUS)
    spread = (BLOCKS - 1) / BLOCKS * ((known - known.mean()) ** 2).sum()
    between_s = told_every_s / np.sqrt(12 * _moves(seen[both], told_every_s))
    late_s = LATE_PX_S / motion_px
    sigma_s = float(np.sqrt(spread + FLOOR_S**2 + late_s**2 + between_s**2))
    if sigma_s > MOST_SIGMA_S:
        return ClockOffset(None, sigma_s, agreement, TOO_COARSE)
    return ClockOffset(shift_s, sigma_s, agreement)


def told_every_s(samples: Sequence[TelemetrySample]) -> float:
    """Return how often telemetry said something new, of samples that are STEP_S apart.

    Between its own samples it is interpolated, so each of them bends the line of values: between
    two of ours that shows twice, at one of them once.
    """
    told = np.array([[getattr(s, name) for name in BENT] for s in samples], float)
    slopes = np.diff(told, axis=0) / STEP_S
    bends = np.abs(np.diff(slopes, axis=0)) > list(BENT.values())
    bent: Bools = np.asarray(bends.any(axis=1))
    twice = 0 if bent.mean() > 0.8 else (bent[1:] & bent[:-1]).sum()  # else all run together
    return float(len(samples) * STEP_S / max(bent.sum() - twice, 1))


def _moves(seen: Floats, told_every_s: float) -> float:
    """Return how many of telemetry's steps hold the motion: 1 where it is all in one gust.

    When between two samples a motion happened is not known; over many such motions it averages out.
    """
    energy = (seen**2).sum(axis=1)
    length = max(round(max(told_every_s, SPAN_S) / STEP_S), 1)
    each = np.add.reduceat(energy, np.arange(0, len(energy), length))
    return float(each.sum() ** 2 / (each**2).sum())


def _block_sums(seen: Floats, told: Floats) -> Floats:
    """Return Σ seen·told, Σ seen², Σ told² of each block of time at each shift: (3, blocks, n)."""
    most = round(MOST_S / STEP_S)
    shifts = range(-most, most + 1)
    sums = np.zeros((3, BLOCKS, len(shifts)))
    edges = np.linspace(0, len(seen), BLOCKS + 1).astype(int)
    for column, shift in enumerate(shifts):
        moved = np.full_like(told, np.nan)
        if shift >= 0:
            moved[shift:] = told[: len(told) - shift]
        else:
            moved[:shift] = told[-shift:]
        known = _is_known(seen) & _is_known(moved)
        a, b = np.where(known[:, None], seen, 0.0), np.where(known[:, None], moved, 0.0)
        for row, values in enumerate(((a * b).sum(axis=1), (a * a).sum(1), (b * b).sum(1))):
            sums[row, :, column] = np.add.reduceat(values, edges[:-1])
    return sums


def _agreement(sums: Floats) -> Floats:
    """Return the correlation at each shift from its three sums, (3, n) -> (n,)."""
    together, seen, told = sums
    return together / np.sqrt(np.maximum(seen * told, 1e-12))


def _peak(curve: Floats) -> tuple[float | None, float]:
    """Return the shift of the highest agreement, between the steps, and that agreement."""
    top = int(np.argmax(curve))
    if top in (0, len(curve) - 1):
        return None, float(curve[top])
    left, middle, right = curve[top - 1 : top + 2]
    bend = left - 2 * middle + right
    beside = 0.5 * (left - right) / bend if bend < 0 else 0.0
    return float((top - len(curve) // 2 + beside) * STEP_S), float(middle)


def _has_rival(curve: Floats, shift_s: float) -> bool:
    shifts_s = (np.arange(len(curve)) - len(curve) // 2) * STEP_S
    elsewhere = curve[np.abs(shifts_s - shift_s) > RIVAL_AFTER_S]
    return bool(elsewhere.max() > RIVAL_SHARE * curve.max())


def _around(values: Floats, half: int) -> tuple[Floats, Floats]:
    """Return the values half a span before and after each time but the first and last ones."""
    return values[: -2 * half], values[2 * half :]


def _padded(values: Floats, half: int) -> Floats:
    return np.pad(values, ((half, half), (0, 0)), constant_values=np.nan)


def _or_identity(H: Floats) -> Floats:
    """Return the homographies, with the unknown ones made harmless."""
    return np.where(_is_known(H)[:, None, None], H, np.eye(3))


def _is_known(values: Floats) -> Bools:
    """Return which of the rows hold numbers only."""
    return np.asarray(np.isfinite(values.reshape(len(values), -1)).all(axis=1))


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))
