"""Nearest-neighbour tracking in ENU with constant velocity: enough to learn where roads are."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from queuetail.traffic.paths import Trajectory
from queuetail.types import Floats, GroundPoints, Tracks, TrackState

MAX_SPEED_MPS = 45.0
MIN_SPEED_MPS = 2.0  # on the way between a trajectory's ends, while it moves
GATE_M = 2.0  # about the predicted place
GATE_GROWTH_MPS = 2.5  # per second without a detection
SWERVING_MPS, MAX_SWERVE_M = 5.0, 1.5  # aside of the predicted place, from this speed on
MAX_COAST_S = 1.2
STANDING_COAST_S = 3.0  # a standing vehicle is where it was
POSITION_GAIN, VELOCITY_GAIN = 0.5, 0.3
CONFIRMED_HITS = 4
MIN_TRAJECTORY_M = 15.0
MIN_STRAIGHTNESS = 0.6  # of end-to-end distance to the way gone
POINT_M = 0.5  # a new point of a trajectory is at least so far from the one before
ODD_AREA = 1.6  # a detection so much larger or smaller than usual is merged or cut
MAX_KEPT = 400  # finished trajectories, the latest


@dataclass(slots=True)
class _Track:
    id: int
    t_s: float  # of the last detection
    enu: Floats
    velocity_mps: Floats
    px: Floats  # of the last detection
    box_px: Floats
    sigma_m: float
    length_m: float
    hits: int = 1
    times_s: list[float] = field(default_factory=list)
    path: list[Floats] = field(default_factory=list)
    areas_m2: list[float] = field(default_factory=list)

    def predict(self, t_s: float) -> Floats:
        return self.enu + self.velocity_mps * (t_s - self.t_s)

    def trajectory(self) -> Trajectory | None:
        """Return where it went, without the places where its size was odd."""
        if self.hits < CONFIRMED_HITS or len(self.path) < CONFIRMED_HITS:
            return None
        areas = np.array(self.areas_m2)
        usual = np.median(areas)
        good = (areas < usual * ODD_AREA) & (areas > usual / ODD_AREA)
        points, times = np.array(self.path)[good], np.array(self.times_s)[good]
        if len(points) < 2:
            return None
        moved = float(np.linalg.norm(points[-1] - points[0]))
        way = float(np.linalg.norm(np.diff(points[::4], axis=0), axis=1).sum())
        if moved < MIN_TRAJECTORY_M or moved < MIN_STRAIGHTNESS * way:
            return None
        return Trajectory(times, points)


class GroundTracker:
    """Follows located detections from frame to frame; remembers the trajectories of the lost."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []
        self._finished: list[Trajectory] = []
        self._next_id = 1
        self._t_s = -np.inf

    def update(self, points: GroundPoints, t_s: float) -> None:
        """Take in the detections of the time `t_s`, later than the one before."""
        dt = min(t_s - self._t_s, MAX_COAST_S)
        pairs = self._pairs(points, t_s, dt)
        for track, row in pairs:
            self._correct(track, points, row, t_s)
        for row in sorted(set(range(len(points))) - {row for _, row in pairs}):
            self._begin(points, row, t_s)
        self._drop_lost(t_s)
        self._t_s = t_s

    @property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """All trajectories that went far enough, of the vehicles gone and of those in view."""
        going = (track.trajectory() for track in self._tracks)
        return (*self._finished, *(t for t in going if t is not None))

    def tracks(self, t_s: float) -> Tracks:
        """Return the vehicles followed now, moved on to `t_s`."""
        live = self._tracks
        return Tracks(
            ids=np.array([track.id for track in live], np.int64),
            states=tuple(_state(track, self._t_s) for track in live),
            px=_rows([track.px for track in live], 2),
            boxes_px=_rows([track.box_px for track in live], 4),
            enu=_rows([track.predict(t_s) for track in live], 2),
            velocity_mps=_rows([track.velocity_mps for track in live], 2),
            sigma_m=np.array([track.sigma_m for track in live], float),
            length_m=np.array([track.length_m for track in live], float),
        )

    def _pairs(self, points: GroundPoints, t_s: float, dt: float) -> list[tuple[_Track, int]]:
        """Match greedily, nearest first; those followed longer go before the new."""
        if not self._tracks or not len(points):
            return []
        predicted = np.array([track.predict(t_s) for track in self._tracks])
        gates = np.array([self._gate(track, t_s, dt) for track in self._tracks])
        off = points.enu[None] - predicted[:, None]
        gap = np.linalg.norm(off, axis=2)
        young = np.array([track.hits < CONFIRMED_HITS for track in self._tracks])
        velocity = np.array([track.velocity_mps for track in self._tracks])
        speed = np.linalg.norm(velocity, axis=1)
        cross = velocity[:, None, 0] * off[..., 1] - velocity[:, None, 1] * off[..., 0]
        sideways = np.abs(cross) / np.maximum(speed, 1e-9)[:, None]
        # A vehicle under way cannot jump to the next lane: that is another vehicle.
        jump = (speed > SWERVING_MPS)[:, None] & ~young[:, None] & (sideways > MAX_SWERVE_M)
        open_gate = (gap < gates[:, None]) & ~jump
        cost = np.where(open_gate, gap + 100.0 * young[:, None], np.inf)
        pairs = []
        for flat in np.argsort(cost, axis=None)[: int(np.isfinite(cost).sum())]:
            i, j = divmod(int(flat), len(points))
            if np.isfinite(cost[i, j]):
                pairs.append((self._tracks[i], j))
                cost[i], cost[:, j] = np.inf, np.inf
        return pairs

    def _gate(self, track: _Track, t_s: float, dt: float) -> float:
        if track.hits == 1:
            return MAX_SPEED_MPS * dt + GATE_M / 2
        gate = GATE_M + GATE_GROWTH_MPS * (t_s - track.t_s)
        return 2 * gate if track.hits == 2 else gate

    def _correct(self, track: _Track, points: GroundPoints, row: int, t_s: float) -> None:
        dt = t_s - track.t_s
        predicted = track.predict(t_s)
        error = points.enu[row] - predicted
        # The first steps fix the velocity; afterwards noise is smoothed.
        position_gain = max(POSITION_GAIN, 1.0 / track.hits)
        velocity_gain = max(VELOCITY_GAIN, 1.0 / track.hits)
        track.enu = predicted + position_gain * error
        track.velocity_mps = track.velocity_mps + velocity_gain * error / dt
        track.t_s = t_s
        track.px, track.box_px = points.px[row], points.boxes_px[row]
        track.sigma_m = float(points.sigma_m[row])
        track.hits += 1
        share = max(0.1, 1.0 / track.hits)
        track.length_m += share * (float(points.length_m[row]) - track.length_m)
        self._remember(track, points, row, t_s)

    def _remember(self, track: _Track, points: GroundPoints, row: int, t_s: float) -> None:
        place = points.enu[row]
        if track.path and np.linalg.norm(place - track.path[-1]) < POINT_M:
            return
        track.times_s.append(t_s)
        track.path.append(place)
        track.areas_m2.append(float(points.length_m[row] * points.width_m[row]))

    def _begin(self, points: GroundPoints, row: int, t_s: float) -> None:
        track = _Track(
            id=self._next_id,
            t_s=t_s,
            enu=points.enu[row].copy(),
            velocity_mps=np.zeros(2),
            px=points.px[row],
            box_px=points.boxes_px[row],
            sigma_m=float(points.sigma_m[row]),
            length_m=float(points.length_m[row]),
        )
        self._remember(track, points, row, t_s)
        self._next_id += 1
        self._tracks.append(track)

    def _drop_lost(self, t_s: float) -> None:
        kept = []
        for track in self._tracks:
            standing = np.linalg.norm(track.velocity_mps) < MIN_SPEED_MPS
            patience = STANDING_COAST_S if standing else MAX_COAST_S
            patience = patience if track.hits >= CONFIRMED_HITS else patience / 4
            if t_s - track.t_s <= patience:
                kept.append(track)
                continue
            trajectory = track.trajectory()
            if trajectory is not None:
                self._finished.append(trajectory)
        self._tracks = kept
        del self._finished[:-MAX_KEPT]


def _state(track: _Track, t_s: float) -> TrackState:
    if track.hits < CONFIRMED_HITS:
        return TrackState.TENTATIVE
    return TrackState.CONFIRMED if track.t_s == t_s else TrackState.COASTING


def _rows(values: list[Floats], columns: int) -> Floats:
    return np.array(values, float).reshape(-1, columns)
