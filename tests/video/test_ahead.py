"""Decoding ahead: the same items in the same order, and no thread left behind."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from itertools import count

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.video.ahead import ahead


def threads() -> list[str]:
    return [t.name for t in threading.enumerate() if t.name == "decoding ahead"]


@given(items=st.lists(st.integers()), depth=st.integers(1, 9))
def test_the_items_come_in_their_order(items: list[int], depth: int) -> None:
    assert list(ahead(items, depth)) == items
    assert threads() == []


def test_what_goes_wrong_is_told_after_what_went_well() -> None:
    def damaged() -> Iterator[int]:
        yield 1
        yield 2
        raise OSError("cut off")

    coming = ahead(damaged())
    assert [next(coming), next(coming)] == [1, 2]
    with pytest.raises(OSError, match="cut off"):
        next(coming)
    assert threads() == []


def test_it_stays_only_so_far_ahead_and_ends_when_nobody_asks() -> None:
    made = []

    def endless() -> Iterator[int]:
        for i in count():
            made.append(i)
            yield i

    coming = ahead(endless(), depth=3)
    assert [next(coming) for _ in range(5)] == [0, 1, 2, 3, 4]
    coming.close()
    assert threads() == []
    assert len(made) <= 5 + 3 + 2
