"""A hostile address does no harm: it is not reached, not followed, not waited for, not believed."""

from __future__ import annotations

import ipaddress
import socket
import ssl
from pathlib import Path
from threading import Event
from time import monotonic

import pytest
from pydantic import ValidationError
from receivers import RawServer, certificate

from queuetail.errors import InputError
from queuetail.feeds import posting
from queuetail.feeds.posting import Poster, Refused, forbidden
from queuetail.feeds.settings import Posted, WebhookFeed
from queuetail.live.outlet import Undeliverable

OURS = Posted(allow_private=True, timeout_s=0.5)
OK = b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n"
LONG_S = 8.0  # however loaded the machine is; the limit is half a second


def receive(connection: socket.socket) -> bytes:
    """Read a request to the end of its body, which says `end`."""
    data = b""
    while not data.endswith(b"end"):
        piece = connection.recv(65_536)
        if not piece:
            break
        data += piece
    return data


def send_to(server: RawServer, settings: Posted = OURS) -> None:
    Poster(f"http://127.0.0.1:{server.port}/in?x=1", settings).send(b"the end", {"X-A": "b"})


@pytest.mark.parametrize(
    "address",
    [
        *("127.0.0.1", "10.1.2.3", "172.16.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1"),
        *("0.0.0.0", "255.255.255.255", "224.0.0.1", "::1", "::", "fe80::1", "fc00::1", "ff02::1"),
        *("::ffff:127.0.0.1", "64:ff9b::7f00:1", "2002:7f00:1::", "64:ff9b::a9fe:a9fe"),
    ],
)
def test_addresses_of_this_machine_and_of_private_networks_are_refused(address: str) -> None:
    assert forbidden(ipaddress.ip_address(address), allow_private=False)


def test_addresses_of_the_internet_are_not_and_private_ones_are_not_where_permitted() -> None:
    for address in ("8.8.8.8", "2001:4860:4860::8888", "64:ff9b::808:808"):
        assert not forbidden(ipaddress.ip_address(address), allow_private=False)
    assert not forbidden(ipaddress.ip_address("127.0.0.1"), allow_private=True)
    assert forbidden(ipaddress.ip_address("224.0.0.1"), allow_private=True)


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "2130706433", "0x7f.1", "[::1]"])
def test_a_refused_address_is_never_connected_to(host: str) -> None:
    with RawServer(lambda c: c.sendall(OK)) as server:
        poster = Poster(f"http://{host}:{server.port}/", Posted())
        with pytest.raises((Refused, OSError)) as refusal:
            poster.send(b"end", {})
        assert server.connections == 0
    if isinstance(refusal.value, Refused):
        assert "allow_private = true permits it" in str(refusal.value)


def test_one_private_address_among_others_is_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    found = tuple(map(ipaddress.ip_address, ("93.184.216.34", "127.0.0.1")))
    monkeypatch.setattr(posting, "resolved", lambda host, port: found)
    with pytest.raises(Refused, match=r"example\.org is 127\.0\.0\.1"):
        Poster("https://example.org/", Posted()).send(b"end", {})


def test_a_good_receiver_gets_the_request() -> None:
    got: list[bytes] = []

    def behave(connection: socket.socket) -> None:
        got.append(receive(connection))
        connection.sendall(OK)

    with RawServer(behave) as server:
        send_to(server)
    head = got[0].decode()
    assert head.startswith("POST /in?x=1 HTTP/1.1\r\n")
    assert "X-A: b\r\n" in head
    assert "User-Agent: queuetail/" in head


def test_redirects_are_not_followed() -> None:
    with RawServer(lambda c: c.sendall(OK)) as inner:
        there = f"HTTP/1.1 307 X\r\nLocation: http://127.0.0.1:{inner.port}/\r\n\r\n".encode()

        def redirect(connection: socket.socket) -> None:
            receive(connection)
            connection.sendall(there)

        with RawServer(redirect) as server, pytest.raises(Refused, match="307"):
            send_to(server)
        assert inner.connections == 0


def drip(connection: socket.socket) -> None:
    receive(connection)
    for byte in b"HTTP/1.1 200 OK\r\nX-Slow: " + b"a" * 10_000:
        connection.sendall(bytes([byte]))
        Event().wait(0.05)


def continue_forever(connection: socket.socket) -> None:
    receive(connection)
    while True:
        connection.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")


def headers_forever(connection: socket.socket) -> None:
    receive(connection)
    connection.sendall(b"HTTP/1.1 200 OK\r\n")
    while True:
        connection.sendall(b"X-More: " + b"a" * 60_000 + b"\r\n")


def silence(connection: socket.socket) -> None:
    Event().wait(LONG_S)


def garbage(connection: socket.socket) -> None:
    receive(connection)
    connection.sendall(b"\x00\xff" * 1000 + b"\r\n\r\n")


@pytest.mark.parametrize(
    "misbehave", [drip, continue_forever, headers_forever, silence, garbage, lambda c: None]
)
def test_misbehaviour_ends_as_an_error_in_time(misbehave: object) -> None:
    started_s = monotonic()
    with RawServer(misbehave) as server, pytest.raises(OSError, match=r"."):  # type: ignore[arg-type]
        send_to(server)
    assert monotonic() - started_s < LONG_S


def test_an_endless_answer_is_read_up_to_a_limit() -> None:
    sent = [0]

    def flood(connection: socket.socket) -> None:
        receive(connection)
        connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        while True:
            sent[0] += connection.send(b"a" * 65_536)

    with RawServer(flood) as server:
        send_to(server)
    assert sent[0] < 50_000_000


@pytest.mark.parametrize(
    ("status", "error"),
    [(404, OSError), (429, OSError), (503, OSError), (400, Undeliverable), (422, Undeliverable)],
)
def test_what_a_receiver_refuses(status: int, error: type[Exception]) -> None:
    """A message that can never be taken must not hold up those after it; all else is retried."""

    def answer(connection: socket.socket) -> None:
        receive(connection)
        connection.sendall(f"HTTP/1.1 {status} No\r\nContent-Length: 0\r\n\r\n".encode())

    with RawServer(answer) as server, pytest.raises(error, match=str(status)):
        send_to(server)


def test_tls_is_verified(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(cert, key)

    def behave(connection: socket.socket) -> None:
        with context.wrap_socket(connection, server_side=True) as secure:
            receive(secure)
            secure.sendall(OK)

    with RawServer(behave) as server:
        url = f"https://localhost:{server.port}/"
        ours = Posted(allow_private=True, ca_file=cert)
        Poster(url, ours).send(b"end", {})
        with pytest.raises(OSError, match="TLS failed"):
            Poster(url, Posted(allow_private=True)).send(b"end", {})
    with pytest.raises(InputError, match="no such certificate"):
        Poster(url, Posted(ca_file=tmp_path / "none.pem"))
    with pytest.raises(InputError, match="no certificate that can be read"):
        Poster(url, Posted(ca_file=key))


@pytest.mark.parametrize(
    ("url", "sentence"),
    [
        ("http://example.org/", "http:// is for your own network only"),
        ("https://user:word@example.org/", "must not hold a user"),
        ("file:///etc/passwd", "begins with https"),
        ("https:///x", "names a host"),
        ("https://example.org:99999/", "the port"),
        ("https://example.org/a b", "no spaces"),
        ("gopher://example.org/", "begins with https"),
    ],
)
def test_addresses_that_are_none_are_refused_in_the_site_file(url: str, sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        WebhookFeed(url=url)
