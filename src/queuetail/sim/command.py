"""What `queuetail simulate` does, with progress on screen."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from queuetail.errors import InputError
from queuetail.sim.randomised import random_scenario
from queuetail.sim.scenario import read_scenario
from queuetail.sim.simulate import simulate


def simulate_command(
    scenario: Path | None, out: Path, seed: int | None, random_seed: int | None
) -> None:
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
    with Progress(*columns, console=console) as bar:
        tasks = {name: bar.add_task(name, total=None) for name in ("traffic", "frames")}

        def show(stage: str, done: int, total: int) -> None:
            bar.update(tasks[stage], completed=done, total=total)

        simulate(chosen, out, seed, show)
    console.print(f"{out}: flight.mp4 with telemetry, truth and site file")
