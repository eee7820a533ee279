"""A live run's answers in the store: thinned, with events, and none lost while it is away."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

from queuetail.live.records import Health, OutletState, Published
from queuetail.pipeline import NO_TRACKS
from queuetail.store.database import Store
from queuetail.store.records import Thinner
from queuetail.store.sink import StoreSink
from queuetail.traffic.road import assign
from queuetail.types import (
    EndOfQueue,
    Observation,
    QueueState,
    QueueStatus,
    Registration,
    Unknown,
)

START = datetime(2026, 5, 14, 15, 30, tzinfo=UTC)
WAIT_S = 30.0


def answer(
    t_s: float, status: QueueStatus = QueueStatus.CLEAR, station_m: float = 500.0
) -> Observation:
    eoq = EndOfQueue(station_m, 1.0, (0.0, 0.0), (1.0, 2.0), 36.1, -97.0, 3, 40.0, 5, float("nan"))
    has = status in (QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)
    state = QueueState("NB", status, eoq if has else None, () if has else ("because",))
    return Observation(
        frame_index=0,
        t_s=t_s,
        mapping=Unknown(()),
        registration=Registration(np.eye(3), 1.0),
        detections_px=np.empty((0, 4)),
        approaches=(),
        vehicles=assign(NO_TRACKS, ()),
        states=(state,),
    )


def published(number: int, observation: Observation) -> Published:
    utc = START + timedelta(seconds=observation.t_s)
    return Published(number, utc, None, observation, Health())


def until(condition: Callable[[], bool]) -> None:
    end_s = monotonic() + WAIT_S
    while not condition():
        assert monotonic() < end_s
        sleep(0.02)


def test_history_has_one_answer_a_second_and_every_change() -> None:
    thinner = Thinner("a")
    rows, events = [], []
    for k in range(100):
        t_s = k * 0.1
        status = QueueStatus.QUEUED if 3.0 <= t_s < 3.3 else QueueStatus.CLEAR
        batch = thinner.batch(answer(t_s, status), START + timedelta(seconds=t_s))
        rows += batch.history
        events += batch.events
    assert [round(r.t_s, 1) for r in rows] == [0, 1, 2, 3, 3.3, 4.3, 5.3, 6.3, 7.3, 8.3, 9.3]
    assert [e.event for e in events] == ["watch_started", "queue_formed", "queue_dissolved"]
    assert rows[3].station_m == 500.0
    assert rows[3].growth_mps is None  # it was not a number
    assert rows[4].reasons == "because"


def test_a_flight_is_kept(store: Store) -> None:
    sink = StoreSink(store._address, "I-35", "rtsp://drone/live", "road", START)
    for k in range(50):
        sink.offer(published(k, answer(k * 0.1)))
    sink.close()
    (flight,) = store.flights()
    assert (flight.id, flight.site, flight.is_finished) == (sink.flight.id, "I-35", True)
    assert [round(p.t_s, 1) for p in store.history(flight.id)] == [0, 1, 2, 3, 4]
    assert sink.health().delivered == 5
    assert sink.health().dropped == 0


def test_a_run_that_was_killed_is_known_up_to_its_last_answer(tmp_path: Path) -> None:
    store = Store(str(tmp_path / "h.db"))
    sink = StoreSink(store._address, "I-35", "", "road", START)
    sink.offer(published(1, answer(7.0)))
    until(lambda: sink.health().delivered == 1)
    (flight,) = store.flights()
    assert not flight.is_finished
    assert flight.last_utc == START + timedelta(seconds=7)
    sink.close()


class Gate:
    """A TCP proxy that can be shut: the database behind it is then away."""

    def __init__(self, host: str, port: int) -> None:
        self._goal = host, port
        self._sockets: list[socket.socket] = []
        self._listener: socket.socket | None = None
        self.port = 0

    def open(self) -> None:
        listener = socket.create_server(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        self._listener = listener
        threading.Thread(target=self._accept, args=(listener,), daemon=True).start()

    def shut(self) -> None:
        for each in [self._listener, *self._sockets]:
            if each is not None:
                with suppress(OSError):
                    each.shutdown(socket.SHUT_RDWR)
                each.close()
        self._sockets = []

    def _accept(self, listener: socket.socket) -> None:
        with suppress(OSError):
            while True:
                near, _ = listener.accept()
                far = socket.create_connection(self._goal)
                for end in (near, far):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._sockets += [near, far]
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=(a, b), daemon=True).start()

    @staticmethod
    def _pass_on(a: socket.socket, b: socket.socket) -> None:
        with suppress(OSError):
            while data := a.recv(65536):
                b.sendall(data)
            b.shutdown(socket.SHUT_RDWR)


@contextmanager
def gate(address: str) -> Iterator[tuple[Gate, str]]:
    place = address.split("@")[1].split("/", maxsplit=1)[0]
    host, _, port = place.partition(":")
    passage = Gate(host, int(port))
    passage.open()
    yield passage, address.replace(place, f"127.0.0.1:{passage.port}")
    passage.shut()


def test_a_database_that_goes_away_and_comes_back_loses_nothing(postgres: str) -> None:
    with gate(postgres) as (passage, address):
        sink = StoreSink(address, "I-35", "", "road", START, longest_pause_s=0.5)
        for k in range(10):
            sink.offer(published(k, answer(float(k))))
        until(lambda: sink.health().delivered == 10)
        passage.shut()
        for k in range(10, 60):
            sink.offer(published(k, answer(float(k))))
        until(lambda: sink.health().state is not OutletState.OK)
        assert "the store cannot be used" in sink.health().last_error
        assert sink.health().waiting == 50
        passage.open()
        until(lambda: sink.health().delivered == 60)
        assert sink.health().state is OutletState.OK
        assert sink.health().dropped == 0
        sink.close()
    store = Store(postgres)
    assert [p.t_s for p in store.history(sink.flight.id)] == [float(k) for k in range(60)]
    store.close()


def test_a_database_that_is_away_at_the_start_is_no_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked = tmp_path / "blocked"
    blocked.write_text("a file where the folder should be")
    sink = StoreSink(str(blocked / "h.db"), "I-35", "", "road", START)
    sink.offer(published(0, answer(0.0)))
    until(lambda: sink.health().state is OutletState.RETRYING)
    blocked.unlink()
    until(lambda: sink.health().delivered == 1)
    sink.close()
    store = Store(str(blocked / "h.db"))
    assert len(store.history()) == 1
    store.close()
