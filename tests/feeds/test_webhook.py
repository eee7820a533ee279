"""Signed webhooks: the documented receiver believes them, and no change is lost or overtaken."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from threading import Thread
from time import perf_counter

import pytest
from feed_answers import CLEAR, LOST, published, queue, wait_until
from receivers import free_port

from queuetail.errors import InputError
from queuetail.feeds.answers import Reader
from queuetail.feeds.episodes import Reporter
from queuetail.feeds.settings import WebhookFeed
from queuetail.feeds.sinks import PushSink
from queuetail.feeds.webhook import VARIABLE, Webhook, signature
from queuetail.live.records import OutletState

SECRET = "0123456789abcdef"
ENVIRONMENT = {VARIABLE: SECRET}


class Receiver:
    """The receiver of docs/feeds.md, as a process."""

    def __init__(self, root: Path, port: int) -> None:
        page = (root / "docs" / "feeds.md").read_text("utf-8")
        (program,) = re.findall(r"^```python\n(import.*?)^```", page, re.M | re.S)
        self._program = program.replace("9000", str(port))
        self.lines: list[str] = []
        self.start()

    def start(self) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", self._program],
            env={**os.environ, VARIABLE: SECRET},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self._reading = Thread(target=self._read, daemon=True)
        self._reading.start()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self._reading.join()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as stream:
            self.lines.extend(line.strip() for line in iter(stream.readline, ""))


def sink_to(port: int, secret: str = SECRET) -> PushSink[object]:
    feed = WebhookFeed(url=f"http://127.0.0.1:{port}/", allow_private=True, timeout_s=2)
    hook = Webhook("a site", "run", feed, {VARIABLE: secret})
    return PushSink("webhook", Reader(2.0), Reporter(60.0, 25.0), hook.deliver)  # type: ignore[arg-type]


def test_the_documented_receiver_gets_every_change_in_order_over_its_own_death(root: Path) -> None:
    port = free_port()
    receiver = Receiver(root, port)
    sink = sink_to(port)
    try:
        sink.offer(published(CLEAR))
        wait_until(lambda: len(receiver.lines) == 1)
        receiver.kill()
        started_s = perf_counter()
        for at_s, state in enumerate((queue(), queue(1900.0), LOST, queue(), CLEAR), 1):
            sink.offer(published(state, at_s=at_s))
        assert perf_counter() - started_s < 1.0
        wait_until(lambda: sink.health().state is OutletState.RETRYING)
        assert sink.health().waiting == 5
        receiver.start()
        wait_until(lambda: len(receiver.lines) == 6)
        sink.close()
        wait_until(lambda: len(receiver.lines) == 7)
    finally:
        sink.close()
        receiver.kill()
    assert [line.split()[1] for line in receiver.lines] == [
        *("clear", "queued", "queued", "unknown", "queued", "clear", "unknown")
    ]
    assert [line.split()[0] for line in receiver.lines] == [f"{n}" for n in range(1, 8)]
    assert "queuetail has ended" in receiver.lines[-1]


def test_the_documented_receiver_believes_no_other_secret(root: Path) -> None:
    port = free_port()
    receiver = Receiver(root, port)
    sink = sink_to(port, secret="another secret of ours")
    try:
        sink.offer(published(CLEAR))
        wait_until(lambda: "401" in sink.health().last_error)
    finally:
        sink.close()
        receiver.kill()
    assert receiver.lines == []


def test_a_signature_holds_for_its_time_only() -> None:
    """HMAC-SHA256 of "1700000000.{}", as `openssl dgst -sha256 -hmac` computes it."""
    signed = signature(SECRET.encode(), "1700000000", b"{}")
    text = subprocess.run(
        ["openssl", "dgst", "-sha256", "-hmac", SECRET],
        input=b"1700000000.{}",
        capture_output=True,
        check=True,
        timeout=30,
    ).stdout.decode()
    assert text.split()[-1] == signed
    assert signature(SECRET.encode(), "1700000001", b"{}") != signed


def test_secrets_come_from_the_environment_or_a_private_file(tmp_path: Path) -> None:
    file = tmp_path / "secret"
    feed = WebhookFeed(url="https://example.org/", secret_file=file)
    with pytest.raises(InputError, match="cannot be read"):
        Webhook("site", "run", feed, {})
    file.write_text(SECRET + "\n")
    file.chmod(0o640)
    with pytest.raises(InputError, match="chmod 600") as refusal:
        Webhook("site", "run", feed, {})
    assert SECRET not in str(refusal.value)
    file.chmod(0o600)
    Webhook("site", "run", feed, {})
    file.write_text("short")
    with pytest.raises(InputError, match="shorter than 16"):
        Webhook("site", "run", feed, {})
    file.write_text("\n")
    with pytest.raises(InputError, match="is empty"):
        Webhook("site", "run", feed, {})
    with pytest.raises(InputError, match=f"secret_file in the site file, or {VARIABLE}"):
        Webhook("site", "run", WebhookFeed(url="https://example.org/"), {})
