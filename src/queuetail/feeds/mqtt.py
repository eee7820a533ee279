"""MQTT: the state of every approach, retained, and every change of it.

`TOPIC/state` holds the newest state only, with an expiry (MQTT 5) after which the broker forgets
it; the last will sets it to unknown.  `TOPIC/event` gets every change in order, also those that
happened while the broker was away; each says until when it was true.
"""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from threading import Lock
from time import monotonic
from typing import TYPE_CHECKING, Any

from queuetail.errors import InputError
from queuetail.feeds.answers import Answer, Reader
from queuetail.feeds.episodes import ENDED, Change, Report, Reporter
from queuetail.feeds.secrets import read_secret
from queuetail.feeds.settings import MqttFeed
from queuetail.feeds.sinks import CAPACITY, close_outlet
from queuetail.feeds.state_json import FORMAT, state_record
from queuetail.feeds.tls import tls_context
from queuetail.live.outlet import Outlet
from queuetail.live.records import OutletHealth, Published

if TYPE_CHECKING:
    import aiomqtt

LOG = logging.getLogger(__name__)
VARIABLE = "QUEUETAIL_MQTT_PASSWORD"
PORT, TLS_PORT = 1883, 8883
TIMEOUT_S = 5.0
KEEPALIVE_S = 10.0  # a broker publishes the will after one and a half of it
LONGEST_PAUSE_S = 5.0
DISCONNECTED = "queuetail is not connected"


class MqttSink:
    """A live sink that keeps a broker at the newest state."""

    def __init__(
        self,
        site: str,
        reader: Reader,
        feed: MqttFeed,
        moved_m: float,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Read the password and start; raises InputError for secrets or a missing library."""
        self._link = _Link(site, feed, environment)
        self._reader, self._book = reader, Reporter(feed.every_s, moved_m)
        self._lock = Lock()
        self._utc: datetime | None = None
        self._is_closed = False
        self._outlet: Outlet[Report] = Outlet(
            "mqtt",
            self._link.publish,
            CAPACITY,
            longest_pause_s=LONGEST_PAUSE_S,
            finish=self._link.close,
        )

    def offer(self, published: Published) -> None:
        """Take an answer and return at once."""
        with self._lock:
            if self._is_closed:
                return
            answers = self._reader.read(published)
            self._link.now = answers
            reports = self._book.take(answers, monotonic())
        self._queue(reports)

    def health(self) -> OutletHealth:
        """Return how the broker is reached."""
        return self._outlet.health()

    def close(self) -> None:
        """Say that nothing is known from now on, and disconnect, within a few seconds."""
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            now = self._link.now
            utc = now[0].utc if now else None
            self._link.now = tuple(answer.unknown(ENDED) for answer in now)
            last = self._book.end(monotonic(), utc) if utc is not None else ()
        self._queue(last)
        close_outlet(self._outlet)

    def _queue(self, reports: Sequence[Report]) -> None:
        """Queue every change, but a refresh only where nothing waits: the newest state goes too."""
        for report in reports:
            if report.change is not Change.REFRESH or self._outlet.health().waiting == 0:
                self._outlet.offer(report)


class _Link:
    """The connection to the broker; all but `now` is for the outlet's thread only."""

    def __init__(self, site: str, feed: MqttFeed, environment: Mapping[str, str] | None) -> None:
        try:
            import aiomqtt  # noqa: PLC0415 - only where a site file asks for MQTT
        except ImportError:
            raise InputError(
                "MQTT needs the package aiomqtt; install queuetail with its extra live"
            ) from None
        self._library = aiomqtt
        self._site, self._feed = site, feed
        self._password = None
        if feed.username is not None:
            what = "the password for MQTT"
            self._password = read_secret(feed.password_file, VARIABLE, what, environment)
        certificates = feed.ca_file, feed.cert_file, feed.key_file
        self._context = tls_context(*certificates) if feed.tls else None
        self._loop: asyncio.Runner | None = None
        self._client: aiomqtt.Client | None = None
        self._event_sent = 0
        self.now: tuple[Answer, ...] = ()

    def publish(self, report: Report) -> None:
        """Publish a change, then the newest state; connects where there is no connection."""
        if self._loop is None:
            self._loop = asyncio.Runner()
            # The library's own leftovers of a broken connection: `health` tells of it already.
            self._loop.get_loop().set_exception_handler(_leave_unsaid)
        try:
            self._loop.run(self._publish(report))
        except BaseException:
            self._loop.run(self._leave(in_order=False))
            raise

    def close(self) -> None:
        """Disconnect in order, so that the last will is not published: the last state stays."""
        if self._loop is None:
            return
        try:
            self._loop.run(self._leave(in_order=True))
        finally:
            self._loop.close()
            self._loop = None

    async def _publish(self, report: Report) -> None:
        if self._client is None:
            await self._enter()
        assert self._client is not None
        topic = self._feed.topic
        # Not again where it came through and only the state after it did not.
        if report.change is not Change.REFRESH and report.sequence > self._event_sent:
            record = {
                "sequence": report.sequence,
                "change": report.change.value,
                **state_record(report.answer, self._feed.valid_s),
            }
            await self._client.publish(f"{topic}/event", self._json(record), qos=1)
            self._event_sent = report.sequence
        state = self._json({"approaches": self._states(self.now)})
        await self._client.publish(
            f"{topic}/state", state, qos=1, retain=True, properties=self._expiry()
        )

    async def _enter(self) -> None:
        library, feed = self._library, self._feed
        unknown = [answer.unknown(DISCONNECTED) for answer in self.now]
        states = [
            {"approach": a.approach, "status": "unknown", "reasons": list(a.reasons)}
            for a in unknown
        ]
        version = library.ProtocolVersion
        client = library.Client(
            feed.host,
            feed.port or (TLS_PORT if feed.tls else PORT),
            username=feed.username,
            password=self._password,
            tls_context=self._context,
            protocol=version.V5 if feed.protocol == "5" else version.V311,
            will=library.Will(f"{feed.topic}/state", self._json({"approaches": states}), 1, True),
            timeout=TIMEOUT_S,
            # Pings go out with what is published: the loop runs only then.
            keepalive=math.ceil(max(KEEPALIVE_S, 2 * feed.every_s)),
        )
        await client.__aenter__()
        self._client = client

    async def _leave(self, in_order: bool) -> None:
        client, self._client = self._client, None
        if client is None:
            return
        try:
            await client.__aexit__(None, None, None)
        except Exception:
            if in_order:
                raise

    def _states(self, answers: Sequence[Answer]) -> list[dict[str, Any]]:
        valid_s, now_s = self._feed.valid_s, monotonic()
        return [state_record(answer.at_age(now_s, valid_s), valid_s) for answer in answers]

    def _json(self, record: Mapping[str, Any]) -> str:
        whole = {"format": FORMAT, "site": self._site, **record}
        return json.dumps(whole, ensure_ascii=False, allow_nan=False)

    def _expiry(self) -> Any:
        """Return the properties that let the broker forget a state; only MQTT 5 has them."""
        if self._feed.protocol != "5":
            return None
        from paho.mqtt.packettypes import PacketTypes  # noqa: PLC0415 - comes with aiomqtt
        from paho.mqtt.properties import Properties  # noqa: PLC0415

        properties: Any = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        properties.MessageExpiryInterval = math.ceil(self._feed.valid_s)
        return properties


def _leave_unsaid(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Keep a fault that nobody awaits off the user's terminal."""
    LOG.debug("%s: %s", context.get("message"), context.get("exception"))
