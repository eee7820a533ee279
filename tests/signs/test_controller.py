"""Signs as a sink of a live run, with simulated signs on the network and everything that fails."""

from __future__ import annotations

import functools
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from answers import CLEAR, UNKNOWN, answer, queue
from between import Relay

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.live.records import OutletState
from queuetail.signs import arming
from queuetail.signs.agent import SignAgent
from queuetail.signs.controller import SignController
from queuetail.signs.ntcip import ControlMode, MessageId, Source
from queuetail.signs.simulated import SimulatedSign
from queuetail.signs.snmp import Session
from queuetail.types import QueueState

HALF = (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))
QUARTER = (("STOPPED", "TRAFFIC", "1/4 MILE"), ("PREPARE", "TO STOP"))
AHEAD = (("STOPPED", "TRAFFIC", "AHEAD"), ("PREPARE", "TO STOP"))
CAUTION = (("BE", "PREPARED", "TO STOP"),)
WORK = (("ROAD", "WORK", "AHEAD"),)
QUICK = {"release_s": 0.3, "refresh_s": 1.0, "hold_s": 0.5, "max_age_s": 0.5}


def site(address: str | None, **settings: float) -> Site:
    sign = {"name": "PCMS 1", "station_m": 0.0, "address": address, "default": WORK}
    return Site.model_validate({"sign": [sign], "signs": {**QUICK, **settings}})


class Run:
    """A live run: answers ten times a second until it ends."""

    def __init__(self, controller: SignController, folder: Path) -> None:
        self.controller, self.folder = controller, folder
        self.state: QueueState | None = CLEAR
        self._done = threading.Event()
        self.longest_offer_s = 0.0
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        number = 0
        while not self._done.wait(0.1):
            number += 1
            if self.state is not None:
                started = time.perf_counter()
                self.controller.offer(answer(self.state, number))
                self.longest_offer_s = max(self.longest_offer_s, time.perf_counter() - started)

    def end(self) -> None:
        self._done.set()
        self._thread.join(5)
        self.controller.close()

    def log(self, *events: str) -> list[dict[str, object]]:
        path = self.folder / "signs.jsonl"
        rows = [json.loads(line) for line in path.read_text("utf-8").splitlines()]
        return [row for row in rows if row["event"] in events]


@pytest.fixture
def agent() -> Iterator[SignAgent]:
    with SignAgent() as running:
        yield running


@pytest.fixture
def start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Run]]:
    runs: list[Run] = []
    impatient = functools.partial(Session, timeout_s=0.5, retries=0)
    monkeypatch.setattr("queuetail.signs.controller.Session", impatient)
    monkeypatch.setattr("queuetail.signs.line.LONGEST_PAUSE_S", 0.5)

    def begin(address: str | None, *, dry_run: bool = False, **settings: float) -> Run:
        made = SignController(site(address, **settings), tmp_path, dry_run=dry_run, environment={})
        runs.append(Run(made, tmp_path))
        return runs[-1]

    yield begin
    for run in runs:
        run.end()  # a second end does nothing


def until(done: Callable[[], bool], seconds: float = 20.0) -> None:
    """Wait for something to come true; fails when it does not."""
    end_s = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end_s, "it did not come true"
        time.sleep(0.02)


def test_nothing_is_sent_until_an_operator_arms(
    agent: SignAgent, start: Callable[..., Run]
) -> None:
    run = start(agent.address)
    run.state = queue(900.0)
    until(lambda: any(d.phases == HALF for d in run.controller.decisions()))
    assert agent.sign.activations == 0
    assert run.controller.health().state is OutletState.OFF
    with pytest.raises(InputError, match="name of who"):
        run.controller.arming.arm(" ")
    run.controller.arming.arm("R. Roe")
    until(lambda: agent.phases() == HALF)
    until(lambda: run.controller.health().state is OutletState.OK)
    (armed,) = run.log("armed")
    assert (armed["who"], armed["reason"]) == ("R. Roe", "armed by an operator")
    run.controller.arming.disarm("R. Roe")
    until(lambda: agent.phases() == WORK)
    until(lambda: run.controller.health().state is OutletState.OFF)
    assert run.controller.reports()[0].shown == WORK
    before = agent.sign.activations
    run.state = queue(500.0)
    until(lambda: any(d.phases == QUARTER for d in run.controller.decisions()))
    assert agent.sign.activations == before
    assert run.longest_offer_s < 0.1


def test_a_queue_forms_grows_passes_the_sign_dissolves(
    agent: SignAgent, start: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("queuetail.signs.machine.STEADY_S", 0.2)
    run = start(agent.address)
    run.controller.arming.arm("R. Roe")
    for answered, state, phases in (
        (CLEAR, "clear", ()),
        (queue(900.0), "warning", HALF),
        (queue(500.0), "warning", QUARTER),
        (queue(100.0), "ahead", AHEAD),
        (queue(-50.0), "passed", AHEAD),
        (CLEAR, "clear", ()),
    ):
        run.state = answered
        until(lambda state=state: [d.state for d in run.controller.decisions()] == [state])
        until(lambda phases=phases: agent.phases() == phases)
    until(lambda: run.log("sent")[-1]["text"] == "(blank)")
    passed = [row for row in run.log("decision") if row["state"] == "passed"]
    assert passed[0]["placement"] == "too_close"
    assert passed[0]["move_to_station_m"] < -500
    assert passed[0]["reasons"]


def test_unknown_answers_hold_caution_then_default_then_disarm(
    agent: SignAgent, start: Callable[..., Run]
) -> None:
    run = start(agent.address, disarm_after_s=1.5)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: agent.phases() == HALF)
    run.state = UNKNOWN
    until(lambda: agent.phases() == CAUTION)
    until(lambda: agent.phases() == WORK)
    until(lambda: not run.controller.arming.armed)
    (row,) = run.log("disarmed")
    assert row["who"] == "queuetail"
    assert row["reason"] == "no known answer for 1.5 s"
    run.state = queue(900.0)
    until(lambda: any(d.phases == HALF for d in run.controller.decisions()))
    assert agent.phases() == WORK  # until somebody arms it again


def test_a_sign_that_was_away_gets_only_the_newest(start: Callable[..., Run]) -> None:
    shown: list[bytes] = []

    class Noting(SimulatedSign):
        def _show(self, message: MessageId, source: Source, minutes: int) -> None:
            super()._show(message, source, minutes)
            shown.append(self.current.multi)

    with SignAgent(Noting()) as agent, Relay(agent.address) as relay:
        run = start(relay.address)
        run.controller.arming.arm("R. Roe")
        run.state = queue(900.0)
        until(lambda: agent.phases() == HALF)
        relay.silent = True
        run.state = queue(500.0)
        until(lambda: run.controller.health().state is OutletState.RETRYING)
        assert "does not answer" in run.controller.health().last_error
        run.state = queue(100.0)
        until(lambda: any(d.phases == AHEAD for d in run.controller.decisions()))
        relay.silent = False
        until(lambda: agent.phases() == AHEAD)
        until(lambda: run.controller.health().state is OutletState.OK)
        assert not any(b"1/4" in text for text in shown)
        assert run.longest_offer_s < 0.1
        run.end()


def test_a_sign_that_lost_its_memory_is_prepared_anew(start: Callable[..., Run]) -> None:
    first = SignAgent()
    run = start(first.address)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: first.phases() == HALF)
    first.close()
    with SignAgent(port=first.port) as second:
        until(lambda: second.phases() == HALF)
        end = second.sign.get((1, 3, 6, 1, 4, 1, 1206, 4, 2, 3, 6, 15, 0))
        assert end != b"\x07\x00\x01\x00\x00"  # its default again, not blank
        run.end()


def test_a_sign_under_local_control_is_left_alone_and_taken_when_it_is_given_back(
    agent: SignAgent, start: Callable[..., Run]
) -> None:
    agent.sign.control_mode = ControlMode.LOCAL
    run = start(agent.address)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: "local control" in run.controller.health().last_error)
    assert agent.sign.activations == 0
    agent.sign.control_mode = ControlMode.CENTRAL
    until(lambda: agent.phases() == HALF)


def test_a_dry_run_says_what_it_would_send_and_sends_nothing(
    agent: SignAgent, start: Callable[..., Run]
) -> None:
    run = start(agent.address, dry_run=True)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: any("1/2 MILE" in str(row["multi"]) for row in run.log("would_send")))
    row = run.log("would_send")[-1]
    assert (row["address"], row["minutes"], row["priority"]) == (agent.address, 1, 100)
    assert agent.sign.activations == 0


def test_a_sign_without_an_address_is_advised_on(start: Callable[..., Run]) -> None:
    run = start(None)
    run.state = queue(900.0)
    until(lambda: any(d.phases == HALF for d in run.controller.decisions()))
    assert run.controller.reports() == ()


def test_the_end_of_a_run_gives_the_sign_back(agent: SignAgent, start: Callable[..., Run]) -> None:
    run = start(agent.address)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: agent.phases() == HALF)
    run.end()
    assert agent.phases() == WORK
    assert run.log("disarmed")[-1]["reason"] == "the run ended"
    assert json.loads((run.folder / arming.STATUS_FILE).read_text())["armed"] is False


def test_a_fault_of_ours_disarms(
    agent: SignAgent, start: Callable[..., Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = start(agent.address)
    run.controller.arming.arm("R. Roe")
    run.state = queue(900.0)
    until(lambda: agent.phases() == HALF)

    def broken(*arguments: object) -> None:
        raise ZeroDivisionError("made up")

    monkeypatch.setattr("queuetail.signs.advice.Adviser._learn", broken)
    until(lambda: not run.controller.arming.armed)
    until(lambda: agent.phases() == WORK)
    assert "made up" in run.controller.health().last_error
    assert run.controller.health().state is OutletState.FAILED


# Arming by command


def test_a_command_arms_and_disarms_a_live_run(agent: SignAgent, start: Callable[..., Run]) -> None:
    run = start(agent.address)
    state = arming.ask(run.folder, True, "R. Roe")
    assert (state.armed, state.who) == (True, "R. Roe")
    assert run.controller.arming.armed
    assert arming.ask(run.folder, False, "J. Doe").reason == "disarmed by command"
    assert [row["who"] for row in run.log("armed", "disarmed")] == ["R. Roe", "J. Doe"]


def test_what_cannot_be_armed_says_why(agent: SignAgent, start: Callable[..., Run]) -> None:
    run = start(None)
    with pytest.raises(InputError, match="no sign of the site file has an address"):
        arming.ask(run.folder, True, "R. Roe")
    run.end()
    run = start(agent.address)
    with pytest.raises(InputError, match="another live run keeps its signs"):
        SignController(site(agent.address), run.folder, environment={})
    other = run.folder / "other"
    other.mkdir()
    second = SignController(site(agent.address), other, environment={})
    try:
        run.controller.arming.arm("R. Roe")
        with pytest.raises(InputError, match="controlled by another live run on this machine"):
            second.arming.arm("J. Doe")
        run.end()
        assert second.arming.arm("J. Doe").armed
    finally:
        second.close()


def test_a_dead_run_cannot_be_armed_and_a_new_one_takes_no_old_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("queuetail.signs.arming.ANSWER_S", 0.2)
    with pytest.raises(InputError, match="not the folder of a live run"):
        arming.ask(tmp_path, True, "R. Roe")
    arming.Arming(tmp_path, lambda event, record: None)
    with pytest.raises(InputError, match="no live run answers"):
        arming.ask(tmp_path, True, "R. Roe")
    request = tmp_path / arming.REQUEST_FILE
    assert not request.exists()
    request.write_text('{"armed": true, "who": "R. Roe", "ticket": "1"}')
    switch = arming.Arming(tmp_path, lambda event, record: None)
    switch.poll()
    assert not switch.armed


@pytest.mark.parametrize("text", ["", "{", "[]", '{"armed": true}', '{"armed": 1, "who": "x"}'])
def test_what_is_no_request_is_thrown_away(tmp_path: Path, text: str) -> None:
    switch = arming.Arming(tmp_path, lambda event, record: None)
    (tmp_path / arming.REQUEST_FILE).write_text(text)
    switch.poll()
    assert not switch.armed
    assert not (tmp_path / arming.REQUEST_FILE).exists()


KILLED = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[3])
from answers import answer, queue
from test_controller import site
from queuetail.signs.controller import SignController
controller = SignController(site(sys.argv[1]), Path(sys.argv[2]), environment={})
controller.arming.arm("R. Roe")
while True:
    controller.offer(answer(queue(900.0)))
    time.sleep(0.1)
"""


def test_a_killed_queuetail_leaves_a_sign_that_ends_by_itself(tmp_path: Path) -> None:
    """kill -9; the sign's clock runs thirty times as fast, so that its minute takes 2 s."""
    with SignAgent(clock_factor=30.0) as agent:
        here = str(Path(__file__).parent)
        command = [sys.executable, "-c", KILLED, agent.address, str(tmp_path), here]
        with subprocess.Popen(command) as running:
            try:
                until(lambda: agent.phases() == HALF)
                held_s = time.monotonic()
                until(lambda: time.monotonic() - held_s > 2.5)
                assert agent.phases() == HALF  # refreshed: longer than one duration
            finally:
                running.send_signal(signal.SIGKILL)
        until(lambda: agent.phases() == WORK)
        assert agent.sign.source == Source.END_DURATION
