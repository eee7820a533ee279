"""What a bench shows: ratios first, then absolute figures, then where the time goes."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from queuetail.bench import DECODE, Bench

Rows = list[list[str]]


def tables(result: Bench) -> list[tuple[str, Rows]]:
    """Return title and rows of each table; the first row is the heading."""
    return [
        ("Ratios", ratio_rows(result)),
        ("Absolute, on this machine", absolute_rows(result)),
        ("Milliseconds per frame of the video", stage_rows(result)),
    ]


def print_tables(result: Bench) -> None:
    """Print what was measured and its tables."""
    console = Console()
    console.print(setting(result), highlight=False)
    for title, (heading, *rows) in tables(result):
        table = Table(title=title, title_justify="left")
        for i, name in enumerate(heading):
            table.add_column(name, justify="right" if i else "left")
        for row in rows:
            table.add_row(*row)
        console.print(table)


def setting(result: Bench) -> str:
    """Say in one sentence what was measured, and how."""
    video, frames = result.video, result.methods[DECODE].frames
    return (
        f"{video.name}, {video.width_px}×{video.height_px} {video.codec}: {frames} frames of "
        f"{result.seconds:.1f} s, median of {result.turns} turns in alternating order, "
        f"{result.cores} cores with a load of {result.load:.1f} from elsewhere before"
    )


def ratio_rows(result: Bench) -> Rows:
    """Return how many times as fast as `paper`, and how many times decoding's time."""
    rows = [["", "frame by frame", "whole run with report"]]
    for ratio in result.ratios:
        name = f"{ratio.fast} ÷ {ratio.slow}, speed"
        rows.append([name, f"{ratio.loop:.1f} ×", f"{ratio.whole:.1f} ×"])
    for name, figures in result.methods.items():
        if name != DECODE:
            both = (figures.times_decode, figures.whole_times_decode)
            rows.append([f"{name} ÷ {DECODE}, time", *(f"{r:.2f} ×" for r in both)])
    return rows


def absolute_rows(result: Bench) -> Rows:
    """Return rates, times real time and peak memory."""
    rows = [["", "frames/s", "× real time", "with report", "frames looked at", "peak memory"]]
    frames = result.methods[DECODE].frames
    for name, figures in result.methods.items():
        pace = figures.rate_hz * result.seconds / max(frames, 1)
        rows.append(
            [
                name,
                f"{figures.rate_hz:.0f}",
                f"{pace:.1f}",
                f"{figures.whole_rate_hz:.0f}",
                f"{figures.frames} of {frames}",
                f"{figures.peak_mb:.0f} MB",
            ]
        )
    return rows


def stage_rows(result: Bench) -> Rows:
    """Return each stage's time for each method."""
    stages = dict.fromkeys(s for figures in result.methods.values() for s in figures.stage_ms)
    rows = [["", *result.methods]]
    for stage in stages:
        times = (figures.stage_ms.get(stage) for figures in result.methods.values())
        rows.append([stage, *("–" if t is None else f"{t:.2f}" for t in times)])
    totals = (sum(figures.stage_ms.values()) for figures in result.methods.values())
    return [*rows, ["all", *(f"{t:.2f}" for t in totals)]]
