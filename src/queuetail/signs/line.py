"""What one sign is sent: a task that keeps the sign at the newest decision, whatever happens.

Only the newest decision is ever sent.  One that was overtaken while the sign was away, or while its
message was being written, is dropped before it is activated: nothing stale is shown.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from queuetail.live.records import OutletState
from queuetail.signs.client import Overtaken, Shown, SignClient
from queuetail.signs.faults import SignFault, SignSilent
from queuetail.signs.records import Decision, Phases, SignState, as_text
from queuetail.signs.settings import SignSite, SignsSettings

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 8.0
FAILED_AFTER_S = 30.0

Noted = Callable[[str, dict[str, object]], None]


@dataclass(frozen=True, slots=True)
class LineReport:
    """How one sign stands: what it should show, what it does show, and what went wrong last."""

    name: str
    decision: Decision | None
    state: OutletState
    shown: Phases | None  # by its own word; None until it told
    shown_age_s: float | None
    delivered: int
    last_error: str


class SignLine:
    """Keeps one sign at the newest decision while control is armed; for one event loop."""

    def __init__(
        self,
        site: SignSite,
        settings: SignsSettings,
        client: SignClient,
        is_armed: Callable[[], bool],
        noted: Noted,
    ) -> None:
        self.site, self._settings, self._client = site, settings, client
        self._is_armed, self._noted = is_armed, noted
        self._wake = asyncio.Event()
        self._decision: Decision | None = None
        self._holds = False
        self._shown: tuple[Phases, float] | None = None
        self._delivered = 0
        self._error = ""
        self._failing_since_s: float | None = None
        self._pause_s = FIRST_PAUSE_S

    def decide(self, decision: Decision) -> None:
        """Take the newest decision."""
        self._decision = decision
        if decision.changed:
            self._wake.set()

    def wake(self) -> None:
        """Look at the switch again: it may have changed."""
        self._wake.set()

    def report(self) -> LineReport:
        """Return how the sign stands."""
        state = OutletState.OK if self._holds or self._is_armed() else OutletState.OFF
        if self._failing_since_s is not None and (self._holds or self._is_armed()):
            long = monotonic() - self._failing_since_s >= FAILED_AFTER_S
            state = OutletState.FAILED if long else OutletState.RETRYING
        phases, since_s = self._shown if self._shown else (None, None)
        return LineReport(
            name=self.site.name,
            decision=self._decision,
            state=state,
            shown=phases,
            shown_age_s=None if since_s is None else monotonic() - since_s,
            delivered=self._delivered,
            last_error=self._error,
        )

    async def keep(self) -> None:
        """Work until cancelled."""
        while True:
            pause_s = await self._once()
            try:
                await asyncio.wait_for(self._wake.wait(), pause_s)
            except TimeoutError:
                continue
            finally:
                self._wake.clear()

    async def release(self) -> None:
        """Give the sign back: its default message, where ours could be on it."""
        if not self._holds:
            return
        shown = await self._client.show_default()
        self._shown, self._holds = (shown.phases, monotonic()), False
        self._noted("released", {"sign": self.site.name})

    async def _once(self) -> float:
        """Do what is due and return how long to rest, unless woken."""
        armed, decision = self._is_armed(), self._decision
        if decision is None or not (armed or self._holds):
            return self._settings.refresh_s
        try:
            if armed:
                await self._send(decision)
            else:
                await self.release()
        except Overtaken:
            return 0.0
        except SignFault as fault:
            return self._failed(fault)
        except Exception as error:  # a fault of ours must not end the control of a sign for good
            return self._failed(SignFault(f"{type(error).__name__}: {error}"))
        self._pause_s, self._failing_since_s, self._error = FIRST_PAUSE_S, None, ""
        return self._settings.refresh_s

    async def _send(self, decision: Decision) -> None:
        client, settings = self._client, self._settings
        if not client.is_prepared:
            await client.prepare(self.site.default, settings.comm_loss_min)
        self._holds = True  # from here on the sign may show something of ours
        if decision.state is SignState.DEFAULT:
            shown = await client.show_default()
        else:
            shown = await client.show(
                decision.phases, settings.duration_min, lambda: self._wanted(decision)
            )
        self._sent(decision, shown)

    def _wanted(self, decision: Decision) -> bool:
        """Tell whether a decision is still the one to be shown."""
        newest = self._decision
        return self._is_armed() and newest is not None and newest.phases == decision.phases

    def _sent(self, decision: Decision, shown: Shown) -> None:
        is_new = self._shown is None or self._shown[0] != shown.phases
        if is_new or self._failing_since_s is not None:
            text, state = as_text(shown.phases), decision.state
            self._noted("sent", {"sign": decision.sign, "text": text, "state": state})
        self._shown = (shown.phases, monotonic())
        self._delivered += 1

    def _may_hold(self, fault: SignFault) -> bool:
        """Tell whether a sign that cannot be given back may still show something of ours."""
        duration_s = 60.0 * self._settings.duration_min
        young = self._shown is not None and monotonic() - self._shown[1] < duration_s
        return young and isinstance(fault, SignSilent)

    def _failed(self, fault: SignFault) -> float:
        if str(fault) != self._error:
            self._noted("failed", {"sign": self.site.name, "error": str(fault)})
        self._error = str(fault)
        if self._failing_since_s is None:
            self._failing_since_s = monotonic()
        if isinstance(fault, SignSilent):
            self._client.forget()
        if not self._is_armed() and not self._may_hold(fault):
            self._holds = False
        pause_s, self._pause_s = self._pause_s, min(2 * self._pause_s, LONGEST_PAUSE_S)
        return pause_s
