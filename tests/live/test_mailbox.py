"""What joins the threads: the giver never waits, the newest wins, losses are counted."""

from __future__ import annotations

from threading import Thread

import pytest

from queuetail.live.mailbox import Bounded, Mailbox


def test_the_newest_wins_and_the_overwritten_are_counted() -> None:
    box: Mailbox[int] = Mailbox()
    for number in range(5):
        box.put(number)
    assert box.take() == 4
    assert box.take(0) is None
    assert box.dropped == 4


def test_a_full_queue_drops_the_oldest() -> None:
    queue: Bounded[int] = Bounded(3)
    for number in range(5):
        queue.put(number)
    assert [queue.take(0) for _ in range(4)] == [2, 3, 4, None]
    assert queue.dropped == 2


def test_whoever_waits_gets_what_comes() -> None:
    box: Mailbox[str] = Mailbox()
    got: list[str | None] = []
    waiting = Thread(target=lambda: got.append(box.take()))
    waiting.start()
    box.put("frame")
    waiting.join(5)
    assert got == ["frame"]


def test_closing_wakes_who_waits_and_keeps_what_is_there() -> None:
    queue: Bounded[int] = Bounded(2)
    got: list[int | None] = []
    waiting = Thread(target=lambda: got.append(queue.take()))
    waiting.start()
    queue.close()
    waiting.join(5)
    assert got == [None]
    other: Bounded[int] = Bounded(2)
    other.put(1)
    other.close()
    other.put(2)
    assert other.is_closed
    assert (other.take(), other.take()) == (1, None)
    assert other.dropped == 1


def test_clearing_counts_as_dropping() -> None:
    queue: Bounded[int] = Bounded(4)
    queue.put(1)
    queue.put(2)
    assert queue.clear() == 2
    assert (len(queue), queue.dropped) == (0, 2)


def test_a_queue_without_room_is_refused() -> None:
    with pytest.raises(ValueError, match="room"):
        Bounded(0)
