"""When feeds speak: every change, refreshes, messages that begin and end, and nothing stale."""

from __future__ import annotations

from datetime import timedelta

import pytest
from feed_answers import CLEAR, LOST, START, answer, queue
from hypothesis import given
from hypothesis import strategies as st

from queuetail.feeds import cot
from queuetail.feeds.answers import Answer
from queuetail.feeds.episodes import Change, Notice, NoticeBook, Reporter, Step
from queuetail.feeds.settings import CotFeed
from queuetail.feeds.state_json import state_record
from queuetail.types import QueueState, QueueStatus

BEYOND = queue(status=QueueStatus.BEYOND_VIEW)


def told(book: NoticeBook | Reporter, states: list[tuple[float, QueueState]]) -> list[str]:
    """Return what a book says of states at times, as words."""
    words = []
    for at_s, state in states:
        for item in book.take((answer(state, at_s, at_s),), at_s):
            kind = item.step if isinstance(item, Notice) else item.change
            words.append(f"{at_s:g} {kind}")
    return words


def book(valid_s: float = 30.0, settle_s: float = 2.0) -> NoticeBook:
    return NoticeBook("run", valid_s, valid_s / 3, settle_s, 25.0)


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ([(0, CLEAR), (1, LOST)], []),
        ([(0, queue()), (1, queue())], ["0 new"]),
        ([(0, queue()), (1, queue(1970.0))], ["0 new", "1 update"]),
        ([(0, queue()), (1, BEYOND)], ["0 new", "1 update"]),
        ([(0, queue()), (10, queue())], ["0 new", "10 update"]),
        ([(0, queue()), (1, CLEAR), (2, CLEAR), (3, CLEAR)], ["0 new", "3 cancel"]),
        ([(0, queue()), (1, LOST), (3, LOST)], ["0 new", "3 cancel"]),
        ([(0, queue()), (1, LOST), (2, queue()), (3, LOST), (4, LOST)], ["0 new"]),
        ([(0, queue()), (1, LOST), (2, CLEAR), (3.5, LOST)], ["0 new", "3.5 cancel"]),
        ([(0, queue()), (3, CLEAR), (5, CLEAR), (6, queue())], ["0 new", "5 cancel", "6 new"]),
        ([(0, queue()), (40, LOST)], ["0 new", "40 cancel"]),
    ],
)
def test_messages(states: list[tuple[float, QueueState]], words: list[str]) -> None:
    assert told(book(), states) == words


def test_a_cancel_says_dissolved_only_where_that_was_seen() -> None:
    for last, is_dissolved in ((CLEAR, True), (LOST, False)):
        notices = book()
        notices.take((answer(queue()),), 0.0)
        assert notices.take((answer(last, 1.0, 1.0),), 1.0) == ()
        (cancel,) = notices.take((answer(last, 3.0, 3.0),), 3.0)
        assert cancel.is_dissolved is is_dissolved
        assert cancel.why.startswith("unknown") is not is_dissolved
        assert cancel.references == (("run-1.0", START),)
        assert notices.current(3.0) == ()


def test_an_approach_that_is_gone_is_cancelled_and_reported_unknown() -> None:
    notices, reporter = book(settle_s=0.0), Reporter(10.0, 25.0)
    notices.take((answer(queue()),), 0.0)
    reporter.take((answer(queue()),), 0.0)
    other = answer(QueueState("SB", QueueStatus.CLEAR), 1.0, 1.0)
    (cancel,) = notices.take((other,), 1.0)
    assert not cancel.is_dissolved
    reports = reporter.take((other,), 1.0)
    assert [(r.answer.approach, r.answer.status) for r in reports] == [
        ("SB", QueueStatus.CLEAR),
        ("NB", QueueStatus.UNKNOWN),
    ]


@pytest.mark.parametrize(
    ("states", "words"),
    [
        ([(0, CLEAR), (1, CLEAR), (11, CLEAR)], ["0 status", "11 refresh"]),
        ([(0, CLEAR), (1, LOST), (1.1, CLEAR)], ["0 status", "1 status", "1.1 status"]),
        ([(0, queue()), (1, queue(1974.0)), (2, BEYOND)], ["0 status", "1 moved", "2 status"]),
        ([(0, queue()), (1, queue(1990.0)), (2, queue(1976.0))], ["0 status"]),
        (
            [(0, queue()), (11, queue(1985.0)), (12, queue(1974.0))],
            ["0 status", "11 refresh", "12 moved"],
        ),
    ],
)
def test_reports(states: list[tuple[float, QueueState]], words: list[str]) -> None:
    assert told(Reporter(10.0, 25.0), states) == words


def test_the_end_is_unknown() -> None:
    reporter, notices = Reporter(10.0, 25.0), book()
    reporter.take((answer(CLEAR),), 0.0)
    notices.take((answer(queue()),), 0.0)
    (last,) = reporter.end(1.0, START + timedelta(seconds=1))
    assert (last.change, last.answer.status) == (Change.ENDED, QueueStatus.UNKNOWN)
    (cancel,) = notices.end(1.0, START + timedelta(seconds=1))
    assert cancel.step is Step.CANCEL
    assert not cancel.is_dissolved


STATES = st.lists(
    st.tuples(
        st.sampled_from([CLEAR, LOST, queue(), queue(1900.0), BEYOND]),
        st.sampled_from([0.1, 0.5, 1.0, 5.0, 40.0]),
    ),
    max_size=30,
)


@given(STATES)
def test_whatever_happens_no_message_outlives_its_answer(
    steps: list[tuple[QueueState, float]],
) -> None:
    notices, now_s, newest = book(valid_s=20.0), 0.0, None
    standing: dict[str, Notice] = {}
    gone_s: float | None = None
    for state, pause_s in steps:
        now_s += pause_s
        newest = answer(state, now_s, now_s)
        for notice in notices.take((newest,), now_s):
            assert notice.expires == notice.sent + timedelta(seconds=20)
            assert b"no queue" not in cot.event(notice, CotFeed())
            if notice.step is Step.CANCEL:
                assert not notice.is_dissolved or state.status is QueueStatus.CLEAR
                del standing[notice.id]
            else:
                assert notice.answer is newest
                assert notice.answer.has_queue
                standing[notice.id] = notice
        assert len(standing) <= 1
        current = notices.current(now_s)
        assert all(now_s < n.expires_s for n in current)
        assert {n.id for n in current} <= set(standing)
        gone_s = None if newest.has_queue else now_s if gone_s is None else gone_s
        if gone_s is not None and now_s - gone_s >= 2.0:
            assert not standing


@given(STATES)
def test_whatever_happens_the_last_report_is_the_newest_status(
    steps: list[tuple[QueueState, float]],
) -> None:
    reporter, now_s = Reporter(10.0, 25.0), 0.0
    last: Answer | None = None
    sequence = 0
    for state, pause_s in steps:
        now_s += pause_s
        for report in reporter.take((answer(state, now_s, now_s),), now_s):
            assert report.sequence == sequence + 1
            record = state_record(report.answer, 10.0)
            assert ("no queue" in record["text"]) == (record["status"] == "clear")
            assert (record["end"] is not None) == report.answer.has_queue
            assert record["valid_until"] > record["utc"]
            sequence, last = report.sequence, report.answer
        assert last is not None
        assert last.status is state.status
