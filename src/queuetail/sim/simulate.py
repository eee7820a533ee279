"""`queuetail simulate`: a scenario in, a flight with exact ground truth out."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from av.video.stream import VideoStream
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from queuetail.errors import InputError
from queuetail.sim.check import check_drawable
from queuetail.sim.flight import TruePath
from queuetail.sim.log import flight_log, write_csv, write_srt
from queuetail.sim.randomised import random_scenario
from queuetail.sim.render import Renderer
from queuetail.sim.scenario import Scenario, read_scenario
from queuetail.sim.site import write_pose, write_scenario, write_site
from queuetail.sim.traffic import require_sumo, simulate_traffic
from queuetail.sim.transport import write_transport_stream
from queuetail.sim.truth import write_truth
from queuetail.types import Floats, Image, Ints

CLOCK_HZ = 90_000
THREADS = 2

Progress = Callable[[str, int, int], None]


def quiet(stage: str, done: int, total: int) -> None:
    """Show no progress."""


def frame_ticks(scenario: Scenario, seed: int) -> Ints:
    """Return each frame's time stamp in 1/90000 s from 0 on: uneven and with drops if asked."""
    picture = scenario.picture
    rng = np.random.default_rng([seed, 41])
    count = max(round(scenario.scenario.duration_s * picture.frame_rate_hz), 2)
    ideal = np.arange(count) / picture.frame_rate_hz
    moved = ideal + rng.uniform(-0.5, 0.5, count) * picture.interval_jitter / picture.frame_rate_hz
    kept = rng.uniform(0, 1, count) >= picture.dropped_share
    kept[0] = True
    ticks = np.round((moved - moved[0]) * CLOCK_HZ).astype(np.int64)[kept]
    return np.asarray(ticks)


def simulate(
    scenario: Scenario, out: Path, seed: int | None = None, progress: Progress = quiet
) -> None:
    """Write a flight into `out`: video, telemetry, truth, site and the scenario itself.

    `progress` is called with the stage's name, how much is done and how much there is.
    Raises InputError before any time is spent where the scenario cannot be drawn.
    """
    seed = scenario.scenario.seed if seed is None else seed
    scenario = scenario.model_copy(
        update={"scenario": scenario.scenario.model_copy(update={"seed": seed})}
    )
    require_sumo()
    check_drawable(scenario)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{out}: the folder cannot be written ({error.strerror})") from None
    progress("traffic", 0, 1)
    traffic = simulate_traffic(scenario, seed)
    progress("traffic", 1, 1)
    path = TruePath(scenario, seed)
    ticks = frame_ticks(scenario, seed)
    times_s = ticks / CLOCK_HZ
    write_truth(scenario, traffic, path, times_s, out)
    samples = flight_log(scenario, path, seed)
    write_csv(samples, out / "telemetry.csv")
    write_srt(samples, scenario, out / "flight.srt")
    write_site(scenario, out / "site.toml")
    write_scenario(scenario, out / "scenario.toml")
    write_pose(path, times_s, out / "pose.csv")
    renderer = Renderer(scenario, traffic, path, seed)
    _encode(scenario, renderer, ticks, out / "flight.mp4", progress)
    if scenario.telemetry.klv:
        write_transport_stream(scenario, samples, out / "flight.mp4", out / "flight.ts")


def _pictures(renderer: Renderer, times_s: Floats) -> Iterator[Image]:
    """Draw frames in a few threads and hand them out in order."""
    waiting: deque[Future[Image]] = deque()
    todo = iter(enumerate(float(t) for t in times_s))
    with ThreadPoolExecutor(THREADS) as pool:
        for index, t_s in itertools.islice(todo, 2 * THREADS):
            waiting.append(pool.submit(renderer.frame_yuv, index, t_s))
        while waiting:
            yield waiting.popleft().result()
            for index, t_s in itertools.islice(todo, 1):
                waiting.append(pool.submit(renderer.frame_yuv, index, t_s))


def _encode(
    scenario: Scenario, renderer: Renderer, ticks: Ints, out: Path, progress: Progress
) -> None:
    picture = scenario.picture
    codec = {"h264": "libx264", "h265": "libx265"}[picture.codec]
    options = {"preset": "veryfast" if picture.codec == "h264" else "ultrafast"}
    if picture.bit_rate_kbps is None:
        options["crf"] = "23"
    if picture.codec == "h265":
        options["x265-params"] = "log-level=error:pools=2"
    rate = Fraction(picture.frame_rate_hz).limit_denominator(1001)
    with av.open(str(out), "w", options={"video_track_timescale": str(CLOCK_HZ)}) as container:
        stream = container.add_stream(codec, rate=rate, options=options)
        assert isinstance(stream, VideoStream)
        stream.width, stream.height = picture.width_px, picture.height_px
        stream.pix_fmt = "yuv420p"
        stream.codec_context.time_base = Fraction(1, CLOCK_HZ)
        stream.time_base = Fraction(1, CLOCK_HZ)
        stream.codec_context.thread_count = THREADS
        if picture.bit_rate_kbps is not None:
            stream.bit_rate = int(picture.bit_rate_kbps * 1000)
        for i, yuv in enumerate(_pictures(renderer, ticks / CLOCK_HZ)):
            frame = av.VideoFrame.from_ndarray(yuv, format="yuv420p")
            frame.pts, frame.time_base = int(ticks[i]), Fraction(1, CLOCK_HZ)
            container.mux(stream.encode(frame))
            progress("frames", i + 1, len(ticks))
        container.mux(stream.encode(None))


def command(scenario: Path | None, out: Path, seed: int | None, random_seed: int | None) -> int:
    """Simulate a scenario file, or one drawn by `random_seed`; raises InputError on bad input."""
    if (scenario is None) == (random_seed is None):
        raise InputError("simulate needs either a scenario file or --random SEED")
    chosen = read_scenario(scenario) if scenario else random_scenario(random_seed or 0)
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=console) as bar:
        tasks = {name: bar.add_task(name, total=None) for name in ("traffic", "frames")}

        def show(stage: str, done: int, total: int) -> None:
            bar.update(tasks[stage], completed=done, total=total)

        simulate(chosen, out, seed, show)
    console.print(f"{out}: flight.mp4 with telemetry, truth and site file")
    return 0
