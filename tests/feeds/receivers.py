"""Real and hostile receivers for tests: a broker, certificates, servers that misbehave."""

from __future__ import annotations

import shutil
import socket
import subprocess
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import Self

import pytest
from feed_answers import wait_until

Misbehave = Callable[[socket.socket], None]


def free_port() -> int:
    """Return a TCP port on the loopback that is free now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def certificate(folder: Path) -> tuple[Path, Path]:
    """Return a new certificate for localhost, signed by itself, and its key."""
    openssl = shutil.which("openssl")
    if openssl is None:
        pytest.skip("the program openssl is not installed")
    cert, key = folder / "cert.pem", folder / "key.pem"
    command = [openssl, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256"]
    command += ["-nodes", "-days", "2", "-subj", "/CN=localhost", "-keyout", str(key)]
    command += ["-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1", "-out", str(cert)]
    subprocess.run(command, check=True, capture_output=True, timeout=30)
    return cert, key


class Broker:
    """A Mosquitto on a free port, with a user; it keeps sessions over a kill."""

    def __init__(self, folder: Path, tls: tuple[Path, Path] | None = None) -> None:
        """Write its files; skips where Mosquitto is not installed."""
        program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
        tools = [shutil.which(f"mosquitto_{name}") for name in ("sub", "passwd")]
        if program is None or None in tools:
            pytest.skip("Mosquitto and its clients are not installed")
        self.port, self._folder = free_port(), folder
        passwords = folder / "passwords"
        subprocess.run(
            [str(tools[1]), "-c", "-b", str(passwords), "queuetail", "secret words"],
            check=True,
            capture_output=True,
            timeout=30,
        )
        lines = [
            f"listener {self.port} 127.0.0.1",
            "allow_anonymous false",
            f"password_file {passwords}",
            "persistence true",
            f"persistence_location {folder}/",
            "autosave_on_changes true",
            "autosave_interval 1",
            "user root",
        ]
        if tls is not None:
            lines += [f"certfile {tls[0]}", f"keyfile {tls[1]}"]
        config = folder / "mosquitto.conf"
        config.write_text("\n".join(lines) + "\n")
        self._command = [program, "-c", str(config)]
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start, and wait until it listens."""
        log = (self._folder / "mosquitto.log").open("ab")
        with log:
            self._process = subprocess.Popen(self._command, stdout=log, stderr=log)
        wait_until(self._listens)

    def kill(self) -> None:
        """End it as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.kill()

    def messages(self, topic: str, count: int, *options: str, limit_s: int = 20) -> list[str]:
        """Return the next messages of a topic, as `topic retained expiry payload`."""
        command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(self.port), "-V", "5", "-q", "1"]
        command += ["-u", "queuetail", "-P", "secret words", "-t", topic, "-C", str(count)]
        command += ["-W", str(limit_s), "-F", "%t %r %E %p", *options]
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, timeout=limit_s + 10
        )
        return done.stdout.splitlines()

    def _listens(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0


class RawServer:
    """Accepts connections and gives each to a function that may do as it likes."""

    def __init__(self, misbehave: Misbehave) -> None:
        self._misbehave = misbehave
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._socket.getsockname()[1])
        self.connections = 0
        Thread(target=self._serve, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._socket.close()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            self.connections += 1
            Thread(target=self._one, args=(connection,), daemon=True).start()

    def _one(self, connection: socket.socket) -> None:
        with connection:
            try:
                self._misbehave(connection)
            except OSError:
                return
