"""The road of the `road` preset: the site file's, aligned to the traffic, or found from it."""

from __future__ import annotations

import dataclasses

import numpy as np

from queuetail.geo.ground import apply_homography
from queuetail.mapping import SETTLE_S, FixedMapper, RegisteredMapper, uncorrected
from queuetail.traffic.alignment import MOST, Alignment, Camera, align
from queuetail.traffic.carriageways import discover
from queuetail.traffic.lane_evidence import NO_MARKS, LaneEvidence, gather, turned, ways
from queuetail.traffic.road import assign, length_m, locate
from queuetail.types import (
    Approach,
    Floats,
    Frame,
    GroundMapping,
    Registration,
    RoadVehicles,
    Tracks,
)
from queuetail.vision.foot import camera_above_ground
from queuetail.vision.lane_lines import LaneLines
from queuetail.vision.scout import RoadScout

SURE_M, SURE_OF = 0.35, 6  # sigma, and how many vehicles and marks agree
LINES_ALONE = 12  # marks: fewer may be gravel, unless somebody drives in the lanes as well
ROUGH_M = 0.6  # sigma at which a road that lies two of them aside is moved, until one is sure,
FAR_SIGMAS = 3.0  # or of so many whatever they are,
MUCH_MORE = 1.5  # and again once so many times as much agrees
TRY_EVERY_S = 1.0
WATCH_S = 45.0  # of traffic, after which nothing new is learnt of the road
# Between tries while no road is known, and afterwards: so long, or a share of the time since.
TRY_SOON_S, REFINE_S, REFINE_LATER = 0.5, 1.0, 0.4
AIM_EVERY_S = 2.0
MIN_MOVE_M, MIN_SIGMAS = 0.4, 2.0  # smaller misalignments are left alone
TURNED_BY, TURNED_BESIDE_M = 4, 8.0  # vehicles that drive against an approach or beside it
MIN_AXIS_CHANGE_M = 0.5
MIN_LONGER_M = 15.0  # at either end


class SiteRoad:
    """Approaches that are known; what telemetry says of them is aligned to what is seen.

    Compass and GPS are off by more than a lane: painted lines, and the lanes that vehicles drive
    in, show by how much.
    """

    def __init__(
        self, approaches: tuple[Approach, ...], mapper: RegisteredMapper | FixedMapper
    ) -> None:
        self.approaches = approaches
        self.alignment: Alignment | None = None
        self._moved: tuple[Approach, ...] | None = None  # from the next picture on
        self._mapper = mapper
        self._turned: tuple[str, ...] = ()
        self._watching, self._misfit = False, 0.0
        self._rough: Alignment | None = None
        self._seen: LaneEvidence | None = None
        self._epoch, self._began_s, self._tried_s = -1, 0.0, 0.0
        self._scout, self._lines = RoadScout(), LaneLines(approaches)

    def look(self, frame: Frame, mapping: GroundMapping, registration: Registration) -> None:
        """Watch lines and traffic until they show how the picture lies on the road."""
        if self._moved is not None:
            self.approaches, self._moved = self._moved, None
        if registration.epoch != self._epoch:
            self._begin(frame.t_s, registration.epoch)
        watched_s = frame.t_s - self._began_s
        if not self._watching or watched_s > WATCH_S:
            return
        told = uncorrected(mapping)
        self._scout.update(frame.luma, told, registration.H_ref_frame, frame.t_s)
        if watched_s > SETTLE_S:
            self._lines.update(frame.luma, told, frame.t_s)
        if frame.t_s - self._tried_s < TRY_EVERY_S:
            return
        self._tried_s = frame.t_s
        self._seen = gather(self._scout.trajectories, self._lines.marks)
        self._turned = _turned(self.approaches, self._seen)
        camera = Camera(*camera_above_ground(told))
        found = align(self.approaches, self._seen, camera, self._scout.doubt_m, self._lines.verges)
        if found is not None:
            self._take(found)

    @property
    def notes(self) -> tuple[str, ...]:
        """What lines and traffic said of the telemetry, once they did, and of the axes."""
        turned = tuple(
            f"vehicles drive against {name}, and none along it: if its axis was drawn against the "
            "traffic, turn it round"
            for name in self._turned
        )
        if self.alignment is None:
            return turned
        a = self.alignment
        return (
            *turned,
            f"{a.marks} pieces of painted lines, {a.verges} of the asphalt's ends and {a.vehicles} "
            f"vehicles show telemetry turned by "
            f"{a.rotation_deg:+.2f}° (± {a.rotation_sigma_deg:.2f}°), tilted by {a.tilt_deg:.2f}° "
            f"and {a.shift_m:+.2f} m (± {a.shift_sigma_m:.2f} m) to the left of the road",
        )

    def locate(self, tracks: Tracks) -> RoadVehicles:
        """Return the tracks on the approaches."""
        return assign(tracks, self.approaches)

    def _begin(self, t_s: float, epoch: int) -> None:
        """Start to watch: after a cut telemetry may be off by something else."""
        self._watching, self._rough = isinstance(self._mapper, RegisteredMapper), None
        self._epoch, self._began_s, self._tried_s = epoch, t_s, t_s
        self._scout, self._lines = RoadScout(), LaneLines(self.approaches)

    def _take(self, found: Alignment) -> None:
        """Use what was found once it is sure; before that, where it surely is an advance."""
        if _is_sure(found):
            self._accept(found)
            self._watching = False
        elif _is_an_advance(found) and self._says_more(found):
            self._accept(found)
            self._rough = found

    def _says_more(self, found: Alignment) -> bool:
        """Tell whether much more agrees than did when the road was moved roughly, if it was."""
        return self._rough is None or _agreeing(found) >= MUCH_MORE * _agreeing(self._rough)

    def _accept(self, found: Alignment) -> None:
        """Correct the mapping by what was found, unless it is as good as that already."""
        assert isinstance(self._mapper, RegisteredMapper)
        now = self._mapper.H_true_enu
        move_m = found.move_m if self.alignment is None else self._move_m(found, now)
        # Where it was moved roughly before, more evidence is the better one, however sure.
        sure_m = MIN_SIGMAS * found.move_sigma_m if self._rough is None else 0.0
        small = move_m < max(MIN_MOVE_M, sure_m)
        self.alignment = found
        self._misfit = max(self._misfit, abs(found.rotation_deg), abs(found.shift_m) / 1.5)
        self._mapper.correct(None if small else found.H_true_enu, self._misfit)
        if not small:
            # A new tuple: the raster is laid out anew, since every place in it has moved.  This
            # picture's mapping does not know it yet, the next one's does.
            self._moved = tuple(dataclasses.replace(a) for a in self.approaches)

    def _move_m(self, found: Alignment, H_true_enu: Floats) -> float:
        """Return how far across the road most of what is seen moves, from where it is put now."""
        if self._seen is None or not len(self._seen):
            return found.move_m
        now = apply_homography(H_true_enu, self._seen.enu)
        away = found.apply(self._seen.enu) - now
        return float(np.quantile(np.abs((away * turned(self._seen.course)).sum(axis=1)), MOST))


def _turned(approaches: tuple[Approach, ...], seen: LaneEvidence) -> tuple[str, ...]:
    """Return the names of approaches that several drive against, while nobody drives along any."""
    counts = [ways(a, seen, TURNED_BESIDE_M) for a in approaches]
    if any(along for along, _ in counts):
        return ()
    named = zip(approaches, counts, strict=True)
    return tuple(a.name for a, (_, against) in named if against >= TURNED_BY)


def _is_an_advance(found: Alignment) -> bool:
    """Tell whether the lanes are surely not where telemetry puts them, though not yet where."""
    if not _is_enough(found):
        return False
    close = found.move_sigma_m < ROUGH_M and found.move_m > MIN_SIGMAS * found.move_sigma_m
    return close or found.move_m > FAR_SIGMAS * found.move_sigma_m


def _is_sure(found: Alignment) -> bool:
    """Tell whether enough was seen well to move the road for it, or to leave it."""
    return _is_enough(found) and found.move_sigma_m < SURE_M


def _is_enough(found: Alignment) -> bool:
    driven = found.vehicles > 0 or found.marks >= LINES_ALONE
    return _agreeing(found) >= SURE_OF and driven


def _agreeing(found: Alignment) -> int:
    return found.marks + found.vehicles


class FoundRoad:
    """Approaches discovered from the first vehicles, refined as more pass and as lines are seen."""

    def __init__(self) -> None:
        self.approaches: tuple[Approach, ...] = ()
        self._found_s: float | None = None
        self._epoch, self._tried_s, self._aimed_s = 0, 0.0, -np.inf
        self._aim_at: tuple[Approach, ...] = ()
        self._scout, self._lines, self._marks = RoadScout(), LaneLines(()), NO_MARKS

    @property
    def notes(self) -> tuple[str, ...]:
        """What was found."""
        found = ", ".join(f"{a.name} ({a.lanes} lanes)" for a in self.approaches)
        return (f"the road was found from the traffic: {found}",) if found else ()

    def look(self, frame: Frame, mapping: GroundMapping, registration: Registration) -> None:
        """Watch the traffic until the road is known, and a while longer."""
        if registration.epoch != self._epoch:
            self._begin_anew(registration.epoch)
        known_s = -np.inf if self._found_s is None else frame.t_s - self._found_s
        if known_s > WATCH_S:
            return
        self._scout.update(frame.luma, mapping, registration.H_ref_frame, frame.t_s)
        self._lines.update(frame.luma, mapping, frame.t_s)
        if frame.t_s - self._tried_s < _wait_s(known_s):
            return
        self._tried_s = frame.t_s
        self._discover(frame.t_s)
        if frame.t_s - self._aimed_s > AIM_EVERY_S:
            self._aim(frame.t_s)

    def _discover(self, t_s: float) -> None:
        """Take the road that traffic and lines show by now, if it is another than known."""
        marks = self._lines.marks
        if len(marks) > len(self._marks) / 2:
            self._marks = marks
        scout = self._scout
        found = discover(scout.trajectories, self._marks, scout.doubt_m, self.approaches)
        if found and _differs(self.approaches, found):
            self._found_s = t_s if self._found_s is None else self._found_s
            self.approaches = _with_old_names(found, self.approaches)

    def _begin_anew(self, epoch: int) -> None:
        """Forget what was seen before a cut; the road that was found stays until another is."""
        self._epoch, self._aim_at, self._aimed_s = epoch, (), -np.inf
        self._scout, self._lines, self._marks = RoadScout(), LaneLines(()), NO_MARKS

    def _aim(self, t_s: float) -> None:
        """Look for lines along the road, or where it may be."""
        there = self.approaches or discover(self._scout.trajectories, suspect=True)
        if there and there is not self._aim_at:
            self._aim_at, self._aimed_s = there, t_s
            self._lines = LaneLines(there)

    def locate(self, tracks: Tracks) -> RoadVehicles:
        """Return the tracks on the approaches."""
        return assign(tracks, self.approaches)


def _wait_s(known_s: float) -> float:
    """Return how long to wait for more traffic when the road has been known for so long."""
    return TRY_SOON_S if known_s < 0 else max(REFINE_S, REFINE_LATER * known_s)


def _differs(old: tuple[Approach, ...], new: tuple[Approach, ...]) -> bool:
    """Tell whether a newly found road is worth starting anew for."""
    if len(old) != len(new):
        return True
    for approach in new:
        match = _nearest(approach, old)
        if match is None or match.lanes != approach.lanes:
            return True
        station, offset, _ = locate(match, approach.axis_enu)
        before_m = match.start_station_m - float(station[0])
        beyond_m = float(station[-1]) - match.start_station_m - length_m(match)
        longer = max(before_m, beyond_m) > MIN_LONGER_M
        if longer or float(np.median(np.abs(offset))) > MIN_AXIS_CHANGE_M:
            return True
    return False


def _with_old_names(new: tuple[Approach, ...], old: tuple[Approach, ...]) -> tuple[Approach, ...]:
    """Keep an approach's name when it is found again, so that its history goes on."""
    renamed: list[Approach] = []
    for approach in new:
        match = _nearest(approach, old)
        name = match.name if match is not None else approach.name
        taken = {a.name for a in renamed}
        renamed.append(
            Approach(
                name if name not in taken else f"{approach.name} {len(renamed) + 1}",
                approach.axis_enu,
                approach.start_station_m,
                approach.lanes,
                approach.lane_width_m,
            )
        )
    return tuple(renamed)


def _nearest(approach: Approach, others: tuple[Approach, ...]) -> Approach | None:
    """Return the approach that runs the same way within a carriageway's width, if any."""
    best, best_m = None, 8.0
    for other in others:
        _, offset, course = locate(other, approach.axis_enu)
        ahead = approach.axis_enu[-1] - approach.axis_enu[0]
        distance_m = float(np.median(np.abs(offset)))
        if float((course @ ahead).mean()) > 0 and distance_m < best_m:
            best, best_m = other, distance_m
    return best
