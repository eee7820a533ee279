"""The road found from the traffic itself, where no site file says where it lies."""

from __future__ import annotations

import numpy as np

from queuetail.traffic.road import assign
from queuetail.types import (
    Approach,
    Floats,
    Frame,
    GroundMapping,
    Registration,
    RoadVehicles,
    Tracks,
    TrackState,
)

MIN_TRACKS = 3  # moving vehicles before a road is believed
MIN_MOVED_M = 15.0
MIN_SPEED_MPS = 2.0
LANE_WIDTH_M = 3.5
REACH_M = 1500.0  # how far the straight axis goes on both ways
COMPASS = ("NB", "NEB", "EB", "SEB", "SB", "SWB", "WB", "NWB")


class StraightRoad:
    """One straight axis per direction of travel, through the first vehicles that drove it."""

    def __init__(self, course_deg: float | None = None) -> None:
        """Watch both directions, or only the one within 90° of the compass course `course_deg`."""
        self._course_deg = course_deg
        self._first_seen: dict[int, Floats] = {}
        self._moved: dict[int, tuple[Floats, Floats]] = {}
        self.approaches: tuple[Approach, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Nothing that a user should know."""
        return ()

    def look(self, frame: Frame, mapping: GroundMapping, registration: Registration) -> None:
        """Learn nothing from pictures: the tracks tell enough."""

    def locate(self, tracks: Tracks) -> RoadVehicles:
        """Learn from the tracks until the road is known; return them on it."""
        if not self.approaches:
            self._learn(tracks)
        return assign(tracks, self.approaches)

    def _learn(self, tracks: Tracks) -> None:
        for i, state in enumerate(tracks.states):
            if state is not TrackState.CONFIRMED:
                continue
            track_id, place = int(tracks.ids[i]), tracks.enu[i]
            start = self._first_seen.setdefault(track_id, place)
            if np.linalg.norm(place - start) >= MIN_MOVED_M:
                self._moved[track_id] = (start, place)
        if len(self._moved) >= MIN_TRACKS:
            self.approaches = straight_approaches(list(self._moved.values()), self._course_deg)


def straight_approaches(
    moves: list[tuple[Floats, Floats]], course_deg: float | None
) -> tuple[Approach, ...]:
    """Fit one axis per direction to moves (from, to), each an ENU point; most used first."""
    starts, ends = np.array([m[0] for m in moves]), np.array([m[1] for m in moves])
    moved = ends - starts
    # The axis has no sign: the dominant eigenvector of the summed outer products.
    unit = np.linalg.eigh(moved.T @ moved)[1][:, -1]
    forwards = moved @ unit > 0
    if forwards.sum() * 2 < len(moved):
        unit, forwards = -unit, ~forwards
    found = []
    for direction, used in ((unit, forwards), (-unit, ~forwards)):
        wanted = course_deg is None or direction @ _compass_unit(course_deg) > 0
        if wanted and used.any():
            found.append(_straight_approach(direction, np.concatenate([starts[used], ends[used]])))
    return tuple(found)


def _straight_approach(direction: Floats, points: Floats) -> Approach:
    left = np.array([-direction[1], direction[0]])
    offsets = points @ left
    lanes = max(1, round((offsets.max() - offsets.min()) / LANE_WIDTH_M) + 1)
    edge = (offsets.max() + offsets.min() + lanes * LANE_WIDTH_M) / 2
    middle = direction * float(np.median(points @ direction)) + left * edge
    axis = np.stack([middle - direction * REACH_M, middle + direction * REACH_M])
    return Approach(course_name(direction), axis, 0.0, lanes, LANE_WIDTH_M)


def course_name(direction: Floats) -> str:
    """Return the compass name of a course (unit vector in ENU): NB, EB, …"""
    course_deg = float(np.degrees(np.arctan2(direction[0], direction[1])))
    return COMPASS[round(course_deg / 45.0) % 8]


def _compass_unit(course_deg: float) -> Floats:
    return np.array([np.sin(np.radians(course_deg)), np.cos(np.radians(course_deg))])
