"""`sign`: hands-on work with warning signs, a simulated one, and arming their control."""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path

from queuetail.commands import Commands
from queuetail.commands.live import port, seconds
from queuetail.errors import InputError

ACTIONS = ("status", "show", "blank", "simulate", "arm", "disarm")
HANDS_ON_PRIORITY = 200  # above that of automatic control, so that it leaves the message alone


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    sign = commands.add_parser("sign", help="show, blank or simulate a warning sign; arm control")
    sign.add_argument("action", choices=ACTIONS, metavar="ACTION", help=", ".join(ACTIONS))
    sign.add_argument(
        "text", nargs="*", metavar="TEXT", help="show: one a phase, ' / ' between its lines"
    )
    sign.add_argument("--to", metavar="HOST[:PORT]", help="the sign's NTCIP controller")
    sign.add_argument("--site", type=Path, metavar="SITE.toml", help="take the sign from this file")
    sign.add_argument("--sign", metavar="NAME", help="which sign of the site file")
    sign.add_argument(
        "--secrets", type=Path, metavar="FILE", help="its community or user (mode 0600)"
    )
    sign.add_argument(
        "--minutes", type=int, default=5, metavar="N", help="show: for so long (default: 5)"
    )
    sign.add_argument(
        "--priority",
        type=int,
        default=HANDS_ON_PRIORITY,
        metavar="N",
        help="show: 1 to 255 (default: 200)",
    )
    sign.add_argument(
        "--port", type=port, default=1161, metavar="N", help="simulate: UDP port (default: 1161)"
    )
    sign.add_argument(
        "--host", default="127.0.0.1", metavar="ADDRESS", help="simulate: listen there"
    )
    sign.add_argument("--face", type=Path, metavar="FILE.png", help="simulate: draw the face there")
    sign.add_argument("--duration", type=seconds, metavar="S", help="simulate: end after so long")
    sign.add_argument("--run", type=Path, metavar="RUN_DIR", help="arm, disarm: the live run")
    sign.add_argument("--who", metavar="NAME", help="arm, disarm: on whose word (default: you)")
    sign.set_defaults(command=_sign)


def _sign(arguments: argparse.Namespace) -> int:
    if arguments.text and arguments.action != "show":
        raise InputError(f"sign {arguments.action} takes no text; only show does")
    if arguments.action in ("arm", "disarm"):
        return _switch(arguments)
    if arguments.action == "simulate":
        return _simulate(arguments)
    from queuetail.signs import handson

    of = handson.goal(arguments.to, arguments.site, arguments.sign, arguments.secrets)
    if arguments.action == "status":
        shown = handson.status(of)
    elif arguments.action == "blank":
        shown = handson.blank(of)
    else:
        if not 1 <= arguments.minutes < 65535 or not 1 <= arguments.priority <= 255:
            raise InputError("--minutes is 1 to 65534, --priority 1 to 255")
        phases = handson.phases_from(arguments.text)
        shown = handson.show(of, phases, arguments.minutes, arguments.priority)
    print(handson.told(shown))
    return 0


def _simulate(arguments: argparse.Namespace) -> int:
    from queuetail.signs import handson

    stopping = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stopping.set())
    of = None
    if arguments.site or arguments.secrets:
        here = f"{arguments.host}:{arguments.port or 1}"
        of = handson.goal(here, arguments.site, arguments.sign, arguments.secrets)
    handson.simulate(
        of,
        arguments.host,
        arguments.port,
        arguments.face,
        arguments.duration,
        stopping,
        lambda text: print(text, flush=True),
    )
    return 0


def _switch(arguments: argparse.Namespace) -> int:
    from queuetail.signs.arming import ask, operator

    if arguments.run is None:
        raise InputError("say which live run: --run RUN_DIR, the folder that it writes into")
    state = ask(arguments.run, arguments.action == "arm", arguments.who or operator())
    print(f"{'armed' if state.armed else 'disarmed'} by {state.who} at {state.since_utc}")
    return 0
