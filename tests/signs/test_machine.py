"""The state machine of a sign, transition by transition, and that it never flickers."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.signs.distances import STEPS
from queuetail.signs.machine import (
    STEADY_S,
    TRANSITIONS,
    DistanceHold,
    SignMachine,
    Wait,
)
from queuetail.signs.records import SignEvent as E
from queuetail.signs.records import SignState as S

RELEASE_S = 10.0
SECONDS = {
    Wait.NOW: 0.0,
    Wait.STEADY: STEADY_S,
    Wait.RELEASE: RELEASE_S,
}
# Rows: the state; columns: the event; each cell: the next state and what it waits for.
TABLE = """
          clear             distance         ahead          passed          unknown      expired
default   clear/steady      warning/now      ahead/now      passed/now      default/now  default/now
clear     clear/now         warning/now      ahead/now      passed/now      caution/now  default/now
warning   clear/release     warning/now      ahead/now      passed/now      caution/now  default/now
ahead     clear/release     warning/release  ahead/now      passed/now      caution/now  default/now
passed    clear/release     warning/release  ahead/steady   passed/now      caution/now  default/now
caution   clear/release     warning/steady   ahead/steady   passed/steady   caution/now  default/now
"""


def cells() -> list[tuple[S, E, S, Wait]]:
    head, *rows = [line.split() for line in TABLE.strip().splitlines()]
    found = []
    for name, *row in rows:
        for event, cell in zip(head, row, strict=True):
            goal, wait = cell.split("/")
            found.append((S(name), E(event), S(goal), Wait(wait)))
    return found


def test_the_table_is_whole() -> None:
    assert set(TRANSITIONS) == set(itertools.product(S, E))
    assert len(cells()) == len(TRANSITIONS) == 36


@pytest.mark.parametrize(("state", "event", "goal", "wait"), cells())
def test_every_transition(state: S, event: E, goal: S, wait: Wait) -> None:
    assert TRANSITIONS[state, event] == (goal, wait)
    machine = SignMachine(RELEASE_S, state)
    seconds = SECONDS[wait]
    assert machine.step(event, 100.0) is (goal if seconds == 0 else state)
    if seconds:
        assert machine.step(event, 100.0 + seconds - 0.01) is state
        assert machine.step(event, 100.0 + seconds) is goal


@pytest.mark.parametrize(("state", "event", "goal", "wait"), cells())
def test_an_interrupted_wait_begins_anew(state: S, event: E, goal: S, wait: Wait) -> None:
    if wait is Wait.NOW:
        return
    machine = SignMachine(RELEASE_S, state)
    staying = next(e for e in E if TRANSITIONS[state, e][0] is state)
    machine.step(event, 0.0)
    assert machine.step(staying, SECONDS[wait] - 0.01) is state
    assert machine.step(event, SECONDS[wait]) is state
    assert machine.step(event, 2 * SECONDS[wait] - 0.01) is state


def test_nothing_known_never_keeps_a_distance() -> None:
    for state in S:
        for event in (E.UNKNOWN, E.EXPIRED):
            goal, wait = TRANSITIONS[state, event]
            assert goal in (S.CAUTION, S.DEFAULT)
            assert wait is Wait.NOW


@given(st.lists(st.tuples(st.sampled_from(list(E)), st.integers(1, 60)), max_size=20))
@settings(max_examples=100, deadline=None)
def test_a_sign_never_goes_back_at_once_to_less_warning(spells: list[tuple[E, int]]) -> None:
    """Whatever comes, a warning that began lasts, unless knowledge itself is lost."""
    machine, now_s, since_s = SignMachine(RELEASE_S), 0.0, 0.0
    for event, tenths in spells:
        for _ in range(tenths):
            before = machine.state
            after = machine.step(event, now_s)
            if after is not before:
                less = {S.CLEAR: 0, S.WARNING: 1, S.AHEAD: 2, S.PASSED: 2}
                if before in less and after in less and less[after] < less[before]:
                    assert now_s - since_s >= RELEASE_S - 1e-6
                if before is S.CAUTION and after is not S.DEFAULT:
                    assert now_s - since_s >= STEADY_S - 1e-6
                since_s = now_s
            now_s += 0.1


def test_a_nearer_distance_comes_at_once_and_a_farther_one_when_it_lasts() -> None:
    hold = DistanceHold(RELEASE_S, "us")

    def told(distance_m: float, now_s: float) -> str:
        shown = hold.step(distance_m, now_s)
        return shown.text if shown else ""

    assert told(900.0, 0.0) == "1/2 MILE"
    assert told(803.0, 1.0) == "1/4 MILE"
    assert told(810.0, 2.0) == "1/4 MILE"  # not exceeded by enough
    assert told(860.0, 30.0) == "1/4 MILE"
    assert told(860.0, 39.9) == "1/4 MILE"
    assert told(860.0, 40.0) == "1/2 MILE"
    assert told(860.0, 41.0) == "1/2 MILE"
    assert told(140.0, 42.0) == ""
    hold.forget()
    assert told(2000.0, 43.0) == "1 MILE"


@given(st.sampled_from(["us", "metric"]), st.lists(st.floats(0, 6000), min_size=1, max_size=60))
@settings(max_examples=200, deadline=None)
def test_a_sign_never_tells_more_than_the_distance(units: str, distances: list[float]) -> None:
    hold = DistanceHold(1.0, units)  # type: ignore[arg-type]
    for n, distance_m in enumerate(distances):
        shown = hold.step(distance_m, 0.5 * n)
        assert shown is None or shown.metres <= distance_m
        assert (shown is None) == (distance_m < STEPS[units][0][0])  # type: ignore[index]
