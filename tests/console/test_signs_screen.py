"""The Signs screen and its routes: decisions, faces, and who may arm."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import pytest
from answers_double import answer, live_source
from axe_playwright_python.sync_playwright import Axe
from fastapi.testclient import TestClient
from PIL import Image
from served import Served, visit

from queuetail.cli import main
from queuetail.config import Site, parse_settings
from queuetail.console.app import create_api
from queuetail.console.auth import Access
from queuetail.console.live_source import LiveSource
from queuetail.signs.agent import SignAgent
from queuetail.signs.controller import SignController

BASE = "http://127.0.0.1:8080"
LIMIT_MS = 40_000
ACCESS = Access(viewer="look", operator="change")
VIEWER = {"Authorization": "Bearer look"}
OPERATOR = {"Authorization": "Bearer change"}
ARM = {"armed": True, "who": "R. Roe"}


@pytest.fixture
def agent() -> Iterator[SignAgent]:
    with SignAgent() as running:
        yield running


@pytest.fixture
def signs(agent: SignAgent, tmp_path: Path) -> Iterator[LiveSource]:
    """A live run with a controlled sign that the queue nears, and one without an address."""
    source = live_source()
    here = {"name": "PCMS 1", "station_m": 700.0, "address": agent.address}
    near = {"name": "PCMS <b>2</b>", "station_m": 1250.0}
    site = parse_settings(Site, {"sign": [here, near]}, "test")
    source.signs = SignController(site, tmp_path, environment={})
    source.signs.offer(answer(1, 1190.0, 1.0))
    end_s = monotonic() + 20
    while not any(d.shown_m for d in source.signs.decisions()):
        assert monotonic() < end_s
        sleep(0.02)
    yield source
    source.signs.close()


@pytest.fixture
def client(signs: LiveSource) -> Iterator[TestClient]:
    with TestClient(create_api(signs, ACCESS), base_url=BASE) as made:
        yield made


def test_every_sign_with_its_decision_and_its_face(client: TestClient) -> None:
    now = client.get("/api/v1/signs", headers=VIEWER).json()
    assert now["can_arm"]
    assert now["is_outdated"]  # the run's settings name one sign, its control has two
    assert (now["control"]["armed"], now["control"]["reason"]) == (False, "a run starts disarmed")
    far, near = now["signs"]
    assert far["phases"] == [["STOPPED", "TRAFFIC", "1/4 MILE"], ["PREPARE", "TO STOP"]]
    assert far["is_controlled"]
    assert not near["is_controlled"]
    assert near["state"] == "passed"
    assert near["place"]["fit"] == "too_close"
    assert near["place"]["move_m"] > 0
    faces = [
        client.get(f"/api/v1/signs/1/face.png?phase={phase}", headers=VIEWER) for phase in (1, 2)
    ]
    assert all(Image.open(io.BytesIO(f.content)).format == "PNG" for f in faces)
    assert faces[0].content != faces[1].content
    assert client.get("/api/v1/signs/3/face.png", headers=VIEWER).status_code == 404


def test_only_operators_arm_and_only_by_name(client: TestClient, signs: LiveSource) -> None:
    assert signs.signs is not None
    path = "/api/v1/signs/arming"
    assert client.post(path, json=ARM, headers=VIEWER).status_code == 403
    assert client.post(path, json=ARM).status_code == 401
    refused = client.post(path, json={"armed": True, "who": "  "}, headers=OPERATOR)
    assert (refused.status_code, refused.json()["detail"]) == (
        409,
        "arming needs the name of who does it",
    )
    assert not signs.signs.arming.armed
    assert client.post(path, json=ARM, headers=OPERATOR).json()["who"] == "R. Roe"
    assert signs.signs.arming.armed
    assert client.post(path, json={"armed": False}, headers=VIEWER).status_code == 403
    state = client.post(path, json={"armed": False}, headers=OPERATOR).json()
    assert (state["armed"], state["who"]) == (False, "console")


def test_a_run_without_signs_has_nothing_to_arm(source: LiveSource) -> None:
    client = TestClient(create_api(source, Access()), base_url=BASE)
    assert client.get("/api/v1/signs").json()["control"] is None
    assert client.get("/api/v1/signs").json()["is_outdated"]
    reply = client.post("/api/v1/signs/arming", json=ARM)
    assert reply.status_code == 409
    assert "no [[sign]]" in reply.json()["detail"]
    assert client.get("/api/v1/signs/1/face.png").status_code == 404


def test_the_screen_arms_after_a_question_and_disarms_at_once(
    browser: Any, flagger: Path, agent: SignAgent, tmp_path: Path
) -> None:
    site = tmp_path / "site.toml"
    text = (flagger / "site.toml").read_text("utf-8")
    text += '\n[signs]\nrefresh_s = 1\n[[sign]]\nname = "PCMS <b>1</b>"\nstation_m = 500.0\n'
    text += f'address = "{agent.address}"\n'
    site.write_text(text, encoding="utf-8")
    flight = ("live", str(flagger / "flight.mp4"), "--realtime", "--loop", "--no-store")
    words = (*flight, "--telemetry", str(flagger / "telemetry.csv"), "--site", str(site))
    out = tmp_path / "out"
    with Served(*words, "--out", str(out), "--host", "0.0.0.0") as served:
        viewer = browser.new_context().new_page()
        visit(viewer, f"{served.address}signs?token={served.tokens['viewer']}")
        viewer.wait_for_selector("[data-state=clear]", timeout=LIMIT_MS)
        assert viewer.locator("button#qt-arm, button#qt-disarm, dialog").count() == 0
        page = browser.new_context(viewport={"width": 390, "height": 800}).new_page()
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        visit(page, f"{served.address}signs?token={served.tokens['operator']}")
        assert page.text_content("[data-sign] h2", timeout=LIMIT_MS) == "PCMS <b>1</b>"
        assert "Not armed" in page.text_content("#qt-armed")
        page.click("#qt-arm", timeout=LIMIT_MS)
        page.click("#qt-no")
        page.click("#qt-arm")
        page.fill("#qt-who", "R. Roe")
        page.click("#qt-yes")
        page.wait_for_selector("#qt-control[data-armed=true]", timeout=LIMIT_MS)
        assert "on the word of R. Roe" in page.text_content("#qt-armed")
        page.wait_for_selector("text=by its own word", timeout=LIMIT_MS)
        page.wait_for_function(
            "[...document.querySelectorAll('#qt-list img')].every(i => i.naturalWidth > 100)",
            timeout=LIMIT_MS,
        )
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        viewer.wait_for_selector("#qt-control[data-armed=true]", timeout=LIMIT_MS)
        found = Axe().run(page, options={"runOnly": ["wcag2a", "wcag2aa"]})
        assert found.violations_count == 0, found.generate_report()
        agent.close()
        page.wait_for_selector("text=Not known now", timeout=LIMIT_MS)
        page.wait_for_selector("td:has-text('does not answer')", timeout=LIMIT_MS)
        page.click("#qt-disarm")
        page.wait_for_selector("#qt-control[data-armed=false]", timeout=LIMIT_MS)
        assert errors == []
    rows = [json.loads(line) for line in (out / "signs.jsonl").read_text("utf-8").splitlines()]
    assert [r["who"] for r in rows if r["event"] in ("armed", "disarmed")] == ["R. Roe", "R. Roe"]
    assert agent.sign.activations > 0


def test_a_dry_run_without_signs_is_refused(
    flagger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["live", str(flagger / "flight.mp4"), "--realtime", "--no-store", "--port", "0"]
    words += ["--telemetry", str(flagger / "telemetry.csv"), "--dry-run-signs"]
    assert main(words) == 2
    assert "needs a --site file with a [[sign]]" in capsys.readouterr().err
