"""From the site file to the feeds of a run: all at once, each by itself, none slowing the run."""

from __future__ import annotations

import asyncio
import json
import socket
import ssl
import subprocess
import sys
import threading
import tomllib
from pathlib import Path
from statistics import median
from threading import Thread
from time import perf_counter
from typing import Any

import httpx
import pytest
from fastapi import FastAPI
from feed_answers import CLEAR, LOST, published, queue, wait_until
from lxml import etree
from receivers import RawServer, certificate, free_port

from queuetail.config import Site, parse_settings
from queuetail.errors import InputError
from queuetail.feeds import sinks
from queuetail.feeds.build import Feeds, build_feeds, slug
from queuetail.feeds.sockets import Datagrams, Stream
from queuetail.feeds.tls import tls_context
from queuetail.feeds.webhook import VARIABLE
from queuetail.live.records import OutletState
from queuetail.types import QueueState

SITE = '[site]\nname = "I-35 NB, MP 174"\n[feeds]\nsettle_s = 0\n'
SECRET = {VARIABLE: "0123456789abcdef"}


def feeds_of(text: str) -> Feeds:
    return build_feeds(parse_settings(Site, tomllib.loads(SITE + text), "site.toml"), SECRET)


def offer(feeds: Feeds, *states: QueueState) -> None:
    for at_s, state in enumerate(states):
        answer = published(state, at_s=at_s)
        for sink in feeds.sinks:
            sink.offer(answer)


def get(app: FastAPI, path: str) -> httpx.Response:
    async def ask() -> httpx.Response:
        transport = httpx.ASGITransport(app)
        async with httpx.AsyncClient(transport=transport, base_url="http://127.0.0.1") as client:
            return await client.get(path)

    return asyncio.run(ask())


def test_no_table_no_feed() -> None:
    feeds = feeds_of("")
    assert feeds.sinks == ()
    assert feeds.pages == {}


def test_the_pages_are_served_by_the_router() -> None:
    feeds = feeds_of('[feeds.wzdx]\n[feeds.cifs]\n[feeds.cap]\nsender="a@b"\naddresses="x"\n')
    app = FastAPI()
    app.include_router(feeds.router())
    offer(feeds, queue())
    try:
        for path, content_type in (
            ("wzdx.geojson", "application/geo+json"),
            ("cifs.json", "application/json"),
            ("cap.xml", "application/atom+xml"),
        ):
            reply = get(app, f"/feeds/{path}")
            assert reply.status_code == 200
            assert reply.headers["content-type"].startswith(content_type)
            assert reply.headers["cache-control"] == "no-store"
            assert reply.content == feeds.pages[f"/feeds/{path}"]().body
        assert get(app, "/feeds/other").status_code == 404
    finally:
        feeds.close()
    assert [s.health().state for s in feeds.sinks] == [OutletState.OK] * 3


def test_a_document_is_not_built_for_every_reader_and_follows_every_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sinks, "REBUILT_S", 60.0)
    feeds = feeds_of("[feeds.wzdx]\n")
    page = feeds.pages["/feeds/wzdx.geojson"]
    offer(feeds, CLEAR)
    assert page() is page()
    offer(feeds, queue())
    assert b'"queued"' in page().body
    feeds.close()
    assert b"queuetail has ended" in page().body


def test_a_site_file_with_feeds_survives_a_recording() -> None:
    """Runs and recordings keep the settings as JSON, without any secret."""
    site = parse_settings(Site, tomllib.loads(SITE + ALL.format(1)), "site.toml")
    assert Site.model_validate(json.loads(json.dumps(site.model_dump(mode="json")))) == site


def test_files_are_replaced_whole_and_say_unknown_at_the_end(tmp_path: Path) -> None:
    file = tmp_path / "wzdx.geojson"
    feeds = feeds_of(f'[feeds.wzdx]\nfile = "{file}"\n')
    offer(feeds, CLEAR, queue())
    wait_until(lambda: file.exists() and "queued" in file.read_text("utf-8"))
    feeds.close()
    (feature,) = json.loads(file.read_text("utf-8"))["features"]
    assert feature["properties"]["eoq"]["reasons"] == ["queuetail has ended"]
    assert list(tmp_path.iterdir()) == [file]


def test_a_folder_that_is_not_there_is_told_and_written_once_it_is(tmp_path: Path) -> None:
    file = tmp_path / "later" / "cifs.json"
    feeds = feeds_of(f'[feeds.cifs]\nfile = "{file}"\n')
    try:
        offer(feeds, queue())
        wait_until(lambda: feeds.sinks[0].health().state is OutletState.RETRYING)
        file.parent.mkdir()
        wait_until(file.exists)
    finally:
        feeds.close()


@pytest.fixture
def udp() -> Any:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(15)
        yield receiver


def test_cot_by_udp_from_spot_to_deletion(udp: socket.socket) -> None:
    port = udp.getsockname()[1]
    feeds = feeds_of(f'[feeds.cot]\nurl = "udp://127.0.0.1:{port}"\n')
    offer(feeds, CLEAR, queue(), queue(1900.0), LOST, queue())
    feeds.close()
    kinds = [etree.fromstring(udp.recv(65_536)).get("type") for _ in range(5)]
    assert kinds == ["b-m-p-s-m", "b-m-p-s-m", "t-x-d-d", "b-m-p-s-m", "t-x-d-d"]


def test_denms_by_udp(udp: socket.socket) -> None:
    its = pytest.importorskip("pycrate_asn1dir.ITS_DENM_3")
    port = udp.getsockname()[1]
    feeds = feeds_of(f'[feeds.denm]\nurl = "udp://127.0.0.1:{port}"\nstation_id = 1\n')
    offer(feeds, queue(), CLEAR)
    feeds.close()
    kinds = []
    for _ in range(2):
        its.DENM_PDU_Descriptions.DENM.from_uper(udp.recv(65_536))
        read = its.DENM_PDU_Descriptions.DENM.get_val()
        kinds.append(read["denm"]["management"].get("termination"))
    assert kinds == [None, "isCancellation"]


def test_a_multicast_is_heard() -> None:
    group, port = "239.255.77.77", free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        receiver.bind((group, port))
        member = socket.inet_aton(group) + socket.inet_aton("0.0.0.0")
        sender = Datagrams(f"udp://{group}:{port}", ttl=0)
        try:
            receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
            receiver.settimeout(2)
            sender.send(b"here")
            assert receiver.recv(100) == b"here"
        except OSError as error:
            pytest.skip(f"this machine routes no multicast: {error}")
        finally:
            sender.close()


def listen(server: socket.socket, got: list[bytes], wrap: Any = None) -> Thread:
    """Accept one connection and keep what it sends, in a thread."""

    def work() -> None:
        connection, _ = server.accept()
        with wrap(connection) if wrap else connection as stream:
            while data := stream.recv(65_536):
                got.append(data)

    thread = Thread(target=work, daemon=True)
    thread.start()
    return thread


def test_a_stream_is_connected_anew_when_the_peer_closed_it() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        stream = Stream(f"tcp://127.0.0.1:{server.getsockname()[1]}")
        got: list[bytes] = []

        def once() -> None:
            connection, _ = server.accept()
            with connection:
                got.append(connection.recv(100))
                connection.sendall(b"chatter of a TAK server" * 1000)

        first = Thread(target=once, daemon=True)
        first.start()
        stream.send(b"one")
        first.join(15)
        second = listen(server, got)
        wait_until(lambda: sent(stream, b"two") and b"two" in b"".join(got))
        stream.close()
        second.join(15)
    assert got[0] == b"one"


def sent(stream: Stream, data: bytes) -> bool:
    try:
        stream.send(data)
    except OSError:
        return False
    return True


def test_a_stream_over_tls_with_the_servers_own_name(tmp_path: Path) -> None:
    cert, key = certificate(tmp_path)
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(cert, key)
    with socket.create_server(("127.0.0.1", 0)) as server:
        got: list[bytes] = []
        reader = listen(server, got, lambda c: context.wrap_socket(c, server_side=True))
        url = f"tls://127.0.0.1:{server.getsockname()[1]}"
        stream = Stream(url, tls_context(cert), "localhost")
        stream.send(b"secret")
        stream.close()
        reader.join(15)
    assert b"".join(got) == b"secret"


def test_tims_are_posted_replaced_and_deleted(tmp_path: Path) -> None:
    requests: list[str] = []

    def ode(connection: socket.socket) -> None:
        head = connection.recv(65_536).decode().split("\r\n")[0]
        requests.append(" ".join(head.split()[:2]))
        connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n")

    request = tmp_path / "request.json"
    request.write_text('{"rsus": [{"rsuIndex": 3}, {"rsuIndex": 4}]}')
    request.chmod(0o600)
    with RawServer(ode) as server:
        feeds = feeds_of(
            f'[feeds.tim]\nurl = "http://127.0.0.1:{server.port}/tim"\nallow_private = true\n'
            f'request_file = "{request}"\n'
        )
        offer(feeds, queue(), queue(1900.0), LOST)
        feeds.close()
    assert requests == [
        "POST /tim",
        "PUT /tim",
        "DELETE /tim?index=3",
        "DELETE /tim?index=4",
    ]


ALL = """
[feeds.wzdx]
[feeds.cifs]
[feeds.cap]
sender = "a@b"
addresses = "x"
url = "http://127.0.0.1:{0}/"
allow_private = true
[feeds.mqtt]
host = "127.0.0.1"
port = {0}
[feeds.cot]
url = "tcp://127.0.0.1:{0}"
[feeds.tim]
url = "http://127.0.0.1:{0}/tim"
allow_private = true
[feeds.denm]
url = "udp://127.0.0.1:{0}"
station_id = 1
[[feeds.webhook]]
url = "http://127.0.0.1:{0}/"
allow_private = true
"""


def test_all_receivers_away_cost_the_run_nothing_and_it_ends_soon() -> None:
    feeds = feeds_of(ALL.format(free_port()))
    assert len(feeds.sinks) == 9
    times_s = []
    for number in range(300):
        answer = published(queue(2000.0 - number, 1.0), at_s=number / 15)
        started_s = perf_counter()
        for sink in feeds.sinks:
            sink.offer(answer)
        times_s.append(perf_counter() - started_s)
    names = {sink.health().name for sink in feeds.sinks}
    assert names == {*("wzdx", "cifs", "cap", "cap posts", "mqtt", "webhook", "cot", "tim", "denm")}
    wait_until(
        lambda: sum(sink.health().state is OutletState.RETRYING for sink in feeds.sinks) >= 5
    )
    started_s = perf_counter()
    feeds.close()
    assert perf_counter() - started_s < 15.0
    assert median(times_s) < 0.02  # a picture comes every 66 ms; about 1 ms when idle


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (
            '[[feeds.webhook]]\nurl = "https://example.org/"\nsecret_file = "/none"',
            "cannot be read",
        ),
        ('[feeds.cot]\nurl = "tls://h:1"\nca_file = "/none.pem"', "no such certificate"),
        ('[feeds.cot]\nurl = "udp://host"', "scheme|udp://host:port"),
        ('[feeds.denm]\nurl = "tcp://host:1"\nstation_id = 1', "udp://host:port"),
        ("[feeds.wzdx]\nfil = 1", "did you mean 'file'"),
        ('direction = "north"', "feeds.direction"),
        ('[feeds.cap]\nsender = "a b"', "feeds.cap.sender"),
        ('[feeds.cap]\nsender = "a"', "needs addresses"),
        ('[feeds.cap]\nsender = "a"\nscope = "Restricted"', "needs its restriction"),
        ('[[feeds.webhook]]\nurl = "ftp://h/"', "begins with https"),
        (2 * '[[feeds.webhook]]\nurl = "https://h/"\n', "two webhooks"),
    ],
)
def test_what_is_wrong_is_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as refusal:
        feeds_of(text)
    assert "\n" not in str(refusal.value)


def test_a_feed_that_cannot_be_made_leaves_no_thread_behind(tmp_path: Path) -> None:
    before = threading.active_count()
    with pytest.raises(InputError):
        feeds_of(
            f'[feeds.cifs]\nfile = "{tmp_path}/c.json"\n'
            '[[feeds.webhook]]\nurl = "https://h/"\nsecret_file = "/none"\n'
        )
    assert threading.active_count() == before


def test_settings_load_no_library() -> None:
    """`queuetail --help` reads the settings of every part."""
    code = "import sys, queuetail.config; print({'aiomqtt', 'fastapi', 'ssl'} & {*sys.modules})"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "set()"


def test_slugs_fit_every_format() -> None:
    assert slug("I-35 NB, MP 174 (é)") == "i-35-nb-mp-174"
    assert slug("…") == "site"
