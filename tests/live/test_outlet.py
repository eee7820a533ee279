"""Outlets: one that fails or hangs tries again and says so, and holds nobody up."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from time import monotonic

from queuetail.live.outlet import Outlet, Policy, Undeliverable
from queuetail.live.records import OutletState

LIMIT_S = 10.0
QUICK = {"first_pause_s": 0.005, "longest_pause_s": 0.02}


def wait_until(condition: Callable[[], bool]) -> None:
    """Wait for what another thread does; fails after ten seconds."""
    end_s, pause = monotonic() + LIMIT_S, Event()
    while not condition():
        assert monotonic() < end_s
        pause.wait(0.002)


def test_all_are_delivered_in_order_then_it_finishes() -> None:
    got: list[object] = []
    outlet: Outlet[int] = Outlet("test", got.append, finish=lambda: got.append("end"))
    for number in range(100):
        outlet.offer(number)
    outlet.close()
    assert got == [*range(100), "end"]
    health = outlet.health()
    assert (health.state, health.delivered, health.dropped) == (OutletState.OK, 100, 0)


def test_a_failure_is_tried_again_in_order_and_told() -> None:
    got: list[int] = []
    is_up = Event()

    def deliver(item: int) -> None:
        if not is_up.is_set():
            raise OSError("no space\nleft")
        got.append(item)

    outlet = Outlet("disk", deliver, **QUICK)
    outlet.offer(1)
    outlet.offer(2)
    wait_until(lambda: outlet.health().state is OutletState.RETRYING)
    assert outlet.health().last_error == "no space left"
    assert outlet.health().waiting == 2
    is_up.set()
    wait_until(lambda: outlet.health().delivered == 2)
    outlet.close()
    assert got == [1, 2]
    assert outlet.health().state is OutletState.OK
    assert outlet.health().delivery_age_s is not None


def test_failing_for_long_is_called_failed() -> None:
    def deliver(item: int) -> None:
        raise ConnectionError

    outlet = Outlet("broker", deliver, failed_after_s=0.02, **QUICK)
    outlet.offer(1)
    wait_until(lambda: outlet.health().state is OutletState.FAILED)
    assert outlet.health().last_error == "ConnectionError"
    outlet.close(drain_s=0.05)
    assert outlet.health().dropped == 1


def test_only_the_newest_is_tried_again_where_only_that_matters() -> None:
    got: list[int] = []
    is_up, tried = Event(), Event()

    def deliver(item: int) -> None:
        tried.set()
        if not is_up.is_set():
            raise OSError("away")
        got.append(item)

    outlet = Outlet("sign", deliver, policy=Policy.NEWEST, **QUICK)
    outlet.offer(0)
    assert tried.wait(LIMIT_S)
    for number in range(1, 10):
        outlet.offer(number)
    is_up.set()
    wait_until(lambda: 9 in got)
    outlet.close()
    assert got[-1] == 9
    assert outlet.health().delivered + outlet.health().dropped == 10


def test_a_hanging_outlet_holds_nobody_up() -> None:
    let_go = Event()
    outlet: Outlet[int] = Outlet("hung", lambda item: let_go.wait(LIMIT_S) and None, capacity=10)
    started_s = monotonic()
    for number in range(1000):
        outlet.offer(number)
    outlet.close(drain_s=0.05)
    assert monotonic() - started_s < 5
    assert outlet.health().dropped >= 989
    let_go.set()


def test_what_can_never_be_delivered_is_let_go() -> None:
    got: list[int] = []

    def deliver(item: int) -> None:
        if item == 1:
            raise Undeliverable("too long for the sign")
        got.append(item)

    outlet = Outlet("sign", deliver)
    for number in range(3):
        outlet.offer(number)
    outlet.close()
    health = outlet.health()
    assert got == [0, 2]
    assert (health.state, health.delivered, health.dropped) == (OutletState.OK, 2, 1)
    assert health.last_error == "too long for the sign"


def test_a_finish_that_fails_is_told() -> None:
    def finish() -> None:
        raise OSError("the disk is gone")

    outlet: Outlet[int] = Outlet("file", lambda item: None, finish=finish)
    outlet.close()
    assert outlet.health().last_error == "the disk is gone"
    assert outlet.health().state is OutletState.RETRYING
