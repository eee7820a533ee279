"""`--store`: a live run's answers on their way into the store, through an outlet of their own."""

from __future__ import annotations

from datetime import datetime
from threading import Lock

from queuetail import __version__
from queuetail.live.outlet import Outlet
from queuetail.live.records import OutletHealth, Published
from queuetail.store.address import Address
from queuetail.store.database import Store
from queuetail.store.records import Batch, Flight, Thinner, new_flight_id

CAPACITY = 36_000  # seconds and changes that a database may be away: ten hours of one approach


class StoreSink:
    """A :class:`LiveSink` that keeps one flight; what waits for a lost database is not lost."""

    def __init__(
        self,
        address: Address | str,
        site: str,
        source: str,
        preset: str,
        started_utc: datetime,
        capacity: int = CAPACITY,
        longest_pause_s: float = 5.0,
    ) -> None:
        """Begin a flight; `source` must hold no password.  The database may be away."""
        self._store = Store(address)
        self.flight = Flight(
            new_flight_id(started_utc), site, source, preset, __version__, started_utc
        )
        self._thinner = Thinner(self.flight.id)
        self._lock = Lock()
        self._has_begun = False
        self._outlet: Outlet[Batch] = Outlet(
            "history",
            self._deliver,
            capacity,
            longest_pause_s=longest_pause_s,
            finish=self._finish,
        )

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        with self._lock:
            batch = self._thinner.batch(published.observation, published.utc)
        if batch.history or batch.events:
            self._outlet.offer(batch)

    def health(self) -> OutletHealth:
        """Return how the store is reached."""
        return self._outlet.health()

    def close(self) -> None:
        """Store what waits, within a few seconds, and note that the flight has ended."""
        self._outlet.close()
        self._store.close()

    def _deliver(self, batch: Batch) -> None:
        if not self._has_begun:
            self._store.put_flight(self.flight)
            self._has_begun = True
        self._store.add(batch)

    def _finish(self) -> None:
        if self._has_begun:
            self._store.finish_flight(self.flight.id)
