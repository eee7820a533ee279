"""`queuetail bench`: how fast each preset is beside decoding alone, on the same video.

Absolute figures are the machine's; ratios are queuetail's.  So everything is measured in one go,
in turns whose order alternates: what else the machine does hits all of them alike, and a ratio is
taken within each turn before the median over the turns.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
import os
import resource
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from time import perf_counter

from pydantic import TypeAdapter

from queuetail.config import PaperSettings, Site, read_site
from queuetail.errors import InputError
from queuetail.flight import open_flight
from queuetail.presets import PRESETS
from queuetail.run import process
from queuetail.sinks import RunInfo
from queuetail.sinks.standard import standard_sinks
from queuetail.stopwatch import Stopwatch
from queuetail.types import Observation
from queuetail.video import VideoFile, VideoInfo

DECODE = "decode only"
BUNDLED = Path(__file__).resolve().parents[2] / "examples" / "flagger"
MEGABYTE = 1_000_000
LARGEST_BLUR_PX, LARGEST_DILATION_PX = 31, 9  # the ends of the paper's sliders

Told = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Job:
    """One thing to measure; without a preset the video is only decoded."""

    video: Path
    telemetry: Path | None
    site: Site
    preset: str | None
    until_s: float


@dataclass(frozen=True, slots=True)
class Measured:
    """What one process took for one job."""

    frames: int  # that the job looked at: fewer than the video's where the preset leaves some out
    loop_s: float  # from the opened video to the last frame's row in the tables
    whole_s: float  # to the last file's end, report included
    peak_mb: float  # resident memory of the whole process at its highest, Python included
    stage_ms: dict[str, float]  # per frame looked at


@dataclass(frozen=True, slots=True)
class Figures:
    """One method's medians over the turns."""

    frames: int
    rate_hz: float  # frames of the video per second of the loop
    whole_rate_hz: float
    times_decode: float  # time of the loop over the time of decoding alone
    whole_times_decode: float
    peak_mb: float
    stage_ms: dict[str, float]  # per frame of the video


@dataclass(frozen=True, slots=True)
class Ratio:
    """How many times as fast one method is as another."""

    fast: str
    slow: str
    loop: float
    whole: float


@dataclass(frozen=True, slots=True)
class Bench:
    """The result of a bench."""

    video: VideoInfo
    seconds: float
    turns: int
    cores: int
    load: float  # mean number of running processes in the minute before, this one's not included
    ratios: tuple[Ratio, ...]
    methods: dict[str, Figures]


def bench(
    video: Path | None,
    telemetry: Path | None = None,
    site_file: Path | None = None,
    until_s: float = 30.0,
    turns: int = 3,
    tell: Told = lambda text: None,
) -> Bench:
    """Measure decoding alone, `paper` at its own and at the video's width, and `road`.

    Without a video the bundled flight is taken.  Each measurement has a process of its own, so
    that its peak memory is its own.  Raises InputError.
    """
    if not (until_s > 0 and turns > 0):
        raise InputError("a bench needs --seconds above 0 and --turns of 1 or more")
    if video is None:
        video, telemetry, site_file = bundled(telemetry, site_file)
    site = read_site(site_file) if site_file else Site()
    with open_flight(video, telemetry, site) as flight:
        info = flight.video
    methods = jobs(video, telemetry, site, info.width_px, until_s)
    load = os.getloadavg()[0]
    taken: dict[str, list[Measured]] = {name: [] for name in methods}
    for turn in range(turns):
        order = list(methods) if turn % 2 == 0 else list(reversed(methods))
        for name in order:
            tell(f"{name}, turn {turn + 1} of {turns}")
            taken[name].append(in_a_process(methods[name]))
    return summarise(info, min(until_s, info.duration_s or until_s), load, taken)


def bundled(
    telemetry: Path | None = None, site_file: Path | None = None
) -> tuple[Path, Path, Path]:
    """Return the bundled flight's video, telemetry and site file; raises InputError without it."""
    if not (BUNDLED / "flight.mp4").is_file():
        raise InputError("the bundled flight is not installed with the package: name a VIDEO")
    return (
        BUNDLED / "flight.mp4",
        telemetry or BUNDLED / "telemetry.csv",
        site_file or BUNDLED / "site.toml",
    )


def jobs(
    video: Path, telemetry: Path | None, site: Site, width_px: int, until_s: float
) -> dict[str, Job]:
    """Return what is measured, by the name it has in the tables."""
    paper = site.paper
    full = site.model_copy(update={"paper": at_width(paper, width_px)})
    chosen: dict[str, tuple[Site, str | None]] = {
        DECODE: (site, None),
        "road": (site, "road"),
        f"paper at {paper.width_px} px": (site, "paper"),
        f"paper at {width_px} px": (full, "paper"),
    }
    return {name: Job(video, telemetry, *what, until_s) for name, what in chosen.items()}


def at_width(paper: PaperSettings, width_px: int) -> PaperSettings:
    """Return the paper's settings for a picture of another width.

    Its sliders count pixels, so they grow with the picture: with the small picture's sliders the
    large one would hold many more and smaller blobs, and would be slower than the method is.
    """
    scale = width_px / paper.width_px
    return paper.model_copy(
        update={
            "width_px": width_px,
            "blur_px": min(2 * max(round((paper.blur_px * scale - 1) / 2), 1) + 1, LARGEST_BLUR_PX),
            "dilate_px": min(max(round(paper.dilate_px * scale), 3), LARGEST_DILATION_PX),
            "min_blob_px2": paper.min_blob_px2 * scale**2,
        }
    )


def in_a_process(job: Job) -> Measured:
    """Measure a job in a fresh process."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return pool.submit(measure, job).result()


def measure(job: Job) -> Measured:
    """Do a job and say what it took, opening the video left out."""
    return _decode(job) if job.preset is None else _run(job, job.preset)


def _decode(job: Job) -> Measured:
    """Decode, and leave the luma plane where it is."""
    frames = 0
    with VideoFile(job.video) as file:
        started = perf_counter()
        for frame in file.frames():
            frames += 1
            if frame.t_s >= job.until_s:
                break
        took_s = perf_counter() - started
    return Measured(frames, took_s, took_s, peak_mb(), {"decode": 1000 * took_s / max(frames, 1)})


def _run(job: Job, preset: str) -> Measured:
    """Do all that `queuetail run --no-video` does between opening its input and closing."""

    def stop_in_time(observation: Observation) -> None:
        if observation.t_s >= job.until_s:
            raise KeyboardInterrupt  # a run's own way to end early with all its files

    with (
        tempfile.TemporaryDirectory() as out,
        open_flight(job.video, job.telemetry, job.site) as flight,
    ):
        watch, video = Stopwatch(), flight.video
        size = video.width_px, video.height_px
        pipeline = PRESETS[preset](job.site, flight.origin, *size, watch.lap)
        info = RunInfo(Path(out), video.name, *size, video.frame_rate_hz, preset, job.site)
        sinks = standard_sinks(info, video=False)
        started = perf_counter()
        with ExitStack() as closing:
            for sink in reversed(sinks):
                closing.callback(sink.close)
            watch.lap("setup")
            frames = process(flight, pipeline, sinks, watch, stop_in_time)[0]
            loop_s = perf_counter() - started
        whole_s = perf_counter() - started
    stage_ms = watch.mean_ms(frames)
    del stage_ms["setup"]
    return Measured(frames, loop_s, whole_s, peak_mb(), stage_ms)


def peak_mb() -> float:
    """Return the highest resident memory of this process so far, in megabytes of 10⁶ bytes."""
    status = Path("/proc/self/status")
    if status.is_file():  # its own since exec, while getrusage may carry the parent's over
        line = next(s for s in status.read_text().splitlines() if s.startswith("VmHWM:"))
        return int(line.split()[1]) * 1024 / MEGABYTE
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / MEGABYTE


def summarise(
    video: VideoInfo, seconds: float, load: float, taken: dict[str, list[Measured]]
) -> Bench:
    """Return medians over the turns; ratios are taken within each turn."""
    frames = taken[DECODE][0].frames
    presets = [name for name in taken if name != DECODE]
    return Bench(
        video=video,
        seconds=seconds,
        turns=len(taken[DECODE]),
        cores=os.cpu_count() or 1,
        load=load,
        ratios=tuple(
            _ratio("road", name, taken) for name in dict.fromkeys(presets) if name != "road"
        ),
        methods={name: _figures(frames, of, taken[DECODE]) for name, of in taken.items()},
    )


def _ratio(fast: str, slow: str, taken: dict[str, list[Measured]]) -> Ratio:
    pairs = list(zip(taken[fast], taken[slow], strict=True))
    return Ratio(
        fast,
        slow,
        median(b.loop_s / a.loop_s for a, b in pairs),
        median(b.whole_s / a.whole_s for a, b in pairs),
    )


def _figures(frames: int, of: list[Measured], decode: list[Measured]) -> Figures:
    turns = list(zip(of, decode, strict=True))
    stages = dict.fromkeys(stage for m in of for stage in m.stage_ms)
    return Figures(
        frames=of[0].frames,
        rate_hz=median(frames / m.loop_s for m in of),
        whole_rate_hz=median(frames / m.whole_s for m in of),
        times_decode=median(m.loop_s / d.loop_s for m, d in turns),
        whole_times_decode=median(m.whole_s / d.whole_s for m, d in turns),
        peak_mb=max(m.peak_mb for m in of),
        stage_ms={
            s: median(m.stage_ms.get(s, 0.0) * m.frames / frames for m in of) for s in stages
        },
    )


def to_json(result: Bench) -> dict[str, object]:
    """Return the figures as plain values."""
    record = dataclasses.asdict(result)
    start = result.video.start_utc
    record["video"]["start_utc"] = start.isoformat() if start else None
    return record


def from_json(record: dict[str, object]) -> Bench:
    """Return the bench that `to_json` gave this record of."""
    return TypeAdapter(Bench).validate_python(record)
