"""What every source does: stamps by several clocks, and going on after whatever goes wrong."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from link_doubles import Heard, wait_for
from queuetail.link.messages import ClockSource, ClockTime, Gimbal, Heading
from queuetail.onboard import source
from queuetail.onboard.source import Source


class Scripted(Source):
    """A source whose sessions are given."""

    def __init__(self, *sessions: Callable[[Scripted], bool]) -> None:
        super().__init__("scripted")
        self.sessions = list(sessions)

    def _session(self) -> bool:
        return self.sessions.pop(0)(self)


def test_utc_is_told_for_the_clock_it_belongs_to() -> None:
    def autopilot_and_gimbal(it: Scripted) -> bool:
        for i in range(3):
            it._tick(100.0 + i, 5000.0 + i, "autopilot")
            it._hear(ClockTime(1.8e9 + i, ClockSource.GPS), 5000.0 + i, 100.0 + i, "autopilot")
            it._tick(7.0 + i, 5000.5 + i, "gimbal")
            it._hear(Gimbal(1.0), 5000.6 + i, 7.0 + i, "gimbal")
            it._hear(Heading(1.0), 5000.7 + i)
        return False

    heard = Heard()
    scripted = Scripted(autopilot_and_gimbal)
    scripted.start(heard)
    wait_for(lambda: scripted.has_ended, "the end")
    stamps = [stamp for _, stamp in heard.pairs[-2:]]
    assert [s.measured_s for s in stamps] == pytest.approx([5002.5, 5002.7])
    assert [s.utc_s for s in stamps] == pytest.approx([1.8e9 + 2.5, 1.8e9 + 2.7], abs=1e-3)


def test_a_fault_of_any_kind_is_survived_and_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source, "FIRST_PAUSE_S", 0.01)

    def fault(it: Scripted) -> bool:
        raise KeyError("nothing that was foreseen")

    def heading(it: Scripted) -> bool:
        assert "foreseen" in it.state.error
        it._hear(Heading(1.0), 0.0)
        return False

    heard = Heard()
    scripted = Scripted(fault, fault, heading)
    scripted.start(heard)
    wait_for(lambda: scripted.has_ended, "the end")
    assert heard.of(Heading) == [Heading(1.0)]
    assert scripted.state.reconnects == 2
    assert scripted.state.error == ""
