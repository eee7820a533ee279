"""DJI subtitle files (.SRT): every dialect as tolerant key/value text, cue by cue."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import datetime

from queuetail.errors import InputError
from queuetail.telemetry.dji_cue import CueFacts, facts_of, gps_order
from queuetail.telemetry.lens import effective_focals, hfov_from_equivalent
from queuetail.telemetry.reading import STAMP, Reading, VideoClock, stamp_of
from queuetail.types import TelemetrySample

CUE_TIME = re.compile(r"^\s*(\d{1,3}):(\d{1,2}):(\d{1,2})[,.](\d{1,3})\s*-->")
GPS_MARKS = re.compile(r"GPS\s*\(|HOME\s*\(|\blatitude\s*:", re.IGNORECASE)
OFFSET_FROM_S = 10.0  # a file that starts later than this was cut from a longer recording

# Heights, best first; files that give several keep to one, so that the datum never changes.
HEIGHTS = ("rel_alt", "h", "barometer", "altitude")
HEIGHT_NOTES = {
    "barometer": "heights are the barometer's, above the take-off point",
    "altitude": "heights are the file's 'altitude', which may be above sea level: "
    "give height_agl_m in the site file's [telemetry] if so",
}


@dataclass(frozen=True, slots=True)
class Cue:
    """One subtitle: its start in seconds (None where the time line is broken) and its text."""

    start_s: float | None
    text: str


def is_dji_srt(text: str) -> bool:
    """Tell whether the text has subtitle cues or DJI's own position keys."""
    head = text[:20_000]
    if "-->" in head or (GPS_MARKS.search(head) and STAMP.search(head)):
        return True
    return re.fullmatch(r"\s*\d*\s*", text) is not None  # cue numbers and nothing else: broken off


def read_dji_srt(text: str, source: str, video: VideoClock) -> Reading:
    """Read a DJI SRT file of any dialect (A … E of the project's notes on formats).

    Raises InputError when there are no cues, or none of them says anything of the flight.
    """
    cues = list(_cues(text))
    if not cues:
        raise InputError(f"{source}: there are no subtitle cues in it; is the file broken off?")
    return reading_from_cues(cues, source, video)


def reading_from_cues(cues: Sequence[Cue], source: str, video: VideoClock) -> Reading:
    """Turn cues, from a file or from a video's subtitle stream, into samples."""
    timed = [(cue.start_s, cue.text) for cue in cues if cue.start_s is not None]
    notes: list[str] = []
    if len(timed) < len(cues):
        notes.append(f"{len(cues) - len(timed)} of {len(cues)} cues skipped: no readable time")
    order, order_notes = gps_order(text for _, text in timed)
    facts = [(start_s, facts_of(text, order)) for start_s, text in timed]
    if not any(fact.says_anything for _, fact in facts):
        raise InputError(
            f"{source}: none of its {len(cues)} subtitle cues tells a position, "
            "a height or a lens; the drone recorded no telemetry into it"
        )
    height, height_notes = _best_height([fact for _, fact in facts])
    has_gimbal = _has_gimbal([fact for _, fact in facts])
    start_s, offset_notes = _offset([start for start, _ in timed], video)
    focals = effective_focals([f.focal_mm for _, f in facts], [f.zoom for _, f in facts])
    samples = [
        TelemetrySample(
            t_s=time - start_s,
            lat_deg=fact.lat_deg,
            lon_deg=fact.lon_deg,
            height_agl_m=fact.heights.get(height) if height else None,
            heading_deg=fact.yaw_deg if has_gimbal else None,
            gimbal_pitch_deg=fact.pitch_deg if has_gimbal else None,
            gimbal_roll_deg=fact.roll_deg if has_gimbal else None,
            hfov_deg=None if focal is None else hfov_from_equivalent(focal),
        )
        for (time, fact), focal in zip(facts, focals, strict=True)
    ]
    silent = sum(not fact.says_anything for _, fact in facts)
    if silent:
        notes.append(f"{silent} of {len(cues)} cues skipped: they tell nothing of the flight")
    if not has_gimbal and any(fact.yaw_deg is not None for _, fact in facts):
        notes.append("gimbal angles are all exactly zero, so they were taken as not recorded")
    return Reading(samples, (*notes, *order_notes, *height_notes, *offset_notes))


def _cues(text: str) -> Iterable[Cue]:
    if "-->" not in text:
        return _cues_by_clock(text)
    return _cues_by_time_line(text)


def _cues_by_time_line(text: str) -> Iterable[Cue]:
    start_s: float | None = None
    lines: list[str] | None = None
    for line in text.splitlines(keepends=True):
        if "-->" in line:
            if lines is not None:
                yield Cue(start_s, "".join(lines))
            start_s, lines = _start_s(line), []
        elif lines is not None:
            lines.append(line)
    if lines is not None:
        yield Cue(start_s, "".join(lines))


def _start_s(line: str) -> float | None:
    match = CUE_TIME.match(line)
    if match is None:
        return None
    hours, minutes, seconds, fraction = match.groups()
    whole = int(hours) * 3600 + int(minutes) * 60 + int(seconds)
    return whole + float(f"0.{fraction}")


def _cues_by_clock(text: str) -> Iterable[Cue]:
    """Cues without time lines: times come from the clock lines, relative to the first of them.

    Cues that share one time are spread evenly over a second.
    """
    blocks = re.split(r"\n\s*\n", text)
    stamped = [(stamp, block) for block in blocks if (stamp := stamp_of(block)) is not None]
    sharing = Counter(stamp for stamp, _ in stamped)
    seen: Counter[datetime] = Counter()
    for stamp, block in stamped:
        since_first_s = (stamp - stamped[0][0]).total_seconds()
        yield Cue(since_first_s + seen[stamp] / sharing[stamp], block)
        seen[stamp] += 1


def _best_height(facts: Sequence[CueFacts]) -> tuple[str | None, list[str]]:
    """Choose the kind of height for the whole file, so that its datum never changes in flight."""
    telling = [fact.heights for fact in facts if fact.heights]
    if not telling:
        return None, []
    count = Counter(kind for heights in telling for kind in heights)
    kind = next(
        (kind for kind in HEIGHTS if 2 * count[kind] >= len(telling)), count.most_common(1)[0][0]
    )
    notes = [HEIGHT_NOTES[kind]] if kind in HEIGHT_NOTES else []
    other = sum(kind not in heights for heights in telling)
    if other:
        notes.append(f"{other} cues give another kind of height than {kind}, which was not used")
    return kind, notes


def _has_gimbal(facts: Sequence[CueFacts]) -> bool:
    """Tell whether the gimbal angles are measured: some firmware writes zeros throughout."""
    angles = [a for f in facts for a in (f.yaw_deg, f.pitch_deg, f.roll_deg) if a is not None]
    return any(angles)


def _offset(starts: Sequence[float], video: VideoClock) -> tuple[float, list[str]]:
    """Return the time of the video's first frame in the file's time, and a note if it is not 0."""
    first = min(starts)
    if first < OFFSET_FROM_S or (video.duration_s is not None and first < video.duration_s):
        return 0.0, []
    note = f"the cues start at {first:.3f} s, as in a cut file: the first is taken as time 0"
    return first, [note]
