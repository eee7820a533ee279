"""Decoding ahead: the next pictures are made while the present one is looked at."""

from __future__ import annotations

import queue
from collections.abc import Generator, Iterable
from contextlib import suppress
from threading import Thread
from typing import TypeVar

T = TypeVar("T")

DEPTH = 6  # pictures that wait: a 4K picture takes 12 MB
PATIENCE_S = 0.05  # between looks whether anybody still wants them


def ahead(items: Iterable[T], depth: int = DEPTH) -> Generator[T, None, None]:
    """Yield what `items` gives, made up to `depth` ahead in a thread of its own.

    Order is kept, nothing is dropped, and what `items` raises is raised here, after what it gave
    before.  Closing the generator ends the thread.
    """
    waiting: queue.Queue[tuple[T | None, BaseException | None, bool]] = queue.Queue(depth)
    stopped: list[bool] = []

    def offer(entry: tuple[T | None, BaseException | None, bool]) -> bool:
        while not stopped:
            try:
                waiting.put(entry, timeout=PATIENCE_S)
            except queue.Full:
                continue
            return True
        return False

    def make() -> None:
        try:
            for item in items:
                if not offer((item, None, False)):
                    return
        except BaseException as error:  # whatever it is, the one who asks is told
            offer((None, error, True))
        else:
            offer((None, None, True))

    maker = Thread(target=make, name="decoding ahead", daemon=True)
    maker.start()
    try:
        while True:
            item, error, is_last = waiting.get()
            if error is not None:
                raise error
            if is_last:
                return
            yield item  # type: ignore[misc]  # only the last entry has none
    finally:
        stopped.append(True)
        with suppress(queue.Empty):  # so that it need not wait for room
            while True:
                waiting.get_nowait()
        maker.join()
