"""MQTT with a real broker: retained state, order over a kill, the last will, TLS, expiry."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from feed_answers import CLEAR, LOST, published, queue, wait_until
from pydantic import ValidationError
from receivers import Broker, certificate

from queuetail.errors import InputError
from queuetail.feeds import mqtt
from queuetail.feeds.answers import Reader
from queuetail.feeds.mqtt import VARIABLE, MqttSink
from queuetail.feeds.settings import MqttFeed
from queuetail.live.records import OutletState

ENVIRONMENT = {VARIABLE: "secret words"}
DYING = """
import sys, time
sys.path[:0] = sys.argv[2:]
from feed_answers import CLEAR, published
from test_mqtt import sink_to
sink = sink_to(int(sys.argv[1]))
sink.offer(published(CLEAR))
while sink.health().delivered < 1:
    time.sleep(0.01)
print("told", flush=True)
time.sleep(60)
"""


def sink_to(port: int, **keys: Any) -> MqttSink:
    feed = MqttFeed(host="127.0.0.1", port=port, username="queuetail", **keys)
    return MqttSink("a site", Reader(2.0), feed, 25.0, ENVIRONMENT)


def state(broker: Broker) -> tuple[list[str], dict[str, Any]]:
    """Return what the broker retains: topic, retained, expiry; and the state."""
    (line,) = broker.messages("queuetail/state", 1)
    *facts, payload = line.split(" ", 3)
    return facts, json.loads(payload)


def statuses(record: dict[str, Any]) -> list[str]:
    return [approach["status"] for approach in record["approaches"]]


def test_changes_in_order_and_the_newest_state_over_a_kill_of_the_broker(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        watcher = ("-i", "watcher", "-c", "-x", "3600")
        sink = sink_to(broker.port)
        try:
            sink.offer(published(CLEAR))
            wait_until(lambda: sink.health().delivered == 1)
            facts, record = state(broker)
            assert facts == ["queuetail/state", "1", "10"]
            assert statuses(record) == ["clear"]
            # A session that outlives the broker shall hear all that is published meanwhile.
            assert broker.messages("queuetail/event", 1, *watcher, limit_s=1) == []
            broker.kill()
            states = (queue(), queue(1900.0), LOST, queue(1800.0))
            for at_s, each in enumerate(states, 1):
                sink.offer(published(each, at_s=at_s))
            wait_until(lambda: sink.health().state is OutletState.RETRYING)
            broker.start()
            wait_until(lambda: sink.health().delivered == 5)
            _, record = state(broker)
        finally:
            sink.close()
        assert statuses(record) == ["queued"]
        assert record["approaches"][0]["end"]["measured_station_m"] == 1800.0
        events = [
            json.loads(m.split(" ", 3)[3]) for m in broker.messages("queuetail/event", 5, *watcher)
        ]
        assert [e["status"] for e in events] == [
            *("queued", "queued", "unknown", "queued", "unknown")
        ]
        assert [e["sequence"] for e in events] == [2, 3, 4, 5, 6]
        _, record = state(broker)
        assert statuses(record) == ["unknown"]
        assert record["approaches"][0]["reasons"] == ["queuetail has ended"]


def test_a_death_leaves_unknown_behind(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        paths = [p for p in sys.path if p]
        process = subprocess.Popen(
            [sys.executable, "-c", DYING, str(broker.port), *paths],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "told\n"
            assert statuses(state(broker)[1]) == ["clear"]
        finally:
            process.kill()
            process.communicate()
        wait_until(lambda: statuses(state(broker)[1]) == ["unknown"])
        facts, record = state(broker)
        assert facts[1] == "1"
        assert record["approaches"][0]["reasons"] == ["queuetail is not connected"]


def test_tls_is_verified_and_a_wrong_password_is_told(tmp_path: Path) -> None:
    tls = certificate(tmp_path)
    with Broker(tmp_path, tls) as broker:
        strangers = sink_to(broker.port, tls=True)
        sink = sink_to(broker.port, tls=True, ca_file=tls[0], protocol="3.1.1")
        try:
            strangers.offer(published(CLEAR))
            sink.offer(published(CLEAR))
            wait_until(lambda: sink.health().delivered == 1)
            wait_until(lambda: strangers.health().state is OutletState.RETRYING)
            assert "certificate" in strangers.health().last_error.lower()
        finally:
            sink.close()
            strangers.close()
    with Broker(tmp_path) as broker:
        feed = MqttFeed(host="127.0.0.1", port=broker.port, username="queuetail")
        sink = MqttSink("a site", Reader(2.0), feed, 25.0, {VARIABLE: "wrong"})
        sink.offer(published(CLEAR))
        wait_until(lambda: sink.health().state is OutletState.RETRYING)
        assert "uthori" in sink.health().last_error
        sink.close()


def test_a_missing_library_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aiomqtt", None)
    with pytest.raises(InputError, match="install queuetail with its extra live"):
        mqtt.MqttSink("site", Reader(2.0), MqttFeed(host="x"), 25.0, {})


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"topic": "a/#"}, "topic"),
        ({"ca_file": "x"}, "certificates need tls"),
        ({"tls": True, "cert_file": "x"}, "go together"),
        ({"password_file": "x"}, "needs its username"),
        ({"every_s": 6}, "twice every_s"),
    ],
)
def test_what_is_wrong_in_the_site_file(keys: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError, match=sentence):
        MqttFeed(host="x", **keys)
