"""Signs as a sink of a live run: advice several times a second, and armed control of the signs.

Everything slow happens in a thread of its own; `offer` only keeps the newest answer.  Automatic
control is off until an operator arms it, and disarms itself when nothing is known for long.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Lock, Thread
from time import monotonic

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.live.records import OutletHealth, OutletState, Published
from queuetail.signs.advice import Adviser, Answers
from queuetail.signs.arming import Arming
from queuetail.signs.client import SignClient
from queuetail.signs.faults import SignFault
from queuetail.signs.holds import Holds
from queuetail.signs.line import LineReport, SignLine
from queuetail.signs.multi import build
from queuetail.signs.records import Decision, as_text
from queuetail.signs.secrets import read_secrets
from queuetail.signs.settings import SignSite
from queuetail.signs.snmp import Session
from queuetail.types import GroundMapping

TICK_S = 0.2
CLOSE_S = 5.0  # for giving the signs back at the end
LOG_FILE = "signs.jsonl"
LOG = logging.getLogger(__name__)


class SignController:
    """The live sink (`live.outlet.LiveSink`) that advises on signs and, armed, controls them."""

    def __init__(
        self,
        site: Site,
        folder: Path,
        *,
        dry_run: bool = False,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Check everything and start disarmed; raises InputError for addresses or secrets."""
        self._settings = site.signs
        self._dry_run = dry_run or site.signs.dry_run
        self._adviser = Adviser(site.signs, site.sign, site.site.posted_speed_mph)
        self._clients = {
            sign.name: _client(sign, site, environment)
            for sign in site.sign
            if sign.address is not None and not self._dry_run
        }
        self._signs = {sign.name: sign for sign in site.sign}
        self._holds = Holds()
        if not self._holds.take(f"folder {folder.resolve()}"):
            raise InputError(f"another live run keeps its signs in {folder}: choose another --out")
        self.folder, self._log = folder, folder / LOG_FILE
        self._lock = Lock()
        self._newest: Answers | None = None
        self._decisions: tuple[Decision, ...] = ()
        self._reports: tuple[LineReport, ...] = ()
        self._error = ""
        self._was_armed, self._known_s = False, monotonic()
        self._closing = Event()
        self.arming = Arming(folder, self._note, self._why_not)
        self._thread = Thread(target=self._work, name="signs", daemon=True)
        self._thread.start()

    @property
    def signs(self) -> tuple[SignSite, ...]:
        """The signs that are advised on, as the run's site file has them."""
        return tuple(self._signs.values())

    @property
    def dry_run(self) -> bool:
        """Whether nothing is ever sent."""
        return self._dry_run

    @property
    def told(self) -> str:
        """What to say of the signs when a run begins."""
        if self._dry_run:
            return f"signs: a dry run, nothing is sent; {self._log} tells what would be"
        if not self._clients:
            return f"signs: advice only, as none has an address; {self._log} has it"
        arm = f"queuetail sign arm --run {self.folder}"
        return f"signs: nothing is sent until armed, on the console or by: {arm}"

    def offer(self, published: Published) -> None:
        """Take an answer and return at once; only the newest one counts."""
        seen, health = published.observation, published.health
        origin = seen.mapping.origin if isinstance(seen.mapping, GroundMapping) else None
        lag_s = (health.latency_p99_ms or 0.0) / 1000.0  # it is as old as its picture
        answers = Answers(seen.states, seen.approaches, origin, monotonic() - lag_s)
        with self._lock:
            self._newest = answers

    def health(self) -> OutletHealth:
        """Return how the signs stand, all together."""
        with self._lock:
            reports, error = self._reports, self._error
        if not self._thread.is_alive() and not self._closing.is_set():
            error = "the signs' thread has died"
        state, last_error = OutletState.OFF, error
        for worst in (OutletState.FAILED, OutletState.RETRYING, OutletState.OK):
            if any(report.state is worst for report in reports):
                state = worst
                break
        for report in reports:
            last_error = last_error or (report.last_error and f"{report.name}: {report.last_error}")
        ages = [report.shown_age_s for report in reports if report.shown_age_s is not None]
        return OutletHealth(
            name="signs",
            state=OutletState.FAILED if error else state,
            delivered=sum(report.delivered for report in reports),
            waiting=sum(report.state is OutletState.RETRYING for report in reports),
            last_error=last_error,
            delivery_age_s=max(ages, default=None),
        )

    def decisions(self) -> tuple[Decision, ...]:
        """Return what every sign should show now, with reasons; for the console."""
        with self._lock:
            return self._decisions

    def reports(self) -> tuple[LineReport, ...]:
        """Return how every sign under control stands; for the console."""
        with self._lock:
            return self._reports

    def close(self) -> None:
        """Disarm, give the signs back within seconds, and stop."""
        if self._closing.is_set():
            return
        if self.arming.armed:
            self.arming.disarm("queuetail", "the run ended")
        self._closing.set()
        self._thread.join(CLOSE_S + 1.0)
        if self._thread.is_alive():
            LOG.warning("the signs were left behind: they blank themselves when durations end")
        self._holds.close()

    def _why_not(self) -> str:
        """Say why control cannot be armed; a run that was armed keeps its signs until it ends."""
        addresses = {s.name: s.address for s in self._signs.values() if s.address is not None}
        if not addresses:
            return "no sign of the site file has an address: there is nothing to control"
        for name in self._clients:
            if not self._holds.take(f"sign {addresses[name].lower()}"):
                return (
                    f"sign '{name}' at {addresses[name]} is controlled by another live run on this "
                    "machine: end that first"
                )
        return ""

    def _work(self) -> None:
        asyncio.run(self._run())

    async def _run(self) -> None:
        lines = [
            SignLine(
                self._signs[name],
                self._settings,
                client,
                lambda: self.arming.armed,
                self._note,
            )
            for name, client in self._clients.items()
        ]
        tasks = [asyncio.create_task(line.keep()) for line in lines]
        while not self._closing.is_set():
            try:
                self.arming.poll()
                self._watch(lines, monotonic())
                self._advise(lines, monotonic())
                self._error = ""
            except Exception as error:  # control must not go on with yesterday's decisions
                self._error = f"sign advice failed: {type(error).__name__}: {error}"
                LOG.exception("sign advice failed")
                if self.arming.armed:
                    self.arming.disarm("queuetail", self._error)
            await asyncio.sleep(TICK_S)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self._give_back(lines)

    def _watch(self, lines: list[SignLine], now_s: float) -> None:
        """Pass the switch on to the signs, and disarm when nothing has been known for long."""
        armed = self.arming.armed
        if armed != self._was_armed:
            self._was_armed, self._known_s = armed, now_s
            for line in lines:
                line.wake()
        if self._adviser.knows:
            self._known_s = now_s
        elif armed and now_s - self._known_s > self._settings.disarm_after_s:
            why = f"no known answer for {self._settings.disarm_after_s:g} s"
            self.arming.disarm("queuetail", why)

    def _advise(self, lines: list[SignLine], now_s: float) -> None:
        """Decide for every sign, tell the signs, and log what changed."""
        with self._lock:
            answers, self._newest = self._newest, None
        decisions = self._adviser.advise(answers, now_s)
        before = {decision.sign: decision for decision in self._decisions}
        by_name = {decision.sign: decision for decision in decisions}
        for line in lines:
            line.decide(by_name[line.site.name])
        for decision in decisions:
            if _differs(before.get(decision.sign), decision):
                self._note("decision", _record(decision, self.arming.armed))
                self._note_unsent(decision)
        with self._lock:
            self._decisions = decisions
            self._reports = tuple(line.report() for line in lines)

    def _note_unsent(self, decision: Decision) -> None:
        """In a dry run, log what would be sent."""
        sign = self._signs[decision.sign]
        if not self._dry_run or not decision.changed or sign.address is None:
            return
        settings = self._settings
        record = {
            "sign": sign.name,
            "address": sign.address,
            "multi": build(decision.phases, settings.phase_s),
            "minutes": settings.duration_min,
            "priority": settings.priority,
        }
        self._note("would_send", record)

    async def _give_back(self, lines: list[SignLine]) -> None:
        async def one(line: SignLine) -> None:
            try:
                await asyncio.wait_for(line.release(), CLOSE_S)
            except (SignFault, TimeoutError) as fault:
                self._note("failed", {"sign": line.site.name, "error": str(fault) or "timed out"})

        await asyncio.gather(*(one(line) for line in lines), return_exceptions=True)
        for client in self._clients.values():
            client.close()

    def _note(self, event: str, record: dict[str, object]) -> None:
        """Write a line of the log; a full disk must not stop the signs."""
        utc = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = json.dumps({"utc": utc, "event": event, **record})
        try:
            with self._log.open("a", encoding="utf-8") as file:
                file.write(line + "\n")
        except OSError as error:
            LOG.warning("%s cannot be written: %s", self._log, error.strerror)


def _client(sign: SignSite, site: Site, environment: Mapping[str, str] | None) -> SignClient:
    try:
        secrets = read_secrets(Path(sign.secrets) if sign.secrets else None, environment)
        session = Session(sign.address or "", secrets)
    except InputError as error:
        raise InputError(f"sign '{sign.name}': {error}") from None
    settings = site.signs
    return SignClient(session, sign.message_number, settings.priority, settings.phase_s)


def _differs(before: Decision | None, now: Decision) -> bool:
    """Tell whether a decision is worth a line in the log."""
    if before is None or now.changed or before.state is not now.state:
        return True
    fits = [d.placement.fit if d.placement else None for d in (before, now)]
    return fits[0] is not fits[1]


def _record(decision: Decision, armed: bool) -> dict[str, object]:
    """Return a decision as a line of the log, with its reasons."""
    record: dict[str, object] = {
        "sign": decision.sign,
        "state": decision.state,
        "text": as_text(decision.phases),
        "armed": armed,
        "required_m": round(decision.required_m, 1),
        "reasons": list(decision.reasons),
    }
    for key in ("distance_m", "shown_m", "passes_in_s"):
        value = getattr(decision, key)
        if value is not None:
            record[key] = round(value, 1)
    if decision.beacon:
        record["beacon"] = True
    if decision.placement is not None:
        place = decision.placement
        record["placement"] = place.fit
        if place.move_to_station_m is not None:
            record["move_to_station_m"] = place.move_to_station_m
            record["move_to"] = [place.move_to_lat_deg, place.move_to_lon_deg]
    return record
