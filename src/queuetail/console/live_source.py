"""A live run as the console sees it: its newest answer, and the last minutes in memory."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np

from queuetail.config import Site
from queuetail.console.source import About, PastState, PathSample
from queuetail.live.records import Health, OutletHealth, OutletState, Published
from queuetail.types import TrackState

if TYPE_CHECKING:
    from queuetail.signs.controller import SignController
    from queuetail.store.address import Address

PAST_S = 1800.0  # how much of the end of the queue is kept; the store has the rest
PAST_EVERY_S = 0.5
PATHS_S = 300.0  # of vehicles, which are more
PATHS_EVERY_S = 0.5


class LiveSource:
    """Keeps what the console shows of a live run."""

    def __init__(
        self,
        health: Callable[[], Health],
        video: str,
        preset: str,
        site: Site,
        site_file: Path | None,
    ) -> None:
        """`health` is the run's own."""
        self.about = About(site.site.name, video, preset, site, site_file, is_live=True)
        self.store: Address | None = None  # where the run keeps its history
        self.signs: SignController | None = None  # the run's own, if its site has signs
        self.on_adjust: Callable[[Site], None] | None = None  # the run's own, if it can
        self._health = health
        self._lock = Lock()
        self._newest: Published | None = None
        self._past: deque[PastState] = deque()
        self._paths: deque[PathSample] = deque()
        self._noted_s = self._sampled_s = -np.inf
        self._waiting: set[asyncio.Future[None]] = set()

    def take(self, published: Published) -> None:
        """Take one answer, and wake whoever waits for it."""
        with self._lock:
            self._newest = published
            self._note(published)
            waiting, self._waiting = self._waiting, set()
        for future in waiting:
            wake(future)

    def newest(self) -> Published | None:
        """Return the newest answer."""
        with self._lock:
            return self._newest

    def at(self, t_s: float) -> Published | None:
        """Return the newest answer: a live run has no other."""
        return self.newest()

    async def newer(self, number: int, timeout_s: float) -> Published | None:
        """Return the newest answer once its number is above `number`; None after `timeout_s`."""
        future = asyncio.get_running_loop().create_future()
        with self._lock:
            if self._newest is not None and self._newest.number > number:
                return self._newest
            self._waiting.add(future)
        try:
            await asyncio.wait_for(future, timeout_s)
        except TimeoutError:
            return None
        finally:
            with self._lock:
                self._waiting.discard(future)
        return self.newest()

    def past(self, since_s: float, until_s: float) -> Sequence[PastState]:
        """Return the answers between two times, about two a second."""
        with self._lock:
            return [p for p in self._past if since_s <= p.t_s <= until_s]

    def paths(self, since_s: float, until_s: float) -> Sequence[PathSample]:
        """Return where the vehicles were between two times, twice a second."""
        with self._lock:
            return [p for p in self._paths if since_s <= p.t_s <= until_s]

    def health(self) -> Health:
        """Return how the run is now."""
        return self._health()

    def adjust(self, site: Site, site_file: Path | None) -> None:
        """Let the run go on with other settings, from `site_file` if they are saved.

        Raises InputError, and changes nothing, where they do not fit.
        """
        if self.on_adjust is not None:
            self.on_adjust(site)
        title = site.site.name
        self.about = replace(self.about, title=title, site=site, site_file=site_file)

    def _note(self, published: Published) -> None:
        t_s = published.observation.t_s
        if t_s - self._noted_s >= PAST_EVERY_S:
            self._noted_s = t_s
            self._past.extend(
                PastState(published.number, published.utc, t_s, state)
                for state in published.observation.states
            )
            while self._past and self._past[0].t_s < t_s - PAST_S:
                self._past.popleft()
        if t_s - self._sampled_s >= PATHS_EVERY_S:
            self._sampled_s = t_s
            self._paths.extend(path_samples(published))
            while self._paths and self._paths[0].t_s < t_s - PATHS_S:
                self._paths.popleft()


class ConsoleSink:
    """The console as one consumer of a live run's answers."""

    def __init__(self, source: LiveSource) -> None:
        self._source = source
        self._taken = 0

    def offer(self, published: Published) -> None:
        """Take one answer."""
        self._source.take(published)
        self._taken += 1

    def health(self) -> OutletHealth:
        """Return that it takes answers; nobody need look at them."""
        return OutletHealth("console", OutletState.OK, delivered=self._taken)

    def close(self) -> None:
        """Nothing is held."""


def path_samples(published: Published) -> list[PathSample]:
    """Return one sample per approach of the vehicles that are believed."""
    observation = published.observation
    vehicles = observation.vehicles
    believed = np.array([s is not TrackState.TENTATIVE for s in vehicles.tracks.states], bool)
    found = []
    for index, approach in enumerate(observation.approaches):
        on_it = believed & (vehicles.approach == index)
        if on_it.any():
            found.append(
                PathSample(
                    observation.t_s,
                    approach.name,
                    vehicles.tracks.ids[on_it].astype(float),
                    vehicles.station_m[on_it],
                    vehicles.speed_mps[on_it],
                )
            )
    return found


def wake(future: asyncio.Future[None]) -> None:
    """Resolve a future of another thread's loop."""

    def resolve() -> None:
        if not future.done():
            future.set_result(None)

    try:
        future.get_loop().call_soon_threadsafe(resolve)
    except RuntimeError:
        return  # the console has closed meanwhile
