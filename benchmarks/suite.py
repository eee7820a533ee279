"""The benchmark: every scenario, simulated once, run with every variant, evaluated, tabulated.

python benchmarks/suite.py                       all of benchmarks/scenarios
python benchmarks/suite.py --quick               a subset, under 10 minutes
python benchmarks/suite.py --random 1 2 3        and scenarios that nobody has seen
python benchmarks/suite.py --doc docs/benchmarks.md     rewrite its tables

What is done already is not done again unless the scenario, the simulator or the code under test has
changed, so an interrupted benchmark goes on where it stopped.  Each step is a process of its own:
one that fails shows in the table and stops no other.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from one_run import VARIANTS
from queuetail.errors import InputError
from queuetail.sim.randomised import random_scenario
from queuetail.sim.scenario import Scenario, read_scenario
from suite_tables import rewrite, suite_text

ROOT = Path(__file__).resolve().parent.parent
SCENARIOS = ROOT / "benchmarks" / "scenarios"
SOURCE = ROOT / "src" / "queuetail"
QUICK = ("biased_telemetry", "cold_start_standing_queue", "flagger_day", "free_flow_dense")
# What changes no figure of a run: the simulator (its flights are compared themselves) and edges.
BESIDE = {
    *("sim", "console", "live", "signs", "feeds"),
    *("cli.py", "bench.py", "bench_table.py", "summary.py", "export.py", "locate.py"),
}
SPEED_FLIGHTS = {"speed": ("flagger_day", 80.0), "speed_4k": ("uhd_4k", 10.0)}
PATIENCE_S = 3600.0
# The suite runs as many processes as there are cores, so each one gets one thread to compute with.
ONE_THREAD = {"OPENCV_FOR_THREADS_NUM": "1", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

Told = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Case:
    """One scenario of the suite."""

    name: str
    scenario: Scenario
    how: tuple[str, ...]  # what `queuetail simulate` is told
    key: str  # changes with the scenario


@dataclass(frozen=True, slots=True)
class Suite:
    """Where everything lies, and what is run."""

    out: Path
    cases: tuple[Case, ...]
    variants: tuple[str, ...]
    flights: Path | None = None  # simulated before, elsewhere

    def result(self, case: Case, variant: str) -> Path:
        """Return where the figures of a run are kept."""
        return self.out / variant / f"{case.name}.json"


def cases_of(paths: Iterable[Path], seeds: Iterable[int]) -> tuple[Case, ...]:
    """Return named and random scenarios; raises InputError where one cannot be read."""
    named = [
        Case(p.stem, read_scenario(p), (str(p),), _digest([p.read_bytes()])) for p in sorted(paths)
    ]
    drawn = [
        Case(f"random_{seed}", random_scenario(seed), ("--random", str(seed)), f"random {seed}")
        for seed in seeds
    ]
    return (*named, *drawn)


def flight_of(suite: Suite, case: Case) -> Path:
    """Return the folder of a case's flight, which may still have to be made."""
    if suite.flights is not None:
        flight = suite.flights / case.name
        resolved = flight / "scenario.toml"
        if resolved.is_file() and read_scenario(resolved) == case.scenario:
            return flight
    return suite.out / "flights" / case.name


def simulate(suite: Suite, case: Case) -> str | None:
    """Make a case's flight unless it is there; return what went wrong."""
    flight = flight_of(suite, case)
    if suite.flights is not None and flight.parent == suite.flights:
        return None
    stamp, key = flight / "made-from.txt", _digest([case.key.encode(), simulator_key().encode()])
    if stamp.is_file() and stamp.read_text(encoding="utf-8") == key:
        return None
    stamp.unlink(missing_ok=True)
    command = [sys.executable, "-m", "queuetail.cli", "simulate", *case.how, "--out", str(flight)]
    problem = _do(command)
    if problem is None:
        stamp.write_text(key, encoding="utf-8")
    return problem


def measure(suite: Suite, case: Case, variant: str) -> None:
    """Write the figures of one run, or what went wrong, unless they are there and still hold."""
    flight, target = flight_of(suite, case), suite.result(case, variant)
    try:
        key = _digest([run_key().encode(), flight_key(flight).encode()])
    except OSError as error:
        return _write_failure(target, f"the flight lacks {error.filename}")
    if _known(target).get("key") == key:
        return None
    target.parent.mkdir(parents=True, exist_ok=True)
    out, fresh = suite.out / "runs" / variant / case.name, target.with_suffix(".new")
    script = Path(__file__).with_name("one_run.py")
    problem = _do([sys.executable, str(script), str(flight), variant, str(out), str(fresh)])
    record = {"error": problem} if problem is not None else {"key": key, **_known(fresh)}
    fresh.unlink(missing_ok=True)
    target.write_text(json.dumps(record) + "\n", encoding="utf-8")


def go(suite: Suite, workers: int, tell: Told) -> dict[str, dict[str, dict[str, Any]]]:
    """Do all that is not done yet; return the figures by variant and scenario."""
    with ThreadPoolExecutor(workers) as pool:
        try:
            flights = {pool.submit(simulate, suite, case): case for case in suite.cases}
            runs = {}
            for i, made in enumerate(as_completed(flights), 1):
                case, problem = flights[made], made.result()
                tell(f"flight {i} of {len(flights)}: {case.name}: {problem or 'there'}")
                for variant in suite.variants:
                    if problem is None:
                        runs[pool.submit(measure, suite, case, variant)] = (case, variant)
                    else:
                        _write_failure(suite.result(case, variant), f"no flight: {problem}")
            for i, done in enumerate(as_completed(runs), 1):
                case, variant = runs[done]
                done.result()
                tell(f"run {i} of {len(runs)}: {variant} on {case.name}")
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return {
        variant: {case.name: _known(suite.result(case, variant)) for case in suite.cases}
        for variant in suite.variants
    }


def measure_speed(suite: Suite, tell: Told) -> dict[str, dict[str, Any]]:
    """Run `queuetail bench`, with nothing else running; return its figures where there is one."""
    results = {}
    for name, (scenario, seconds) in SPEED_FLIGHTS.items():
        case = next((c for c in suite.cases if c.name == scenario), None)
        flight = flight_of(suite, case) if case is not None else None
        if flight is None or not (flight / "flight.mp4").is_file():
            continue
        target = suite.out / f"{name}.json"
        tell(f"speed on {scenario}")
        files = [str(flight / "flight.mp4"), "--telemetry", str(flight / "telemetry.csv")]
        files += ["--site", str(flight / "site.toml")]
        options = ["--seconds", f"{seconds:g}"]
        command = [sys.executable, "-m", "queuetail.cli", "bench", *files, *options]
        problem = _do([*command, "--json", str(target)], alone=True)
        shown = shlex.join(["queuetail", "bench", *files, *options]).replace(f"{ROOT}/", "")
        results[name] = {"error": problem} if problem else {**_known(target), "command": shown}
    return results


def simulator_key() -> str:
    """Return what changes with the simulator."""
    return _digest(p.read_bytes() for p in sorted((SOURCE / "sim").glob("*.py")))


def run_key() -> str:
    """Return what changes with the code under test."""
    files = sorted(SOURCE.rglob("*.py"))
    ours = [p for p in files if p.relative_to(SOURCE).parts[0] not in BESIDE]
    script = Path(__file__).with_name("one_run.py")
    return _digest(p.read_bytes() for p in [*ours, script])


def flight_key(flight: Path) -> str:
    """Return what changes with a flight; of the video only its size, for speed."""
    names = ("truth.csv", "vehicles.csv", "road.csv", "telemetry.csv", "site.toml")
    size = (flight / "flight.mp4").stat().st_size
    return _digest([*((flight / name).read_bytes() for name in names), str(size).encode()])


def _digest(parts: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()


def _known(path: Path) -> dict[str, Any]:
    """Return a JSON file's record; nothing where there is none or it was cut off in writing."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (FileNotFoundError, ValueError):
        return {}


def _write_failure(path: Path, problem: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"error": problem}) + "\n", encoding="utf-8")


def _do(command: list[str], alone: bool = False) -> str | None:
    """Run a command to its end; return its last line of complaint where it fails."""
    environment = os.environ if alone else {**os.environ, **ONE_THREAD}
    try:
        done = subprocess.run(
            command,
            check=False,
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
            env=environment,
            cwd=ROOT,
        )
    except subprocess.TimeoutExpired:
        return f"not done after {PATIENCE_S:.0f} s"
    if done.returncode == 0:
        return None
    said = [line for line in done.stderr.splitlines() if line.strip()]
    return said[-1].strip() if said else f"ended with {done.returncode}"


def main() -> int:
    """Do as the module says; 1 where a scenario failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scenarios", nargs="*", type=Path, help="default: benchmarks/scenarios")
    parser.add_argument("--quick", action="store_true", help=", ".join(QUICK))
    parser.add_argument("--random", nargs="+", type=int, default=[], metavar="SEED")
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    parser.add_argument("--flights", type=Path, help="flights simulated before, by scenario name")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "benchmark")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--doc", type=Path, help="rewrite this page's tables; default: print them")
    parser.add_argument("--no-speed", action="store_true", help="leave queuetail bench out")
    a = parser.parse_args()
    paths = a.scenarios or [p for p in SCENARIOS.glob("*.toml") if not a.quick or p.stem in QUICK]

    def tell(text: str) -> None:
        print(f"{perf_counter() - started:6.0f} s  {text}", file=sys.stderr, flush=True)

    started = perf_counter()
    try:
        flights = a.flights.resolve() if a.flights else None
        cases = cases_of([p.resolve() for p in paths], a.random)
        suite = Suite(a.out.resolve(), cases, tuple(a.variants), flights)
        figures = go(suite, a.workers, tell)
        speed = {} if a.no_speed else measure_speed(suite, tell)
    except InputError as error:
        print(f"suite: {error}", file=sys.stderr)
        return 2
    text = suite_text(figures, speed)
    if a.doc:
        rewrite(a.doc, text)
    else:
        print(text)
    return int(any("error" in r for by_name in figures.values() for r in by_name.values()))


if __name__ == "__main__":
    sys.exit(main())
