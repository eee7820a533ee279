"""`--out`: the tables and events of a run, each file written in a thread of its own."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.live.outlet import Outlet
from queuetail.live.records import OutletHealth, Published
from queuetail.sinks import RunInfo, Sink
from queuetail.sinks.events import EventsJsonl
from queuetail.sinks.tables import QueueCsv, TracksCsv
from queuetail.types import Frame, Image, Observation

WAITING = 2000  # observations: two minutes, while a disk is full or slow


def _no_picture(width_px: int, height_px: int) -> Image:
    return np.zeros((height_px, width_px, 3), np.uint8)


NO_FRAME = Frame(-1, 0.0, np.zeros((0, 0), np.uint8), _no_picture)


class FileOutlet:
    """A :class:`LiveSink` around one file's sink: a full disk fails it, and nothing else."""

    def __init__(self, name: str, sink: Sink) -> None:
        self._outlet: Outlet[Observation] = Outlet(
            name, lambda observation: sink.write(NO_FRAME, observation), WAITING, finish=sink.close
        )
        self._has_begun = False

    def offer(self, published: Published) -> None:
        """Take one answer; the frame itself is not kept, and nothing before the first one."""
        self._has_begun = self._has_begun or published.frame is not None
        if self._has_begun:
            self._outlet.offer(published.observation)

    def health(self) -> OutletHealth:
        """Return how writing stands."""
        return self._outlet.health()

    def close(self) -> None:
        """Write what waits and close the file."""
        self._outlet.close()


@contextmanager
def owned(out: Path) -> Iterator[Path]:
    """Keep other live runs from writing to the folder; raises InputError where one does already."""
    folder = os.open(out, os.O_RDONLY)
    try:
        try:
            fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(
                f"{out}: another queuetail live is writing there; choose another --out"
            ) from None
        yield out
    finally:
        os.close(folder)


def file_outlets(out: Path, name: str, preset: str, site: Site) -> tuple[FileOutlet, ...]:
    """Create queue.csv, tracks.csv and events.jsonl in `out`, which is there."""
    info = RunInfo(out, name, 0, 0, 0.0, preset, site)
    sinks: dict[str, Callable[[RunInfo], Sink]] = {
        "queue.csv": QueueCsv,
        "tracks.csv": TracksCsv,
        "events.jsonl": EventsJsonl,
    }
    # A tuple grown from a generator breaks where another thread looks at it half made (CPython).
    outlets = [FileOutlet(file_name, sink(info)) for file_name, sink in sinks.items()]
    return tuple(outlets)
