"""The command line: parse, call, print."""

from __future__ import annotations

import argparse
import sys

from queuetail import __version__
from queuetail.commands import INTERRUPTED, measured, recorded, replay
from queuetail.errors import InputError

GROUPS = (recorded, measured, replay)


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
    for group in GROUPS:
        group.add(commands)
    return top


if __name__ == "__main__":
    sys.exit(main())
