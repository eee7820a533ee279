"""The routes of the accuracy check, the set-up and the history: figures, roles, refusals."""

from __future__ import annotations

import csv
import io
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from answers_double import ORIGIN, answer, live_source
from fastapi.testclient import TestClient

from queuetail.config import Site
from queuetail.console.app import create_api
from queuetail.console.auth import Access
from queuetail.console.live_source import LiveSource
from queuetail.store.address import parse_address
from queuetail.store.database import Store
from queuetail.store.records import Batch, Flight, HistoryPoint, StoredEvent

ACCESS = Access("v" * 32, "o" * 32)
BEGAN = datetime(2026, 5, 14, 15, 0, tzinfo=UTC)


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Site files go to a folder of the test's own."""
    monkeypatch.chdir(tmp_path)


def held(client: TestClient) -> dict[str, Any]:
    found: dict[str, Any] = client.get("/api/v1/still").json()
    return found


def test_a_held_picture_places_its_pixels(client: TestClient) -> None:
    still = held(client)
    assert still["is_placed"]
    assert still["has_pose"]
    path = f"/api/v1/still/{still['number']}"
    assert client.get(f"{path}/picture").content[:2] == b"\xff\xd8"
    ground, sky = client.get(f"{path}/places?px=320,200;320,-900000").json()
    assert ground["lat_deg"] == pytest.approx(ORIGIN.lat_deg, abs=0.01)
    assert 0 < ground["sigma_m"] < 20
    assert sky["lat_deg"] is None
    assert client.get(f"{path}/places?px=1,2,3").status_code == 422
    assert client.get(f"{path}/places?px=1,nan").status_code == 422
    assert client.get("/api/v1/still/999/picture").status_code == 404


def test_errors_offsets_and_their_use(client: TestClient, source: LiveSource) -> None:
    still = held(client)
    used: list[Site] = []
    source.on_adjust = used.append
    px = [(60, 60), (600, 80), (580, 340), (40, 330), (320, 200)]
    pixels = ";".join(f"{u},{v}" for u, v in px)
    spots = client.get(f"/api/v1/still/{still['number']}/places?px={pixels}").json()
    shift = 4e-5  # 4.4 m: as a position that is off, which no offset of a pose mends wholly
    points = ";".join(
        f"{still['number']},{s['u_px']},{s['v_px']},{s['lat_deg'] + shift},{s['lon_deg']}"
        for s in spots
    )
    table = client.get(f"/api/v1/check?points={points}").json()
    assert table["mean_m"] == pytest.approx(4.448, abs=0.01)  # 111.19 km a degree on the sphere
    found = client.get(f"/api/v1/check/improvement?points={points}").json()
    assert found["before"]["mean_m"] == pytest.approx(4.448, abs=0.01)
    reply = client.post("/api/v1/check/apply", json={"points": points, "file": "a.toml"})
    assert reply.status_code == (200 if found["helps"] else 422)
    assert bool(used) is found["helps"]
    assert Path("sites/a.toml").exists() is found["helps"]
    assert client.get("/api/v1/check?points=7,1,2,3,4").status_code == 404
    assert client.get("/api/v1/check?points=1,2,3").status_code == 422
    assert client.get("/api/v1/check/improvement?points=").status_code == 422


def test_the_speed_of_a_vehicle_is_compared(client: TestClient) -> None:
    tracks = client.get("/api/v1/tracks").json()["tracks"]
    driven = next(t for t in tracks if t["speed_mps"] and abs(t["speed_mps"]) > 1)
    reply = client.get(f"/api/v1/check/speed?track_id={driven['track_id']}&true_mph=45")
    assert reply.status_code in (200, 422)
    assert client.get("/api/v1/check/speed?track_id=999&true_mph=45").status_code == 422


def test_viewers_look_and_change_nothing(source: LiveSource) -> None:
    used: list[Site] = []
    source.on_adjust = used.append
    api = create_api(source, ACCESS)
    headers = {"Authorization": f"Bearer {ACCESS.viewer}"}
    with TestClient(api, base_url="http://10.0.0.5:8080", headers=headers) as viewer:
        assert viewer.get("/api/v1/still").status_code == 200
        assert viewer.get("/api/v1/setup").status_code == 200
        draft = {"draft": {"name": "x"}, "file": "x.toml"}
        for path, body in (
            ("/api/v1/setup/save", draft),
            ("/api/v1/check/apply", {"points": ""}),
            ("/api/v1/sliders", {}),
        ):
            assert viewer.post(path, json=body).status_code == 403
    assert used == []
    assert not Path("sites").exists()


def test_a_draft_is_checked_shown_and_kept(client: TestClient, source: LiveSource) -> None:
    now = client.get("/api/v1/setup").json()
    assert now["roads"][0]["name"] == "NB"
    draft = now["draft"] | {"name": 'Say "hi"', "posted_speed_mph": 60}
    draft["roads"][0]["axis"] = [[36.11, -97.06], [36.11, -97.06], [36.11, -97.05]]
    draft["signs"] = [{"name": "PCMS 9", "at": [36.11, -97.061]}]
    shown = client.post("/api/v1/setup/preview", json=draft).json()
    assert shown["queue_speed_mph"] == 20
    assert 'name = "Say \\"hi\\""' in shown["toml"]
    saved = {"draft": draft, "file": "kept.toml"}
    assert client.post("/api/v1/setup/save", json=saved).json()["file"] == "sites/kept.toml"
    assert source.about.site.sign[0].name == "PCMS 9"
    assert len(source.about.site.approach[0].axis or ()) == 2
    again = client.post("/api/v1/setup/save", json=saved)
    assert again.status_code == 409
    assert client.post("/api/v1/setup/save", json=saved | {"overwrite": True}).status_code == 200
    for name in ("../up.toml", "a/b.toml", ".toml", "x.txt"):
        assert client.post("/api/v1/setup/save", json=saved | {"file": name}).status_code == 422
    bad = draft | {"signs": [{"name": "PCMS 9"}, {"name": "PCMS 9"}]}
    assert client.post("/api/v1/setup/preview", json=bad).status_code == 422


def test_places_come_back_as_pixels(client: TestClient) -> None:
    still = held(client)
    path = f"/api/v1/still/{still['number']}/places?px=300,200"
    spot = client.get(path).json()[0]
    body = {"number": still["number"], "points": [[spot["lat_deg"], spot["lon_deg"]], [0, 0]]}
    points = client.post("/api/v1/setup/pixels", json=body).json()["points"]
    assert points[0] == pytest.approx([300, 200], abs=0.2)
    assert points[1] is None


@pytest.fixture
def remembered(tmp_path: Path) -> TestClient:
    """A console whose store has a flight."""
    address = parse_address(str(tmp_path / "history.db"))
    store = Store(address)
    store.put_flight(Flight("f1", "site", "cam", "road", "0", BEGAN, is_finished=True))
    rows = tuple(
        HistoryPoint("f1", BEGAN + timedelta(seconds=t), t, "NB", "queued", 36.1, -97.0, 100.0 - t)
        for t in range(10)
    )
    event = StoredEvent("f1", BEGAN, 0.0, "NB", "queue_formed", "queued", reasons="a, b")
    store.add(Batch(rows, (event,)))
    store.close()
    source = live_source()
    source.take(answer(1, None))
    source.store = address
    return TestClient(create_api(source, Access()), base_url="http://127.0.0.1:8080")


def test_the_history_is_listed_and_exported(remembered: TestClient) -> None:
    found = remembered.get("/api/v1/flights").json()
    assert [f["id"] for f in found["flights"]] == ["f1"]
    day = "since=2026-05-14T00:00:00Z&until=2026-05-15T00:00:00Z"
    assert remembered.get(f"/api/v1/flights/eoq?{day}").json()["of"] == 10
    assert len(remembered.get(f"/api/v1/flights/eoq?{day}&limit=3").json()["rows"]) <= 3
    events = remembered.get(f"/api/v1/flights/events?{day}").json()["rows"]
    assert events[0]["event"] == "queue_formed"
    text = remembered.get(f"/api/v1/flights/export?{day}").text
    assert [float(r["station_m"]) for r in csv.DictReader(io.StringIO(text))][-1] == 91.0
    places = remembered.get(f"/api/v1/flights/export?{day}&form=geojson").json()["features"]
    assert places[0]["geometry"]["coordinates"] == [-97.0, 36.1]
    exported = remembered.get(f"/api/v1/flights/export?{day}&form=json&show=events")
    assert exported.json()[0]["reasons"] == "a, b"
    assert "attachment" in exported.headers["content-disposition"]
    assert remembered.get("/api/v1/flights?since=2026-05-14T00:00:00").status_code == 422


def test_without_a_history_the_page_is_told_why(client: TestClient) -> None:
    assert "no history" in client.get("/api/v1/flights").json()["problem"]
    assert client.get("/api/v1/flights/eoq").status_code == 404
