"""The main job: a recorded flight in, the end of the queue out."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Protocol

import av
import cv2
import numpy as np

from queuetail import __version__
from queuetail.config import Site, read_site
from queuetail.errors import InputError
from queuetail.flight import Flight, open_flight
from queuetail.geo.earth import geodetic_from_enu
from queuetail.interrupt import held_interrupts
from queuetail.live.clock_offset import OffsetWatch
from queuetail.pace import Pace
from queuetail.pipeline import Pipeline
from queuetail.presets import DEFAULT_PRESET, PRESETS
from queuetail.sinks import RunInfo, Sink
from queuetail.sinks.standard import standard_sinks
from queuetail.site_writer import site_toml
from queuetail.stopwatch import Stopwatch
from queuetail.types import Approach, Frame, Observation, Origin, TelemetrySample
from queuetail.video import VideoInfo

Opened = Callable[[VideoInfo], None]
Progress = Callable[[Observation], None]


@dataclass(frozen=True, slots=True)
class RunResult:
    """What a run did, for the summary."""

    out: Path
    preset: str
    frames: int
    duration_s: float
    wall_s: float
    interrupted: bool
    notes: tuple[str, ...]


def run(
    video: Path,
    telemetry: Path | None = None,
    site_file: Path | None = None,
    preset: str = DEFAULT_PRESET,
    out: Path = Path("out"),
    with_video: bool = True,
    opened: Opened = lambda video: None,
    progress: Progress = lambda observation: None,
) -> RunResult:
    """Process a recorded flight into the folder `out`; see docs/outputs.md for its files.

    Ctrl-C ends the run early and leaves valid files of what was done.  Raises InputError.
    """
    site = read_site(site_file) if site_file else Site()
    with open_flight(video, telemetry, site) as flight, ExitStack() as closing:
        folder = writable_folder(out)
        watch = Stopwatch()
        size = flight.video.width_px, flight.video.height_px
        pipeline = _build(preset, site, site_file, flight, watch)
        info = RunInfo(folder, flight.video.name, *size, flight.video.frame_rate_hz, preset, site)
        offset = OffsetWatch(flight.telemetry_at, site.camera)
        sinks = [offset, *standard_sinks(info, with_video)]
        for sink in reversed(sinks):  # so that they close in order, each even if another fails
            closing.callback(sink.close)
        opened(flight.video)
        started = perf_counter()
        frames, last_s, interrupted = process(flight, pipeline, sinks, watch, progress)
        notes = (
            *flight.notes,
            *pipeline.road.notes,
            *offset.notes(site.telemetry.offset_s),
        )
        _write_run_json(
            folder / "run.json",
            flight=flight,
            site=site,
            preset=preset,
            approaches=pipeline.road.approaches,
            frames=frames,
            duration_s=last_s,
            timings_ms=watch.mean_ms(frames),
            wall_s=round(perf_counter() - started, 3),
            interrupted=interrupted,
            notes=list(notes),
        )
        if not site.approach:
            _write_found_site(folder / "site.toml", flight, pipeline.road.approaches)
    return RunResult(folder, preset, frames, last_s, perf_counter() - started, interrupted, notes)


def _build(
    preset: str, site: Site, site_file: Path | None, flight: Flight, watch: Stopwatch
) -> Pipeline:
    """Plug the preset's parts together; what is wrong then is wrong in the site file."""
    try:
        return PRESETS[preset](
            site, flight.origin, flight.video.width_px, flight.video.height_px, watch.lap
        )
    except InputError as error:
        raise InputError(f"{site_file}: {error}") from None


class Footage(Protocol):
    """Frames in order of time, and what telemetry said at each: a flight, or a recording."""

    def frames(self) -> Iterable[Frame]: ...

    def telemetry_at(self, t_s: float) -> TelemetrySample: ...


class Stepper(Protocol):
    """A pipeline, or what stands for one."""

    longest_s: float

    def step(self, frame: Frame, telemetry: TelemetrySample) -> Observation: ...


def process(
    flight: Footage,
    pipeline: Stepper,
    sinks: list[Sink],
    watch: Stopwatch,
    progress: Progress,
) -> tuple[int, float, bool]:
    """Drive every frame through the pipeline into the sinks; True at the end after Ctrl-C."""
    frames, last_s, pace = 0, 0.0, Pace(pipeline.longest_s)
    try:
        with held_interrupts() as asked:
            for frame in flight.frames():
                watch.lap("decode")
                last_s = frame.t_s
                if not pace.takes(frame.t_s):
                    continue
                observation = pipeline.step(frame, flight.telemetry_at(frame.t_s))
                for sink in sinks:
                    sink.write(frame, observation)
                watch.lap("sinks")
                frames += 1
                progress(observation)
                if asked():
                    return frames, last_s, True
    except KeyboardInterrupt:
        return frames, last_s, True
    return frames, last_s, False


def writable_folder(out: Path) -> Path:
    """Make the folder and try it; raises InputError where nothing can be written."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".queuetail-write-test"
        probe.write_bytes(b"")
        probe.unlink()
    except OSError as error:
        raise InputError(
            f"{out}: the output folder cannot be written ({error.strerror}); choose another --out"
        ) from None
    return out


def _write_run_json(
    path: Path,
    *,
    flight: Flight,
    site: Site,
    preset: str,
    approaches: tuple[Approach, ...],
    **facts: object,
) -> None:
    video = flight.video
    record = {
        "queuetail_version": __version__,
        "preset": preset,
        "site": site.site.name,
        "video": {
            "name": video.name,
            "sha256": sha256(flight.video_path),
            "width_px": video.width_px,
            "height_px": video.height_px,
            "frame_rate_hz": video.frame_rate_hz,
            "codec": video.codec,
            "duration_s": video.duration_s,
            "start_utc": video.start_utc.isoformat() if video.start_utc else None,
        },
        "telemetry": {
            "name": flight.telemetry_path.name,
            "sha256": sha256(flight.telemetry_path),
        }
        if flight.telemetry_path
        else None,
        **facts,
        "approaches": [_approach_record(a, flight.origin) for a in approaches],
        "settings": site.model_dump(mode="json"),
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "opencv": cv2.__version__,
            "av": av.__version__,
        },
    }
    path.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def _write_found_site(path: Path, flight: Flight, approaches: tuple[Approach, ...]) -> None:
    """Write the road that was found as a site file, to keep and to edit."""
    path.unlink(missing_ok=True)
    if approaches and flight.origin is not None:
        path.write_text(
            site_toml(approaches, flight.origin, f"found in {flight.video.name}"), encoding="utf-8"
        )


def _approach_record(approach: Approach, origin: Origin | None) -> dict[str, object]:
    lat_lon = None
    if origin is not None:
        lat_lon = np.column_stack(geodetic_from_enu(approach.axis_enu, origin)).tolist()
    return {
        "name": approach.name,
        "lanes": approach.lanes,
        "lane_width_m": approach.lane_width_m,
        "start_station_m": approach.start_station_m,
        "axis_lat_lon": lat_lon,
        "axis_enu_m": approach.axis_enu.tolist(),
    }


def sha256(path: Path) -> str:
    """Return the checksum of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
