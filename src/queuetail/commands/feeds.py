"""`feed`: what a finished run would have told others, and whether a site's feeds are well."""

from __future__ import annotations

import argparse
import logging
import sys
from pathlib import Path
from time import monotonic, sleep

from queuetail.commands import Commands

ACTIONS = ("print", "check")
NAMES = ("wzdx", "cifs", "cap", "cot", "tim", "denm", "state")
POLL_S = 0.05


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    feed = commands.add_parser("feed", help="print a run as a feed; check a site file's feeds")
    feed.add_argument("action", choices=ACTIONS, metavar="ACTION", help=", ".join(ACTIONS))
    feed.add_argument(
        "path", type=Path, metavar="PATH", help="print: the run's folder; check: the site file"
    )
    feed.add_argument(
        "--format", choices=NAMES, default="wzdx", help="print: which (default: %(default)s)"
    )
    feed.add_argument(
        "--time", type=float, metavar="S", help="print: as of then (default: the last queue)"
    )
    feed.add_argument("--site", type=Path, metavar="SITE.toml", help="print: with these settings")
    feed.add_argument(
        "--timeout", type=float, default=5.0, metavar="S", help="check: wait so long (default: 5)"
    )
    feed.set_defaults(command=_feed)


def _feed(arguments: argparse.Namespace) -> int:
    a = arguments
    return _check(a.path, a.timeout) if a.action == "check" else _print(a)


def _print(a: argparse.Namespace) -> int:
    from queuetail.config import read_site
    from queuetail.feeds.finished import FORMATS, moment_of

    site = read_site(a.site) if a.site else None
    sys.stdout.write(FORMATS[a.format](moment_of(a.path, a.time, site)).decode())
    return 0


def _check(site_file: Path, timeout_s: float) -> int:
    """Offer every feed an unknown state, and say how it went; nobody is told of a queue."""
    from queuetail.config import read_site
    from queuetail.errors import InputError
    from queuetail.feeds.build import build_feeds
    from queuetail.feeds.trial import unknown_answer
    from queuetail.live.records import OutletState

    site = read_site(site_file)
    feeds = build_feeds(site)
    if not feeds.sinks:
        raise InputError(f"{site_file} switches no feed on: give it a table such as [feeds.wzdx]")
    logging.disable(logging.WARNING)  # each feed's fault is told once, below
    try:
        for sink in feeds.sinks:
            sink.offer(unknown_answer(site))
        end_s = monotonic() + timeout_s
        while monotonic() < end_s and any(s.health().waiting for s in feeds.sinks):
            sleep(POLL_S)
        found = [sink.health() for sink in feeds.sinks]
    finally:
        feeds.close()
        logging.disable(logging.NOTSET)
    bad = 0
    for health in found:
        is_well = health.state is OutletState.OK and not health.waiting and not health.dropped
        bad += not is_well
        words = "told that the state is unknown" if health.delivered else "ready"
        print(f"{health.name}: {words if is_well else health.last_error or 'no answer in time'}")
    for path in feeds.pages:
        print(f"served by queuetail live at {path}")
    return 1 if bad else 0
