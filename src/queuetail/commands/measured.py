"""`simulate`, `evaluate` and `bench`: what queuetail is measured with."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

from queuetail.commands import Commands


def add(commands: Commands) -> None:
    """Add this module's commands to the parser."""
    _add_simulate(commands)
    _add_evaluate(commands)
    _add_bench(commands)


def _add_simulate(commands: Commands) -> None:
    simulate = commands.add_parser("simulate", help="make a flight whose truth is exact")
    simulate.add_argument(
        "scenario", type=Path, nargs="?", metavar="SCENARIO.toml", help="what to simulate"
    )
    simulate.add_argument("--out", type=Path, required=True, metavar="DIR", help="output folder")
    simulate.add_argument("--seed", type=seed, metavar="N", help="default: the scenario's own")
    simulate.add_argument(
        "--random",
        type=seed,
        metavar="SEED",
        help="draw a scenario instead of reading one",
    )
    simulate.set_defaults(command=_simulate)


def _simulate(arguments: argparse.Namespace) -> int:
    from queuetail.sim.simulate import command

    return command(arguments.scenario, arguments.out, arguments.seed, arguments.random)


def _add_evaluate(commands: Commands) -> None:
    evaluate = commands.add_parser("evaluate", help="measure a run against exact truth")
    evaluate.add_argument("run", type=Path, metavar="RUN_DIR", help="the folder that run wrote")
    evaluate.add_argument("truth", type=Path, metavar="TRUTH_DIR", help="as simulate writes it")
    evaluate.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    evaluate.set_defaults(command=_evaluate)


def _evaluate(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from queuetail.evaluate import evaluate, print_table, to_json, write_report
    from queuetail.files import write_text

    result = evaluate(arguments.run, arguments.truth)
    print_table(result, Console())
    write_report(result, arguments.run / "evaluation.html")
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(to_json(result), indent=2) + "\n")
    return 0


def _add_bench(commands: Commands) -> None:
    bench = commands.add_parser("bench", help="measure the presets' speed beside decoding alone")
    bench.add_argument(
        "video", type=Path, nargs="?", metavar="VIDEO", help="default: the bundled flight"
    )
    bench.add_argument("--telemetry", type=Path, metavar="FILE", help="its flight log, as for run")
    bench.add_argument("--site", type=Path, metavar="SITE.toml", help="the road, lens and limits")
    bench.add_argument(
        "--seconds",
        type=float,
        default=30.0,
        metavar="S",
        help="how much of the video (default: %(default)g)",
    )
    bench.add_argument(
        "--turns",
        type=int,
        default=3,
        metavar="N",
        help="measure each method so often, in alternating order (default: %(default)s)",
    )
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    bench.set_defaults(command=_bench)


def _bench(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from queuetail.bench import bench, to_json
    from queuetail.bench_table import print_tables
    from queuetail.files import write_text

    a = arguments
    with Console(stderr=True).status("opening") as status:
        result = bench(a.video, a.telemetry, a.site, a.seconds, a.turns, status.update)
    print_tables(result)
    if arguments.json is not None:
        write_text(arguments.json, json.dumps(to_json(result), indent=2) + "\n")
    return 0


def seed(text: str) -> int:
    """Parse a seed, which for the random generators is a whole number from 0 to 2147483647."""
    if not text.isascii() or not text.isdigit() or int(text) >= 2**31:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to {2**31 - 1}")
    return int(text)
