"""The API: what a run published, in records; nothing fails, whatever is asked."""

from __future__ import annotations

import io
import re
import struct
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import schemathesis
from answers_double import ORIGIN, START_UTC, answer, live_source, lost
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis.errors import Unsatisfiable
from PIL import Image
from schemathesis.checks import not_a_server_error

from queuetail.console import app as console_app
from queuetail.console import picture
from queuetail.console.app import create_api
from queuetail.console.auth import Access
from queuetail.console.live_source import ConsoleSink, LiveSource

BASE = "http://127.0.0.1:8080"
LOCAL = {"Host": "127.0.0.1:8080"}


def test_the_state_has_its_distances(client: TestClient) -> None:
    record = client.get("/api/v1/state").json()
    assert record["number"] == 40
    assert record["age_s"] > 0
    (state,) = record["approaches"]
    assert (state["approach"], state["status"]) == ("NB", "queued")
    assert state["eoq"]["station_m"] == pytest.approx(1194.0)
    (sign,) = state["signs"]
    assert sign["name"] == "PCMS 1"
    assert sign["distance_m"] == pytest.approx(494.0)
    assert sign["reached_in_s"] == pytest.approx(494.0)
    assert state["taper_distance_m"] == pytest.approx(106.0)


@pytest.mark.parametrize("growth_mps", [0.0, -2.0])
def test_a_queue_that_does_not_grow_reaches_no_sign(growth_mps: float) -> None:
    source = live_source()
    source.take(answer(1, 1190.0, growth_mps))
    client = TestClient(create_api(source, Access()), base_url=BASE)
    (sign,) = client.get("/api/v1/state").json()["approaches"][0]["signs"]
    assert sign["reached_in_s"] is None
    assert sign["distance_m"] == pytest.approx(490.0)


def test_tracks_history_and_paths(client: TestClient) -> None:
    tracks = client.get("/api/v1/tracks").json()["tracks"]
    assert [t["track_id"] for t in tracks] == [1, 2, 3]
    assert [t["queued"] for t in tracks] == [True, True, False]
    assert tracks[2]["speed_mps"] == pytest.approx(20.0)
    assert tracks[0]["lat_deg"] == pytest.approx(ORIGIN.lat_deg, abs=0.01)
    rows = client.get("/api/v1/history?since_s=1.5").json()["rows"]
    assert [r["status"] for r in rows][-1] == "queued"
    assert all(b["t_s"] > a["t_s"] >= 1.5 for a, b in pairwise(rows))
    assert len(client.get("/api/v1/history?limit=2").json()["rows"]) <= 2
    paths = client.get("/api/v1/paths").json()
    assert len(paths["t_s"]) == len(paths["station_m"]) == len(paths["speed_mps"]) > 0


def test_places_are_geojson(client: TestClient) -> None:
    reply = client.get("/api/v1/map")
    assert reply.headers["content-type"] == "application/geo+json"
    features = reply.json()["features"]
    kinds = {f["properties"]["kind"] for f in features}
    assert kinds == {"drone", "view", "axis", "edge", "sign", "eoq", "past"}
    (ring,) = next(f for f in features if f["geometry"]["type"] == "Polygon")["geometry"][
        "coordinates"
    ]
    assert ring[0] == ring[-1]
    assert len(ring) >= 4
    lon, lat = next(f for f in features if f["properties"]["kind"] == "eoq")["geometry"][
        "coordinates"
    ]
    assert (lat, lon) == (pytest.approx(36.11, abs=0.01), pytest.approx(-97.057, abs=0.01))


def test_the_picture_and_the_picture_laid_flat(client: TestClient) -> None:
    reply = client.get("/api/v1/picture")
    assert Image.open(io.BytesIO(reply.content)).size == (640, 360)
    flat = client.get("/api/v1/map/picture")
    south, west, north, east = map(float, flat.headers["x-bounds"].split(","))
    assert south < 36.1106 < north
    assert west < -97.057 < east
    assert Image.open(io.BytesIO(flat.content)).mode == "RGBA"


def test_a_viewers_socket_gets_each_picture_when_it_asks(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(picture, "WAIT_S", 0.05)
    with client.websocket_connect("ws://127.0.0.1:8080/console/pictures") as socket:
        socket.send_text("next")
        message = socket.receive_bytes()
        (length,) = struct.unpack_from(">I", message)
        assert message[4 + length :].startswith(b"\xff\xd8")
        assert b'"number":40' in message[4 : 4 + length]
        socket.send_text("next")
        assert socket.receive_bytes() == b""  # nothing new yet
        for strange in ("at nan", "at -inf", "at 1e400", "at x", "", "x" * 5000):
            socket.send_text(strange)
            socket.receive_bytes()


def test_states_are_sent_as_they_come(source: LiveSource, client: TestClient) -> None:
    sink = ConsoleSink(source)
    with client.websocket_connect("ws://127.0.0.1:8080/api/v1/states") as socket:
        assert socket.receive_json()["number"] == 40
        sink.offer(lost(41))
        record = socket.receive_json()
        assert record["number"] == 41
        assert record["approaches"][0]["status"] == "unknown"
        assert record["approaches"][0]["reasons"] == ["no picture for 1.2 s: it is off"]
    assert sink.health().delivered == 1


def test_before_the_first_answer_and_without_a_picture() -> None:
    source = live_source()
    client = TestClient(create_api(source, Access()), base_url=BASE)
    assert client.get("/api/v1/state").json()["number"] == 0
    assert client.get("/api/v1/map").json()["features"] == []
    assert client.get("/api/v1/picture").status_code == 404
    assert client.get("/api/v1/map/picture").status_code == 404
    source.take(lost(1))
    assert client.get("/api/v1/picture").status_code == 404
    assert client.get("/api/v1/tracks").json()["tracks"] == []
    reply = client.get("/health")
    assert reply.status_code == 503
    assert reply.json()["problems"] == ["no picture for 1.2 s: it is off"]


def test_health_for_people_and_for_monitoring(client: TestClient) -> None:
    assert client.get("/health").json()["ok"] is True
    record = client.get("/api/v1/health").json()
    assert record["outlets"][0]["name"] == "queue.csv"
    reply = client.get("/metrics")
    assert reply.headers["content-type"].startswith("text/plain; version=0.0.4")
    assert "queuetail_ok 1.0" in reply.text


@pytest.mark.parametrize(
    "path",
    ["/api/v1/history?since_s=nan", "/api/v1/history?limit=0", "/api/v1/state?t_s=-1",
     "/api/v1/map?t_s=inf", "/api/v1/paths?until_s=1e99"],
)  # fmt: skip
def test_parameters_are_checked(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 422


@pytest.mark.parametrize(
    "path",
    [
        *("/static/../app.py", "/static/%2e%2e/app.py", "/static/..%2fapp.py"),
        "/static/leaflet/..%2f..%2f__init__.py",
    ],
)
def test_only_what_is_meant_to_be_served_is(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


def test_nothing_of_ours_names_another_host(client: TestClient) -> None:
    for file in (Path(console_app.__file__).parent / "static").iterdir():
        assert not re.search(r"(https?:)?//[a-z0-9.-]+\.[a-z]{2,}", file.read_text("utf-8")), file
    assert client.get("/docs").status_code == 200


def test_whatever_is_asked_the_server_does_not_fail(
    source: LiveSource, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Schemathesis, for every operation of the OpenAPI description; site files go to a folder."""
    monkeypatch.chdir(tmp_path)
    app = create_api(source, Access())
    schema = schemathesis.openapi.from_asgi("/openapi.json", app, headers=LOCAL)
    tried = 0
    for result in schema.get_all_operations():
        operation: Any = result.ok()
        for case in generated(operation, 12):
            reply = case.call(headers=LOCAL)
            case.validate_response(reply, checks=[not_a_server_error])
            tried += 1
    assert tried > 50


def generated(operation: Any, count: int) -> list[Any]:
    """Draw cases of an operation, valid ones and others."""
    found: list[Any] = []
    for mode in (schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE):

        @settings(
            max_examples=count,
            database=None,
            deadline=None,
            suppress_health_check=list(HealthCheck),
        )
        @given(case=operation.as_strategy(generation_mode=mode))
        def draw(case: Any) -> None:
            found.append(case)

        try:
            draw()
        except Unsatisfiable:
            continue  # an operation without parameters has no invalid ones
    return found


def test_the_age_counts_from_the_picture(source: LiveSource, client: TestClient) -> None:
    age_s = (datetime.now(UTC) - START_UTC).total_seconds() - 4.0
    assert client.get("/api/v1/state").json()["age_s"] == pytest.approx(age_s, abs=5.0)


def test_numbers_that_json_cannot_carry_are_refused_by_a_sentence(client: TestClient) -> None:
    for body in ('{"posted_speed_mph": NaN}', '{"name": NaN}', '{"roads": [{"lanes": Infinity}]}'):
        reply = client.post(
            "/api/v1/setup/preview", content=body, headers={"Content-Type": "application/json"}
        )
        assert reply.status_code == 422
        assert reply.json()["detail"][0]["msg"]
