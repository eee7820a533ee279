"""Fixtures of the console's tests: a source with answers, its API, and a browser."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from answers_double import answer, live_source
from fastapi.testclient import TestClient
from playwright.sync_api import sync_playwright

from queuetail.console.app import create_api
from queuetail.console.auth import Access
from queuetail.console.live_source import LiveSource

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture
def source() -> LiveSource:
    """A live run after forty answers, the last with a queue."""
    made = live_source()
    for number in range(1, 41):
        made.take(answer(number, None if number < 20 else 1190.0 + number / 10))
    return made


@pytest.fixture
def client(source: LiveSource) -> Iterator[TestClient]:
    """The API of an open console on this machine."""
    with TestClient(create_api(source, Access()), base_url="http://127.0.0.1:8080") as made:
        yield made


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Debian's Chromium, let go after each file: Playwright leaves an event loop in its thread."""
    if not CHROMIUM.exists():
        pytest.skip("chromium is not installed (apt-get install chromium)")
    with sync_playwright() as playwright:
        # Without calls of its own, which a closed network refuses together with ours.
        flags = ["--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
        flags += ["--disable-background-networking", "--disable-component-update"]
        flags += ["--disable-sync"]
        chromium = playwright.chromium.launch(executable_path=str(CHROMIUM), args=flags)
        yield chromium
        chromium.close()
