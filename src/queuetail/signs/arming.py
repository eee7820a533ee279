"""Who may let queuetail control signs, and since when: off until an operator arms it.

A live run owns the switch.  A console calls :meth:`Arming.arm` and :meth:`Arming.disarm`; a command
leaves a request in the run's folder, which the run takes and answers, so that a run that is dead
cannot be armed, and a request from before the run began is never taken.
"""

from __future__ import annotations

import getpass
import json
import os
import socket
import uuid
from collections.abc import Callable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Lock
from time import monotonic, sleep

from queuetail.errors import InputError

STATUS_FILE, REQUEST_FILE = "sign-control.json", "sign-control.request.json"
ANSWER_S, POLL_S = 5.0, 0.05
LARGEST_REQUEST = 4096

Noted = Callable[[str, dict[str, object]], None]


@dataclass(frozen=True, slots=True)
class ArmState:
    """Whether signs are controlled automatically, on whose word, since when and why."""

    armed: bool
    who: str
    since_utc: str
    reason: str


def operator() -> str:
    """Return who runs this program: user and machine."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a user without a name
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()}"


class Arming:
    """The switch of one live run; safe from any thread."""

    def __init__(self, folder: Path, noted: Noted, why_not: Callable[[], str] = lambda: "") -> None:
        """Start disarmed; `noted` is told every change, `why_not` says why arming is impossible."""
        self._folder, self._noted, self._why_not = folder, noted, why_not
        self._lock = Lock()
        self._request = folder / REQUEST_FILE
        self._request.unlink(missing_ok=True)  # whatever was asked of an earlier run
        self._answered, self._refusal = "", ""
        self._state = ArmState(False, "", _now(), "a run starts disarmed")
        self._write()

    @property
    def state(self) -> ArmState:
        """How the switch stands."""
        with self._lock:
            return self._state

    @property
    def armed(self) -> bool:
        """Whether signs may be controlled."""
        return self.state.armed

    def arm(self, who: str, reason: str = "armed by an operator") -> ArmState:
        """Let signs be controlled, on the word of `who`; raises InputError if that cannot be."""
        if not who.strip():
            raise InputError("arming needs the name of who does it")
        if refusal := self._why_not():
            raise InputError(refusal)
        return self._change(ArmState(True, who.strip(), _now(), reason))

    def disarm(self, who: str, reason: str = "disarmed by an operator") -> ArmState:
        """Leave the signs alone from now on; they go to their defaults."""
        return self._change(ArmState(False, who, _now(), reason))

    def poll(self) -> None:
        """Take a command's request, if there is one; what is not one is thrown away."""
        if not self._request.exists():
            return
        try:
            status = self._request.stat()
            text = self._request.read_text(encoding="utf-8")[:LARGEST_REQUEST]
            self._request.unlink()
            asked = json.loads(text)
            wanted, who, ticket = asked["armed"], str(asked["who"]), str(asked["ticket"])
        except (OSError, ValueError, KeyError, TypeError):
            self._request.unlink(missing_ok=True)
            return
        if status.st_uid not in (0, os.getuid()) or not who.strip():
            return
        self._answered, self._refusal = ticket, ""
        if wanted is not True:
            self.disarm(who, "disarmed by command")
            return
        try:
            self.arm(who, "armed by command")
        except InputError as error:
            self._refusal = str(error)
            self._write()

    def _change(self, state: ArmState) -> ArmState:
        with self._lock:
            self._state = state
        self._noted("armed" if state.armed else "disarmed", asdict(state))
        self._write()
        return state

    def _write(self) -> None:
        answer = {"answered": self._answered, "refusal": self._refusal}
        record = {**asdict(self.state), "pid": os.getpid(), **answer}
        try:
            _replace(self._folder / STATUS_FILE, record)
        except OSError:
            return  # a full disk must not keep anybody from disarming


def ask(folder: Path, armed: bool, who: str) -> ArmState:
    """Ask the live run that writes into `folder` to arm or disarm; raises InputError."""
    status = folder / STATUS_FILE
    if not status.exists():
        raise InputError(
            f"{folder} is not the folder of a live run with signs: it has no {STATUS_FILE}"
        )
    ticket = uuid.uuid4().hex
    try:
        _replace(folder / REQUEST_FILE, {"armed": armed, "who": who, "ticket": ticket})
    except OSError as error:
        raise InputError(f"{folder}: the request cannot be written ({error.strerror})") from None
    end_s = monotonic() + ANSWER_S
    while monotonic() < end_s:
        answer = _read(status)
        if answer.get("answered") == ticket:
            if refusal := answer.get("refusal"):
                raise InputError(str(refusal))
            return ArmState(
                bool(answer.get("armed")),
                str(answer.get("who")),
                str(answer.get("since_utc")),
                str(answer.get("reason")),
            )
        sleep(POLL_S)
    (folder / REQUEST_FILE).unlink(missing_ok=True)
    raise InputError(
        f"no live run answers in {folder}: it has ended, or runs under another user; "
        "signs that it showed something on go to their defaults by themselves"
    )


def _read(path: Path) -> dict[str, object]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def _replace(path: Path, record: dict[str, object]) -> None:
    """Write a file so that readers see the old or the new one, never a half."""
    beside = path.with_suffix(".new")
    beside.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    beside.replace(path)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")
