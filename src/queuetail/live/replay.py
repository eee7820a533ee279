"""`queuetail replay`: a recording through the pipeline again, and where it answers differently."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

from queuetail import __version__
from queuetail.errors import InputError
from queuetail.files import write_text
from queuetail.live.blind import blind_observation, disbelieved
from queuetail.live.mcap_records import Record, state_records
from queuetail.live.processing import NO_PLACE
from queuetail.live.recorder import finish_cut_recordings
from queuetail.live.recording import RecordedFrame, Recording, find_recording, read_recording
from queuetail.mapping import site_origin
from queuetail.pipeline import Pipeline
from queuetail.presets import PRESETS
from queuetail.run import process, writable_folder
from queuetail.sinks import RunInfo, Sink
from queuetail.sinks.standard import standard_sinks
from queuetail.stopwatch import Stopwatch
from queuetail.types import Frame, Observation, Origin, TelemetrySample

# Another processor's last digits are no change of an answer; these are far below what is shown.
SAME = {"lat_deg": 1e-10, "lon_deg": 1e-10}
SAME_ELSE = 1e-6

Progress = Callable[[Observation], None]


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a replay first answered differently."""

    t_s: float
    approach: str
    words: str


@dataclass(slots=True)
class Comparison:
    """A sink that compares each frame's states with the recorded ones."""

    recorded: dict[int, list[Record]]
    numbers: dict[float, int]  # the answer's number by the frame's time
    compared: int = 0
    differing: int = 0
    statuses: int = 0  # of which so many differ in their status
    first: Difference | None = None
    largest_m: float = 0.0  # between the ends of the queue, where both have one

    def write(self, frame: Frame, observation: Observation) -> None:
        """Compare one frame's answer."""
        was = self.recorded.get(self.numbers[frame.t_s])
        if was is None:
            return
        now = state_records(observation)
        self.compared += 1
        self._measure(was, now)
        difference = first_difference(was, now)
        if difference is None:
            return
        self.differing += 1
        self.statuses += [s["status"] for s in was] != [s["status"] for s in now]
        if self.first is None:
            self.first = Difference(frame.t_s, *difference)

    def close(self) -> None:
        """Nothing is open."""

    def _measure(self, was: list[Record], now: list[Record]) -> None:
        ends = {s["approach"]: s["eoq"]["station_m"] for s in was if s["eoq"]}
        for state in now:
            before = ends.get(state["approach"])
            after = state["eoq"]["station_m"] if state["eoq"] else None
            if before is not None and after is not None:
                self.largest_m = max(self.largest_m, abs(after - before))


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """What a replay found."""

    recording: Recording
    preset: str
    frames: int
    duration_s: float
    wall_s: float
    comparison: Comparison
    notes: tuple[str, ...] = field(default=())

    @property
    def is_same(self) -> bool:
        """Whether every recorded answer came again."""
        return self.comparison.differing == 0 and self.recording.missing == 0


def replay(
    folder: Path,
    out: Path | None = None,
    preset: str | None = None,
    with_video: bool = True,
    progress: Progress = lambda observation: None,
) -> ReplayResult:
    """Put a recording through the pipeline again; with `out`, write a run's files there too.

    Raises InputError where there is nothing to replay.
    """
    found = find_recording(folder)
    recording = read_recording(found)
    notes = []
    if recording.was_cut:
        notes.append("the recording was cut off; all that had reached the disk was replayed")
        try:
            finish_cut_recordings(found.parent)
        except OSError:
            notes.append("its last MCAP file could not be finished, as its folder is read-only")
    if not recording.frames:
        raise InputError(f"{found}: no processed frame was recorded; there is nothing to replay")
    chosen = preset or recording.preset
    started = perf_counter()
    watch = Stopwatch()
    run = ReplayedRun(recording, chosen, watch.lap)
    comparison = Comparison(recording.states, {f.t_s: f.number for f in recording.frames})
    sinks: list[Sink] = [comparison]
    with ExitStack() as closing:
        if out is not None:
            info = _run_info(writable_folder(out), recording, chosen)
            sinks += standard_sinks(info, with_video)
        for sink in reversed(sinks):
            closing.callback(sink.close)
        frames, last_s, interrupted = process(
            RecordedFlight(recording), run, sinks, watch, progress
        )
        if interrupted:
            raise KeyboardInterrupt
        if out is not None:
            facts = {"frames": frames, "duration_s": last_s, "timings_ms": watch.mean_ms(frames)}
            write_text(out / "run.json", _run_json(recording, chosen, facts))
    notes += recording.notes
    return ReplayResult(
        recording, chosen, frames, last_s, perf_counter() - started, comparison, tuple(notes)
    )


class ReplayedRun:
    """What a live run does around its pipeline: it waits for a place, begins anew, doubts."""

    longest_s = 0.0  # which frames were looked at is part of the recording

    def __init__(self, recording: Recording, preset: str, lap: Callable[[str], None]) -> None:
        self._site, self._preset, self._lap = recording.site, preset, lap
        self._origin = site_origin(recording.site)
        self._names = tuple(a.name for a in recording.site.approach)
        self._doubts = {f.t_s: recording.doubts.get(f.number, ()) for f in recording.frames}
        self._pipeline: Pipeline | None = None
        self._size = (0, 0)

    def step(self, frame: Frame, telemetry: TelemetrySample) -> Observation:
        """Answer as the live run would have."""
        if self._origin is None and not self._site.control_point:
            if telemetry.lat_deg is None or telemetry.lon_deg is None:
                return blind_observation((), self._names, frame.t_s, NO_PLACE)
            self._origin = Origin(telemetry.lat_deg, telemetry.lon_deg)
        if self._pipeline is None or frame.size != self._size:
            self._size = frame.size
            build = PRESETS[self._preset]
            self._pipeline = build(self._site, self._origin, *self._size, self._lap)
        observation = self._pipeline.step(frame, telemetry)
        return disbelieved(observation, self._doubts[frame.t_s])


class RecordedFlight:
    """The recording as :func:`queuetail.run.process` takes a flight."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording
        self._samples = {f.t_s: f.telemetry for f in recording.frames}

    def frames(self) -> Iterable[Frame]:
        """Return the pictures that were processed, in order of time."""
        return self._recording.pictures()

    def telemetry_at(self, t_s: float) -> TelemetrySample:
        """Return what the pipeline was given at that time."""
        return self._samples[t_s]


def first_difference(was: list[Record], now: list[Record]) -> tuple[str, str] | None:
    """Return the approach and what is different there, or ``None`` for equal answers."""
    before = {s["approach"]: s for s in was}
    after = {s["approach"]: s for s in now}
    for name in dict.fromkeys([*before, *after]):
        if name not in before:
            return name, "this approach was not recorded"
        if name not in after:
            return name, "this approach is missing now"
        old, new = before[name], after[name]
        if not _is_same("", old, new):
            was_words, now_words = words(old), words(new)
            if was_words != now_words:
                return name, f"recorded {was_words}, now {now_words}"
            field, was_value, now_value = _first_unlike("", old, new)
            return name, f"{was_words}: recorded {field} {was_value}, now {now_value}"
    return None


def words(state: Record) -> str:
    """Return a recorded state in a few words."""
    eoq = state["eoq"]
    if eoq is None:
        reasons = "; ".join(state["reasons"])
        return f"{state['status']} ({reasons})" if reasons else str(state["status"])
    return f"{state['status']} at station {eoq['station_m']} m ± {eoq['sigma_m']} m"


def _is_same(name: str, was: Any, now: Any) -> bool:
    if isinstance(was, dict) and isinstance(now, dict):
        keys = was.keys() | now.keys()
        return all(_is_same(key, was.get(key), now.get(key)) for key in keys)
    if isinstance(was, list) and isinstance(now, list):
        return len(was) == len(now) and all(
            _is_same(name, a, b) for a, b in zip(was, now, strict=True)
        )
    if isinstance(was, float | int) and isinstance(now, float | int):
        return math.isclose(was, now, rel_tol=0.0, abs_tol=SAME.get(name, SAME_ELSE))
    return bool(was == now)


def _run_info(out: Path, recording: Recording, preset: str) -> RunInfo:
    return RunInfo(
        out=out,
        video_name=recording.folder.name,
        width_px=recording.size_px[0],
        height_px=recording.size_px[1],
        frame_rate_hz=_rate_hz(recording.frames),
        preset=preset,
        site=recording.site,
    )


def _first_unlike(name: str, was: Any, now: Any) -> tuple[str, Any, Any]:
    """Return the name and both values of the first field that is not the same."""
    if isinstance(was, dict) and isinstance(now, dict):
        for key in {**was, **now}:
            if not _is_same(key, was.get(key), now.get(key)):
                return _first_unlike(key, was.get(key), now.get(key))
    return name, was, now


def _rate_hz(frames: list[RecordedFrame]) -> float:
    span_s = frames[-1].t_s - frames[0].t_s
    return (len(frames) - 1) / span_s if span_s > 0 else 15.0


def _run_json(recording: Recording, preset: str, facts: dict[str, object]) -> str:
    record = {
        "queuetail_version": __version__,
        "recorded_by_version": recording.version,
        "preset": preset,
        "site": recording.site.site.name,
        "video": {
            "name": recording.folder.name,
            "width_px": recording.size_px[0],
            "height_px": recording.size_px[1],
            "frame_rate_hz": _rate_hz(recording.frames),
            "start_utc": recording.frames[0].utc.isoformat(),
        },
        "telemetry": {"name": "as recorded"},
        **facts,
        "settings": recording.site.model_dump(mode="json"),
    }
    return json.dumps(record, indent=2) + "\n"


def summary(result: ReplayResult) -> list[str]:
    """Return what a replay found, in sentences."""
    found = result.comparison
    speed = result.duration_s / result.wall_s if result.wall_s else 0.0
    lines = [
        f"{result.recording.folder}: {result.frames} frames, {result.duration_s:.1f} s, recorded "
        f"with {result.recording.preset} by queuetail {result.recording.version}, replayed with "
        f"{result.preset} by {__version__} ({speed:.1f} × real time)"
    ]
    if result.is_same:
        lines.append(f"the same: all {found.compared} answers came again")
    elif found.differing:
        lines.append(
            f"differs: {found.differing} of {found.compared} answers, {found.statuses} of them in "
            f"their status; the largest difference of the end of the queue is "
            f"{found.largest_m:.3f} m"
        )
    else:
        lines.append(
            f"incomplete: the {found.compared} answers that could be compared are the same"
        )
    if found.first is not None:
        name = f"{found.first.approach}: " if found.first.approach else ""
        lines.append(f"first at {found.first.t_s:.3f} s: {name}{found.first.words}")
    lines += [f"note: {note}" for note in result.notes]
    return lines
