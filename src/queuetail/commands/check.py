"""`check`: how far off pixels are placed and speeds are measured, and what mends it."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from queuetail.commands import Commands

if TYPE_CHECKING:
    from queuetail.accuracy.improve import Improvement
    from queuetail.accuracy.points import Errors
    from queuetail.accuracy.speed import SpeedCheck
    from queuetail.check import DrivenSpeed
    from queuetail.config import Site


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    check = commands.add_parser("check", help="compare placed pixels and speeds with true ones")
    check.add_argument(
        "source",
        type=Path,
        metavar="SOURCE",
        help="a video; the folder of a run, for --speed; or a table of places measured already",
    )
    check.add_argument(
        "points",
        type=Path,
        metavar="POINTS.csv",
        nargs="?",
        help="t_s, u_px, v_px, lat, lon of points whose true place is known",
    )
    check.add_argument("--telemetry", type=Path, metavar="FILE", help="the video's flight log")
    check.add_argument("--site", type=Path, metavar="SITE.toml", help="lens, constants, offsets")
    check.add_argument(
        "--improve", action="store_true", help="find offsets of heading, pitch and height"
    )
    check.add_argument(
        "--write", type=Path, metavar="SITE.toml", help="write --site with the offsets there"
    )
    check.add_argument("--force", action="store_true", help="overwrite the file of --write")
    check.add_argument(
        "--speed",
        type=driven,
        action="append",
        metavar="ID=MPH",
        help="vehicle ID of the run drove at MPH; ID=MPH@FROM-TO: from one second to another",
    )
    check.set_defaults(command=_check)


def driven(text: str) -> DrivenSpeed:
    """Parse a vehicle's true speed."""
    from queuetail.check import parse_driven

    try:
        return parse_driven(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is no known speed; write it as 17=45 or 17=45@10-14"
        ) from None


def _check(a: argparse.Namespace) -> int:
    from queuetail.check import check_speeds
    from queuetail.config import Site, read_site
    from queuetail.errors import InputError

    if a.source.is_dir():
        if not a.speed:
            raise InputError(
                f"{a.source} is a folder: say which vehicle drove at which speed, as --speed 17=45"
            )
        for speed in check_speeds(a.source, a.speed):
            _print_speed(speed)
        return 0
    if a.speed:
        raise InputError(f"--speed needs the folder of a run, and {a.source} is none")
    if a.points is None:
        return _check_table(a.source)
    if a.write is not None and a.write.exists() and not a.force:
        raise InputError(f"{a.write} exists already: name another file, or say --force")
    return _check_points(a, read_site(a.site) if a.site else Site())


def _check_table(path: Path) -> int:
    from queuetail.accuracy.table import read_measured
    from queuetail.errors import InputError

    if path.suffix.lower() != ".csv":
        raise InputError(f"name the table of points after {path}: queuetail check VIDEO POINTS.csv")
    errors = read_measured(path)
    for number, placed in enumerate(errors.placed, 1):
        print(f"{placed.point.name or number!s:>8}  {placed.error_m:8.2f} m")
    print(_summary(errors))
    return 0


def _check_points(a: argparse.Namespace, site: Site) -> int:
    from queuetail.accuracy.improve import improve
    from queuetail.accuracy.points import measure
    from queuetail.accuracy.table import read_points
    from queuetail.check import improved_text, mappings_of, with_offsets
    from queuetail.errors import InputError
    from queuetail.site_editor import save

    points = read_points(a.points)
    mappings = mappings_of(points, a.source, a.telemetry, site)
    errors = measure(points, mappings)
    _print_errors(errors)
    if not a.improve and a.write is None:
        return 0
    try:
        found = improve(points, mappings)
    except ValueError as error:
        raise InputError(f"{a.points}: {error}") from None
    _print_improvement(found)
    keys = with_offsets(site.telemetry, found)
    for key, value in keys.items():
        print(f"  [telemetry] {key} = {value}")
    if a.write is None:
        return 0
    if not found.helps:
        raise InputError(f"{a.write} was not written: the offsets do not make the points better")
    text = a.site.read_text(encoding="utf-8-sig") if a.site else ""
    save(a.write, improved_text(text, keys), overwrite=a.force)
    print(f"{a.write} has these offsets")
    return 0


def _print_errors(errors: Errors) -> None:
    print("   point     t_s       u       v    error   beyond   right")
    for number, placed in enumerate(errors.placed, 1):
        point = placed.point
        print(
            f"{point.name or number!s:>8} {point.t_s:7.2f} {point.px[0]:7.1f} {point.px[1]:7.1f} "
            + (
                f"{placed.error_m:7.2f}m {placed.along_m:+7.2f}m {placed.across_m:+6.2f}m"
                if math.isfinite(placed.error_m)
                else "  looks at or above the horizon"
            )
        )
    print(_summary(errors))


def _summary(errors: Errors) -> str:
    count = len(errors.placed) - errors.unseen
    unseen = f", {errors.unseen} at or above the horizon" if errors.unseen else ""
    points = "1 point" if count == 1 else f"{count} points"
    return f"{points}: mean error {errors.mean_m:.2f} m, worst {errors.worst_m:.2f} m{unseen}"


def _print_improvement(found: Improvement) -> None:
    print()
    units = {"heading": "°", "pitch": "°", "height": " m"}
    for (name, unit), offset in zip(units.items(), found.offsets, strict=True):
        if offset.is_determined:
            print(f"  {name:8} {offset.value:+.2f}{unit} ± {offset.sigma:.2f}{unit}")
        else:
            print(
                f"  {name:8} not determined by these points: add some near and far, left and right"
            )
    print(
        f"  mean error {found.before.mean_m:.2f} m → {found.after.mean_m:.2f} m, "
        f"worst {found.before.worst_m:.2f} m → {found.after.worst_m:.2f} m"
    )
    if math.isfinite(found.held_out_m):
        print(f"  each point by the offsets of the others: mean error {found.held_out_m:.2f} m")
    for i in found.misfits:
        print(f"  point {i + 1} does not fit the others: look whether its place is right")


def _print_speed(check: SpeedCheck) -> None:
    from queuetail.config import MPS_PER_MPH

    measured, true = check.measured_mps / MPS_PER_MPH, check.true_mps / MPS_PER_MPH
    print(
        f"vehicle {check.track_id}: measured {measured:.1f} ± {check.spread_mps / MPS_PER_MPH:.1f} "
        f"mph, true {true:.1f} mph: {measured - true:+.1f} mph; "
        f"multiply by {check.factor:.3f} ({check.samples} samples over {check.duration_s:.1f} s)"
    )
