"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from types import ModuleType

from queuetail import __version__
from queuetail.commands import (
    INTERRUPTED,
    check,
    console,
    feeds,
    history,
    live,
    measured,
    onboard,
    recorded,
    replay,
    sign,
)
from queuetail.errors import InputError

GROUPS = (recorded, check, live, console, measured, replay, history, onboard, sign, feeds)


def main(argv: list[str] | None = None) -> int:
    """Run one command; return 0, or 2 with one sentence on standard error for bad input."""
    words = sys.argv[1:] if argv is None else argv
    # A companion computer has no memory for what other commands' parsers load, such as OpenCV.
    groups = (onboard,) if words[:1] == ["onboard"] else GROUPS
    try:
        arguments = parser(groups).parse_args(words)
        return int(arguments.command(arguments))
    except InputError as error:
        print(f"queuetail: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        sys.stderr.close()
        return 1


def parser(groups: Sequence[ModuleType] = GROUPS) -> argparse.ArgumentParser:
    """Return the parser of all commands; docs and tests read its options from here."""
    top = argparse.ArgumentParser(
        prog="queuetail", description="Where is the end of the traffic queue?"
    )
    top.add_argument("--version", action="version", version=f"queuetail {__version__}")
    commands = top.add_subparsers(required=True, metavar="COMMAND")
    for group in groups:
        group.add(commands)
    return top


if __name__ == "__main__":
    sys.exit(main())
