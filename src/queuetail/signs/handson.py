"""Hands-on work with one sign: what the commands `sign status`, `show`, `blank`, `simulate` do."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from time import monotonic
from typing import Any, TypeVar

from queuetail.config import read_site
from queuetail.errors import InputError
from queuetail.signs.agent import SignAgent
from queuetail.signs.client import Shown, SignClient
from queuetail.signs.faults import SignFault, short_errors
from queuetail.signs.messages import DISTANCE, fit, unshowable
from queuetail.signs.ntcip import INFINITE_MIN, SOURCES, ControlMode, Source
from queuetail.signs.records import Phases, as_text
from queuetail.signs.secrets import Secrets, read_secrets
from queuetail.signs.settings import SignSite, SignsSettings
from queuetail.signs.simulated import SimulatedSign
from queuetail.signs.snmp import Session

T = TypeVar("T")
BLANK_PRIORITY = 255  # an operator who blanks a sign means it
LOOK_S = 0.1


@dataclass(frozen=True, slots=True)
class Goal:
    """The sign that is meant: where it is, how to prove who we are, and its size if known."""

    address: str
    secrets: Secrets
    sign: SignSite | None
    settings: SignsSettings


def goal(address: str | None, site: Path | None, name: str | None, secrets: Path | None) -> Goal:
    """Return the sign of an address, or of a site file by its name; raises InputError."""
    sign, settings = (None, SignsSettings()) if site is None else _of_site(site, name)
    if address is None:
        if sign is None:
            raise InputError("say which sign: --to HOST[:PORT], or --site SITE.toml --sign NAME")
        if sign.address is None:
            raise InputError(f"{site}: sign '{sign.name}' has no address")
        address = sign.address
    if secrets is None and sign is not None and sign.secrets is not None:
        secrets = Path(sign.secrets)
    return Goal(address, read_secrets(secrets), sign, settings)


def _of_site(site: Path, name: str | None) -> tuple[SignSite, SignsSettings]:
    found = read_site(site)
    if not found.sign:
        raise InputError(f"{site} has no [[sign]]")
    names = ", ".join(sign.name for sign in found.sign)
    if name is None and len(found.sign) > 1:
        raise InputError(f"{site} has several signs: choose one with --sign ({names})")
    for sign in found.sign:
        if name in (None, sign.name):
            return sign, found.signs
    raise InputError(f"{site} has no sign '{name}'; it has {names}")


def phases_from(words: list[str]) -> Phases:
    """Return phases of words as they are typed: one a phase, lines apart by ' / '."""
    phases = tuple(tuple(line.strip() for line in word.split(" / ")) for word in words)
    if not phases or not any(any(lines) for lines in phases):
        raise InputError("say what to show: one TEXT a phase, with ' / ' between its lines")
    for lines in phases:
        for line in lines:
            if DISTANCE in line:
                raise InputError(f"{DISTANCE} is for a site file; write the distance itself")
            if sentence := unshowable(line):
                raise InputError(sentence)
    return phases


def status(of: Goal) -> Shown:
    """Return what a sign shows; raises InputError with why not."""
    return _with_client(of, 0, lambda client: client.status())


def show(of: Goal, phases: Phases, minutes: int, priority: int) -> Shown:
    """Show phases for minutes; raises InputError with why not."""
    sign = of.sign
    if sign is not None and fit(phases, sign.lines, sign.characters, sign.phases) != phases:
        raise InputError(f"the text does not fit on sign '{sign.name}', which has {sign.size}")
    if len(phases) > 2:
        raise InputError("a portable sign shows two phases at most (MUTCD 6F.60)")

    async def task(client: SignClient) -> Shown:
        default = sign.default if sign is not None else ()
        await client.prepare(default, of.settings.comm_loss_min if sign is not None else minutes)
        return await client.show(phases, minutes)

    return _with_client(of, priority, task)


def blank(of: Goal) -> Shown:
    """Blank a sign, whatever is on it; raises InputError with why not."""
    return _with_client(of, BLANK_PRIORITY, lambda client: client.show((), INFINITE_MIN))


def told(shown: Shown) -> str:
    """Return what a sign shows, in lines for a terminal."""
    sources = {int(source): text for source, text in SOURCES.items()}
    modes = {int(m): m.name.lower().replace("_", " ") for m in ControlMode}
    left = f"for {shown.minutes_left} more minute{'' if shown.minutes_left == 1 else 's'}"
    if shown.minutes_left == INFINITE_MIN:
        left = "until something else comes"
    who = sources.get(shown.source, sources[Source.OTHER])
    rows = {
        "shows": as_text(shown.phases),
        "since": f"put there by {who}, {left}",
        "control": modes.get(shown.control_mode, f"mode {shown.control_mode}"),
        "faults": "; ".join(short_errors(shown.errors)) or "none",
    }
    return "\n".join(f"{name:8} {text}" for name, text in rows.items())


def simulate(
    of: Goal | None,
    host: str,
    port: int,
    face: Path | None,
    duration_s: float | None,
    stopping: Event,
    tell: Callable[[str], None],
) -> None:
    """Be a sign until stopped: answer SNMP, draw the face into a file, tell what is shown."""
    sign = SimulatedSign()
    if of is not None and of.sign is not None:
        sign = SimulatedSign(of.sign.lines, of.sign.characters, of.sign.phases)
    secrets = of.secrets if of is not None else read_secrets(None)
    end_s = None if duration_s is None else monotonic() + duration_s
    with SignAgent(sign, port, host=host, secrets=secrets) as agent:
        tell(f"a simulated sign answers at {agent.address}; Ctrl-C ends it")
        before = ""
        while not stopping.wait(LOOK_S) and (end_s is None or monotonic() < end_s):
            text = agent.text()
            if text != before:
                before = text
                if face is not None:
                    _write(face, agent.face_png())
                tell(text)


def _write(face: Path, picture: bytes) -> None:
    """Write a picture so that a viewer never sees half of it."""
    beside = face.with_suffix(".part")
    try:
        beside.write_bytes(picture)
        beside.replace(face)
    except OSError as error:
        raise InputError(f"{face}: the face cannot be written ({error.strerror})") from None


def _with_client(of: Goal, priority: int, use: Callable[[SignClient], Coroutine[Any, Any, T]]) -> T:
    async def task() -> T:
        session = Session(of.address, of.secrets)
        number = of.sign.message_number if of.sign is not None else 1
        client = SignClient(session, number, priority, of.settings.phase_s)
        try:
            return await use(client)
        finally:
            client.close()

    try:
        return asyncio.run(task())
    except SignFault as fault:
        raise InputError(str(fault)) from None
