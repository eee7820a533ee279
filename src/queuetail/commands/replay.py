"""`replay`: a recording through the pipeline again."""

from __future__ import annotations

import argparse
from pathlib import Path

from queuetail.commands import Commands

SAME, DIFFERENT = 0, 1


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    from queuetail.presets import PRESETS

    replay = commands.add_parser(
        "replay", help="put a recording of live through the pipeline again, and compare"
    )
    replay.add_argument("folder", type=Path, metavar="DIR", help="what live --record wrote")
    replay.add_argument(
        "--out", type=Path, metavar="DIR", help="write the files of a run there, as run does"
    )
    replay.add_argument(
        "--preset", choices=sorted(PRESETS), help="the method (default: the recorded one)"
    )
    replay.add_argument("--no-video", action="store_true", help="leave annotated.mp4 out (faster)")
    replay.set_defaults(command=_replay)


def _replay(arguments: argparse.Namespace) -> int:
    from rich.console import Console

    from queuetail.live.replay import replay, summary

    with Console(stderr=True).status("replaying") as status:
        result = replay(
            arguments.folder,
            arguments.out,
            arguments.preset,
            with_video=not arguments.no_video,
            progress=lambda seen: status.update(f"replaying, at {seen.t_s:.1f} s"),
        )
    for line in summary(result):
        print(line)
    if arguments.out is not None:
        print(f"results in {arguments.out}/ (open {arguments.out}/report.html)")
    return SAME if result.is_same else DIFFERENT
