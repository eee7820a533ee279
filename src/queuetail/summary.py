"""What a run shows on the terminal: progress while it works, a short table at its end."""

from __future__ import annotations

import csv
from collections import Counter
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table

from queuetail.run import RunResult
from queuetail.sinks.words import status_words
from queuetail.types import Observation
from queuetail.video import VideoInfo


class RunProgress:
    """A progress bar with the newest answer beside it; bad input shows none."""

    def __init__(self, name: str) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[answer]}"),
            console=Console(stderr=True),
            transient=False,
        )
        self._started = False
        self._task: TaskID = self._bar.add_task(name, total=None, answer="")

    def __enter__(self) -> RunProgress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._started:
            self._bar.stop()

    def opened(self, video: VideoInfo) -> None:
        """Show the bar, now that the input is known to be good, and say how long the work is."""
        self._bar.update(self._task, total=video.duration_s)
        self._bar.start()
        self._started = True

    def done(self) -> None:
        """Fill the bar: the video's own length may count what comes after its last frame."""
        total = self._bar.tasks[0].total or 1.0
        self._bar.update(self._task, completed=total, total=total)

    def update(self, observation: Observation) -> None:
        """Show how far the run is and what it sees."""
        if observation.frame_index % 10 == 0:
            answer = "; ".join(status_words(s) for s in observation.states)
            self._bar.update(self._task, completed=observation.t_s, answer=answer)


def print_summary(result: RunResult) -> None:
    """Print a table of what was found, the notes, and where the files are."""
    console = Console()
    with (result.out / "queue.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    table = Table(title=f"queuetail run, preset {result.preset}", title_justify="left")
    for heading in ("approach", "queued", "clear", "beyond view", "unknown", "last end of queue"):
        table.add_column(heading, justify="left" if heading in ("approach",) else "right")
    for name in dict.fromkeys(row["approach"] for row in rows):
        table.add_row(*_approach_row(name, [r for r in rows if r["approach"] == name]))
    console.print(table)
    rate = result.frames / result.wall_s if result.wall_s else 0.0
    speed = result.duration_s / result.wall_s if result.wall_s else 0.0
    frames = "1 frame" if result.frames == 1 else f"{result.frames} frames"
    console.print(
        f"{frames}, {result.duration_s:.1f} s of video in {result.wall_s:.1f} s "
        f"({rate:.0f} frames/s, {speed:.1f} × real time)"
    )
    for note in result.notes:
        console.print(f"note: {note}", style="yellow", highlight=False)
    if result.interrupted:
        console.print("interrupted: the files hold what was done until then", style="bold yellow")
    console.print(f"results in {result.out}/ (open {result.out}/report.html)", highlight=False)


def _approach_row(name: str, rows: list[dict[str, str]]) -> list[str]:
    share = Counter(row["status"] for row in rows)
    percent = [
        f"{100 * share[status] / len(rows):.1f} %"
        for status in ("queued", "clear", "beyond_view", "unknown")
    ]
    last = next((r for r in reversed(rows) if r["status"] in ("queued", "beyond_view")), None)
    if last is None:
        return [name or "(no road yet)", *percent, "none"]
    place = "local metres"
    if last["eoq_lat"]:
        place = f"{float(last['eoq_lat']):.6f}, {float(last['eoq_lon']):.6f}"
    where = f"{place} · station {float(last['eoq_station_m']):.0f} m at {float(last['t_s']):.1f} s"
    return [name or "(no road yet)", *percent, where]
