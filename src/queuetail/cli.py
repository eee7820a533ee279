"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from queuetail import __version__
from queuetail.errors import InputError

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

INTERRUPTED = 130  # what a shell expects after Ctrl-C


def main(argv: list[str] | None = None) -> int:
    """Run one command; return 0, or 2 with one sentence on standard error for bad input."""
    arguments = parser().parse_args(argv)
    try:
        return int(arguments.command(arguments))
    except InputError as error:
        print(f"queuetail: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 1


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands; docs and tests read its options from here."""
    top = argparse.ArgumentParser(
        prog="queuetail", description="Where is the end of the traffic queue?"
    )
    top.add_argument("--version", action="version", version=f"queuetail {__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    _add_run(commands)
    _add_locate(commands)
    _add_export(commands)
    _add_simulate(commands)
    _add_evaluate(commands)
    _add_bench(commands)
    return top


def _add_run(commands: Commands) -> None:
    from queuetail.presets import DEFAULT_PRESET, PRESETS

    run = commands.add_parser("run", help="find the end of the queue in a recorded flight")
    run.add_argument("video", type=Path, metavar="VIDEO", help="the recording, any FFmpeg format")
    run.add_argument(
        "--telemetry",
        type=Path,
        metavar="FILE",
        help="its flight log, in any format of docs/telemetry.md (default: beside or in VIDEO)",
    )
    run.add_argument("--site", type=Path, metavar="SITE.toml", help="the road, lens and limits")
    run.add_argument(
        "--preset",
        choices=sorted(PRESETS),
        default=DEFAULT_PRESET,
        help="the method (default: %(default)s)",
    )
    run.add_argument(
        "--out", type=Path, metavar="DIR", help="output folder (default: out/<video name>)"
    )
    run.add_argument("--no-video", action="store_true", help="leave annotated.mp4 out (faster)")
    run.set_defaults(command=_run)


def _run(arguments: argparse.Namespace) -> int:
    from queuetail.run import run
    from queuetail.summary import RunProgress, print_summary

    out = arguments.out or Path("out") / arguments.video.stem
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # a stopped service ends like Ctrl-C
    with RunProgress(arguments.video.name) as progress:
        result = run(
            arguments.video,
            arguments.telemetry,
            arguments.site,
            arguments.preset,
            out,
            with_video=not arguments.no_video,
            opened=progress.opened,
            progress=progress.update,
        )
        if not result.interrupted:
            progress.done()
    print_summary(result)
    return INTERRUPTED if result.interrupted else 0


def _add_locate(commands: Commands) -> None:
    locate = commands.add_parser("locate", help="print the latitude and longitude of a pixel")
    locate.add_argument("source", type=Path, metavar="SOURCE", help="a video, or a DJI still")
    locate.add_argument("px", type=pixel, metavar="U,V", help="pixel, right and down from top left")
    locate.add_argument(
        "--time", type=float, default=0.0, metavar="S", help="seconds into the video (default: 0)"
    )
    locate.add_argument("--telemetry", type=Path, metavar="FILE", help="the video's flight log")
    locate.add_argument("--site", type=Path, metavar="SITE.toml", help="lens and constants")
    locate.set_defaults(command=_locate)


def _locate(arguments: argparse.Namespace) -> int:
    from queuetail.locate import locate

    place = locate(
        arguments.source, arguments.px, arguments.time, arguments.telemetry, arguments.site
    )
    if place.lat_deg is None:
        east, north = place.enu_m
        print(f"{east:.2f} m east, {north:.2f} m north of the control points' origin", end="")
    else:
        print(f"{place.lat_deg:.7f},{place.lon_deg:.7f}", end="")
    print(f"  ± {place.sigma_m:.1f} m")
    return 0


def _add_export(commands: Commands) -> None:
    export = commands.add_parser("export", help="write a run's end-of-queue track for a GIS")
    export.add_argument("run", type=Path, metavar="RUN_DIR", help="the folder that run wrote")
    export.add_argument(
        "--format",
        choices=("geojson", "gpx", "kml"),
        default="geojson",
        help="default: %(default)s",
    )
    export.add_argument("--out", type=Path, metavar="FILE", help="default: RUN_DIR/eoq.<format>")
    export.set_defaults(command=_export)


def _export(arguments: argparse.Namespace) -> int:
    from queuetail.export import export

    out = arguments.out or arguments.run / f"eoq.{arguments.format}"
    export(arguments.run, arguments.format, out)
    print(out)
    return 0


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


def pixel(text: str) -> tuple[float, float]:
    """Parse `U,V`."""
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a pixel; write it as 640,360") from None
    return u, v


def seed(text: str) -> int:
    """Parse a seed, which for the random generators is a whole number from 0 to 2147483647."""
    if not text.isascii() or not text.isdigit() or int(text) >= 2**31:
        raise argparse.ArgumentTypeError(f"'{text}' is not a whole number from 0 to {2**31 - 1}")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
