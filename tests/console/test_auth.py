"""Who gets in: tokens outside loopback, roles, and nothing through other web sites."""

from __future__ import annotations

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from queuetail.console.app import create_api
from queuetail.console.auth import Access, Role, access_for, is_loopback
from queuetail.console.live_source import LiveSource

ACCESS = Access(viewer="view-token", operator="operate-token")


def as_bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


@pytest.fixture
def guarded(source: LiveSource) -> FastAPI:
    """A console that others can reach, with something to change in it."""
    app = create_api(source, ACCESS)

    @app.post("/api/v1/setting")
    def change() -> str:
        return "changed"

    return app


@pytest.fixture
def visitor(guarded: FastAPI) -> TestClient:
    return TestClient(guarded, base_url="http://10.0.0.5:8080")


@pytest.mark.parametrize(
    ("host", "alone"),
    [("127.0.0.1", True), ("::1", True), ("[::1]", True), ("localhost", True),
     ("0.0.0.0", False), ("::", False), ("10.0.0.5", False), ("example.org", False)],
)  # fmt: skip
def test_tokens_are_asked_for_outside_this_machine(host: str, alone: bool) -> None:
    access = access_for(host)
    assert is_loopback(host) is alone
    assert access.is_open is alone
    if not alone:
        assert len(access.operator) >= 32
        assert access.operator != access.viewer
        assert access_for(host) != access


@pytest.mark.parametrize(
    ("token", "role"),
    [("view-token", Role.VIEWER), ("operate-token", Role.OPERATOR),
     ("", None), ("view-toke", None), ("operate-token ", None), ("ü", None)],
)  # fmt: skip
def test_a_token_gives_its_role(token: str, role: Role | None) -> None:
    assert ACCESS.role(token) is role


@pytest.mark.parametrize(
    "path",
    ["/api/v1/state", "/health", "/metrics", "/docs", "/static/theme.js", "/openapi.json", "/no"],
)
def test_nothing_answers_without_a_token(visitor: TestClient, path: str) -> None:
    assert visitor.get(path).status_code == 401
    assert visitor.get(path, headers=as_bearer("wrong")).status_code == 401
    assert visitor.get(f"{path}?token=wrong").status_code == 401


def test_a_viewer_looks_and_changes_nothing(visitor: TestClient) -> None:
    assert visitor.get("/api/v1/me", headers=as_bearer("view-token")).json() == {"role": "viewer"}
    for method in ("POST", "PUT", "PATCH", "DELETE"):
        reply = visitor.request(method, "/api/v1/setting", headers=as_bearer("view-token"))
        assert reply.status_code == 403
        assert reply.json() == {"detail": "a viewer may look, and change nothing"}
    reply = visitor.post("/api/v1/setting", headers=as_bearer("operate-token"))
    assert reply.json() == "changed"


def test_the_printed_address_leaves_a_cookie_and_loses_its_token(visitor: TestClient) -> None:
    reply = visitor.get("/docs?token=view-token&a=%22%3E%3Cb", headers={"Accept": "text/html"})
    cookie = reply.headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    assert "view-token" not in reply.text
    assert 'content="0;url=/docs?a=%22%3E%3Cb"' in reply.text
    assert visitor.get("/api/v1/me").json() == {"role": "viewer"}
    assert visitor.post("/api/v1/setting").status_code == 403


def test_the_page_goes_on_to_this_console_only(visitor: TestClient) -> None:
    reply = visitor.get("http://10.0.0.5:8080//evil.example/?token=view-token")
    assert "url=/evil.example" in reply.text
    assert "url=//" not in reply.text


def test_sockets_are_guarded_too(visitor: TestClient) -> None:
    for path in ("/api/v1/states", "/console/pictures"):
        for headers in (
            {},
            as_bearer("wrong"),
            as_bearer("view-token") | {"Origin": "http://evil"},
        ):
            with (
                pytest.raises(WebSocketDisconnect),
                visitor.websocket_connect(path, headers=headers) as socket,
            ):
                socket.receive()
    with visitor.websocket_connect("/api/v1/states", headers=as_bearer("view-token")) as socket:
        assert socket.receive_json()["number"] == 40


def test_other_sites_cannot_use_an_open_console(client: TestClient) -> None:
    """By their scripts, or by a name of theirs that leads to this machine."""
    assert client.get("/api/v1/state").status_code == 200
    assert client.get("/api/v1/state", headers={"Origin": "http://evil.example"}).status_code == 403
    assert client.get("/api/v1/state", headers={"Origin": "null"}).status_code == 403
    assert client.get("/api/v1/state", headers={"Host": "evil.example:8080"}).status_code == 403
    for strange in ("[", "http://[", "http://127.0.0.1:8080@evil.example"):
        assert client.get("/api/v1/state", headers={"Host": strange}).status_code == 403
        assert client.get("/api/v1/state", headers={"Origin": strange}).status_code == 403
    same = {"Origin": "http://127.0.0.1:8080"}
    assert client.get("/api/v1/state", headers=same).status_code == 200


def test_pages_may_load_nothing_from_elsewhere(client: TestClient) -> None:
    policy = client.get("/docs").headers["content-security-policy"]
    assert "default-src 'self'" in policy
    assert "http:" not in policy
    assert "*" not in policy
    assert "frame-ancestors 'none'" in policy
