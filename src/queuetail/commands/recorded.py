"""`run`, `locate` and `export`: what a user does with a recorded flight."""

from __future__ import annotations

import argparse
import signal
from pathlib import Path

from queuetail.commands import INTERRUPTED, Commands


def add(commands: Commands) -> None:
    """Add this module's commands to the parser."""
    _add_run(commands)
    _add_locate(commands)
    _add_export(commands)


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


def pixel(text: str) -> tuple[float, float]:
    """Parse `U,V`."""
    try:
        u, v = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"'{text}' is not a pixel; write it as 640,360") from None
    return u, v
