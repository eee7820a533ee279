"""A relay between a client and a sign that may change, drop or invent what passes."""

from __future__ import annotations

import socket
from collections.abc import Callable
from threading import Event, Thread
from types import TracebackType

Change = Callable[[bytes], list[bytes]]


class Relay:
    """Hands datagrams on; answers go through `change`, which returns what is sent instead."""

    def __init__(self, goal: str, change: Change | None = None) -> None:
        host, port = goal.rsplit(":", 1)
        self._goal = host, int(port)
        self.change: Change = change or (lambda answer: [answer])
        self.requests: list[bytes] = []
        self.silent = False
        self._front = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._front.bind(("127.0.0.1", 0))
        self._back = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._back.bind(("127.0.0.1", 0))
        self._client: tuple[str, int] = ("127.0.0.1", 9)
        self._done = Event()
        for each in (self._front, self._back):
            each.settimeout(0.1)
        self._threads = [Thread(target=work, daemon=True) for work in (self._ask, self._answer)]
        for thread in self._threads:
            thread.start()
        self.address = f"127.0.0.1:{self._front.getsockname()[1]}"

    def __enter__(self) -> Relay:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._done.set()
        for thread in self._threads:
            thread.join(2)
        self._front.close()
        self._back.close()

    def _ask(self) -> None:
        while not self._done.is_set():
            try:
                data, self._client = self._front.recvfrom(65536)
            except TimeoutError:
                continue
            self.requests.append(data)
            if not self.silent:
                self._back.sendto(data, self._goal)

    def _answer(self) -> None:
        while not self._done.is_set():
            try:
                data = self._back.recv(65536)
            except (TimeoutError, ConnectionRefusedError):
                continue
            if self.silent:
                continue
            for each in self.change(data):
                self._front.sendto(each, self._client)
