"""Cursor on Target: a spot at the end of each queue on TAK's maps, deleted when it is over.

Source: MITRE, Cursor-on-Target event schema 2.0 (public release, case 11-3895); `t-x-d-d` with
`__forcedelete` is how ATAK deletes.
"""

from __future__ import annotations

import ssl
from datetime import datetime
from typing import Protocol
from xml.etree import ElementTree as ET

from queuetail.feeds.answers import headline, iso
from queuetail.feeds.episodes import Notice, Step
from queuetail.feeds.settings import CotFeed
from queuetail.feeds.sockets import Datagrams, Stream
from queuetail.feeds.tls import tls_context

NOT_KNOWN = "9999999.0"  # of heights and errors, in metres
DELETE = "t-x-d-d"


class Sender(Protocol):
    """What carries bytes to TAK."""

    def send(self, data: bytes) -> None:
        """Send; raises OSError."""

    def close(self) -> None:
        """Let go."""


def sender(feed: CotFeed) -> Sender:
    """Return what carries events to the feed's address; raises InputError for certificates."""
    if feed.url.startswith("udp://"):
        return Datagrams(feed.url, feed.ttl)
    context: ssl.SSLContext | None = None
    if feed.url.startswith("tls://"):
        context = tls_context(feed.ca_file, feed.cert_file, feed.key_file)
    return Stream(feed.url, context, feed.server_name)


def event(notice: Notice, feed: CotFeed) -> bytes:
    """Return the event of a notice as XML, in one line."""
    end = notice.answer.end
    assert end is not None
    assert end.at is not None
    is_over = notice.step is Step.CANCEL
    root = ET.Element(
        "event",
        {
            "version": "2.0",
            "uid": f"{notice.id}.delete" if is_over else notice.id,
            "type": DELETE if is_over else feed.type,
            "time": _time(notice.sent),
            "start": _time(notice.sent),
            "stale": _time(notice.expires),
            "how": "m-g",
        },
    )
    ET.SubElement(
        root,
        "point",
        {
            "lat": f"{end.at[0]:.7f}",
            "lon": f"{end.at[1]:.7f}",
            "hae": NOT_KNOWN,
            "ce": f"{end.measured_m - end.station_m + end.sigma_m:.1f}",
            "le": NOT_KNOWN,
        },
    )
    detail = ET.SubElement(root, "detail")
    if is_over:
        ET.SubElement(detail, "link", {"uid": notice.id, "relation": "none", "type": feed.type})
        ET.SubElement(detail, "__forcedelete")
        ET.SubElement(detail, "remarks").text = f"cancelled: {notice.why}"
    else:
        name = f"{feed.callsign} {notice.answer.approach}".strip()
        ET.SubElement(detail, "contact", {"callsign": name})
        ET.SubElement(detail, "remarks").text = headline(notice.answer)
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _time(utc: datetime) -> str:
    return iso(utc)
