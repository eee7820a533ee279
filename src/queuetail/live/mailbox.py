"""What joins the threads of a live run: one slot where the newest wins, and a bounded queue.

Both never make the giver wait, and count what they had to throw away.
"""

from __future__ import annotations

from collections import deque
from threading import Condition
from time import monotonic
from typing import Generic, TypeVar

T = TypeVar("T")


class Bounded(Generic[T]):
    """A queue of at most ``capacity`` items that drops the oldest, and counts what it dropped."""

    def __init__(self, capacity: int) -> None:
        """Make an empty queue; raises ValueError for a capacity below 1."""
        if capacity < 1:
            raise ValueError("a queue needs room for one item or more")
        self._capacity = capacity
        self._items: deque[T] = deque()
        self._changed = Condition()
        self._dropped = 0
        self._is_closed = False

    def put(self, item: T) -> None:
        """Add an item without ever waiting; after :meth:`close` it is dropped and counted."""
        with self._changed:
            if self._is_closed:
                self._dropped += 1
                return
            if len(self._items) == self._capacity:
                self._items.popleft()
                self._dropped += 1
            self._items.append(item)
            self._changed.notify()

    def take(self, timeout_s: float | None = None) -> T | None:
        """Remove and return the oldest item; ``None`` after `timeout_s`, or when closed and empty.

        Without a timeout it waits until there is an item or the queue is closed.
        """
        end_s = None if timeout_s is None else monotonic() + timeout_s
        with self._changed:
            while not self._items:
                left_s = None if end_s is None else end_s - monotonic()
                if self._is_closed or (left_s is not None and left_s <= 0):
                    return None
                self._changed.wait(left_s)
            return self._items.popleft()

    def clear(self) -> int:
        """Throw away what waits, count it as dropped, and return how many items that were."""
        with self._changed:
            count = len(self._items)
            self._items.clear()
            self._dropped += count
            return count

    def close(self) -> None:
        """Take no more; what waits can still be taken, and whoever waits is woken."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    @property
    def is_closed(self) -> bool:
        """Whether :meth:`close` was called."""
        with self._changed:
            return self._is_closed

    @property
    def dropped(self) -> int:
        """How many items were thrown away because newer ones came."""
        with self._changed:
            return self._dropped

    def __len__(self) -> int:
        with self._changed:
            return len(self._items)


class Mailbox(Bounded[T]):
    """A single slot in which the newest item wins; ``dropped`` counts what was overwritten."""

    def __init__(self) -> None:
        super().__init__(1)
