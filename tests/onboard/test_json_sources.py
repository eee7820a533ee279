"""Bridges: JSON over UDP, and DJI's Cloud API through a real broker that is restarted."""

from __future__ import annotations

import asyncio
import json
import shutil
import socket
import time
from pathlib import Path

import aiomqtt
import pytest

from link_doubles import Heard, broker, free_port, wait_for
from queuetail.errors import InputError
from queuetail.link.messages import ClockTime, Gimbal, Lens, Position
from queuetail.onboard import sources

DRONE = "1ZNBK7LC00AB"


def osd(lat: float, **extra: object) -> str:
    data = {"latitude": lat, "longitude": -97.0, "gimbal_pitch": -60, "gimbal_yaw": 10, **extra}
    return json.dumps({"timestamp": int(time.time() * 1000), "gateway": "RC1", "data": data})


def test_json_over_udp() -> None:
    port = free_port()
    heard = Heard()
    source = sources.flight_controller(f"dji-json:udp:127.0.0.1:{port}")
    source.start(heard)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bridge:

        def say() -> bool:
            for text in (b"garbage", b"{}", json.dumps({"lat": 36.0, "lon": -97.0}).encode()):
                bridge.sendto(text, ("127.0.0.1", port))
            bridge.sendto(osd(36.5).encode(), ("127.0.0.1", port))
            return len(heard.of(Position)) >= 4

        wait_for(say, "positions")
    source.stop()
    assert Position(36.0, -97.0) in heard.of(Position)
    assert Position(36.5, -97.0) in heard.of(Position)
    assert heard.of(ClockTime)[0].utc_s == pytest.approx(time.time(), abs=30)


async def publish(port: int, messages: list[tuple[str, str, bool]]) -> None:
    async with aiomqtt.Client("127.0.0.1", port) as client:
        for topic, payload, retain in messages:
            await client.publish(topic, payload, retain=retain)


def test_djis_cloud_over_mqtt(tmp_path: Path) -> None:
    program = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")
    if program is None:
        pytest.skip("mosquitto is not installed")
    port = free_port(socket.SOCK_STREAM)
    heard = Heard()
    source = sources.flight_controller(f"dji:mqtt://127.0.0.1:{port}/{DRONE}")
    topic = f"thing/product/{DRONE}/osd"
    with broker(program, tmp_path, port):
        asyncio.run(publish(port, [(topic, osd(1.0), True)]))  # of any age: not to be believed
        source.start(heard)
        messages = [
            (topic, "no json", False),
            (topic, osd(36.5), False),
            ("thing/product/OTHER/osd", osd(2.0), False),
            ("thing/product/RC1/drc/up", osd(36.6), False),
            (f"queuetail/{DRONE}/telemetry", '{"hfov_deg": 84}', False),
        ]

        def all_heard() -> bool:
            asyncio.run(publish(port, messages))
            return Position(36.6, -97.0) in heard.of(Position) and bool(heard.of(Lens))

        wait_for(all_heard, "osd, osd_info_push and our own JSON")
    wait_for(lambda: source.state.error, "the broker's end to be seen")
    count = len(heard.pairs)
    with broker(program, tmp_path, port):
        wait_for(
            lambda: asyncio.run(publish(port, messages)) or len(heard.pairs) > count,
            "messages after the broker's restart",
        )
        source.stop()
    assert {p.lat_deg for p in heard.of(Position)} == {36.5, 36.6}
    assert heard.of(Gimbal)[0] == Gimbal(10.0, -60.0, None)
    assert source.state.reconnects >= 1


@pytest.mark.parametrize(
    "spec",
    [
        "dji:http://host/SN",
        "dji:mqtt://host",
        "dji:mqtt://host:99999/SN",
        "dji:mqtt:///SN",
        "dji:mqtt://host/a/b",
        "dji:mqtt://user:secret@host/SN",
        "dji-json:udp:many",
    ],
)
def test_words_that_name_no_bridge_are_refused(spec: str) -> None:
    with pytest.raises(InputError) as caught:
        sources.flight_controller(spec)
    assert "secret" not in str(caught.value)
