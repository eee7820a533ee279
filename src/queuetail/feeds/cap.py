"""CAP 1.2 alerts: begun, updated while the queue moves, cancelled when it dissolves or is unknown.

Source: OASIS CAP-v1.2-os (2010), sections 3.2 and 3.3; the feed of alerts is Atom (RFC 4287).
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from xml.etree import ElementTree as ET

from queuetail.feeds.answers import Answer, End, headline, iso
from queuetail.feeds.episodes import Notice, NoticeBook, Step
from queuetail.feeds.settings import CapFeed

PATH = "/feeds/cap.xml"
CONTENT_TYPE = "application/cap+xml"
NAMESPACE = "urn:oasis:names:tc:emergency:cap:1.2"
ATOM = "http://www.w3.org/2005/Atom"
ET.register_namespace("cap", NAMESPACE)
ET.register_namespace("atom", ATOM)
MESSAGE_TYPE = {Step.NEW: "Alert", Step.UPDATE: "Update", Step.CANCEL: "Cancel"}
LEAST_RADIUS_KM = 0.05
OVER = "The queue was seen to dissolve."
NOT_CLEAR = "The warning no longer stands; this does not say that the road is clear."


class CapPages:
    """Builds an Atom feed with the newest message about each queue, until it expires."""

    content_type = "application/atom+xml"

    def __init__(self, organization: str, road: str, feed: CapFeed, book: NoticeBook) -> None:
        self._organization, self._road, self._feed, self._book = organization, road, feed, book
        self._newest: dict[str, Notice] = {}
        self._updated: datetime | None = None

    def take(self, answers: Sequence[Answer], now_s: float) -> bool:
        """Take the newest answers; true when there is a new message."""
        notices = self._book.take(answers, now_s)
        self._keep(notices, now_s)
        return bool(notices)

    def end(self, now_s: float, utc: datetime) -> None:
        """Cancel every alert that stands."""
        self._keep(self._book.end(now_s, utc), now_s)

    def build(self, now_s: float, utc: datetime) -> bytes:
        """Return the feed; what has expired is not in it."""
        feed = ET.Element(_atom("feed"))
        _add(feed, _atom("id"), f"urn:queuetail:cap:{self._feed.sender}")
        _add(feed, _atom("title"), f"Ends of queues: {self._road}")
        _add(feed, _atom("updated"), iso(self._updated or utc))
        author = ET.SubElement(feed, _atom("author"))
        _add(author, _atom("name"), self._organization)
        for notice in self._newest.values():
            if now_s >= notice.expires_s:
                continue
            entry = ET.SubElement(feed, _atom("entry"))
            _add(entry, _atom("id"), f"urn:queuetail:cap:{notice.identifier}")
            _add(entry, _atom("title"), title(notice))
            _add(entry, _atom("updated"), iso(notice.sent))
            content = ET.SubElement(entry, _atom("content"), {"type": CONTENT_TYPE})
            content.append(alert(notice, self._organization, self._road, self._feed))
        return _text(feed)

    def _keep(self, notices: Sequence[Notice], now_s: float) -> None:
        """Keep the newest message about each queue; expired ones are let go."""
        self._newest = {k: n for k, n in self._newest.items() if now_s < n.expires_s}
        for notice in notices:
            self._newest[notice.id] = notice
            self._updated = notice.sent


def alert_text(notice: Notice, organization: str, road: str, feed: CapFeed) -> bytes:
    """Return one CAP message as a document of its own."""
    return _text(alert(notice, organization, road, feed))


def alert(notice: Notice, organization: str, road: str, feed: CapFeed) -> ET.Element:
    """Return one CAP message."""
    root = ET.Element(_cap("alert"))
    _add(root, _cap("identifier"), notice.identifier)
    _add(root, _cap("sender"), feed.sender)
    _add(root, _cap("sent"), cap_time(notice.sent))
    _add(root, _cap("status"), feed.status)
    _add(root, _cap("msgType"), MESSAGE_TYPE[notice.step])
    _add(root, _cap("source"), "queuetail")
    _add(root, _cap("scope"), feed.scope)
    if feed.scope == "Restricted" and feed.restriction is not None:
        _add(root, _cap("restriction"), feed.restriction)
    if feed.addresses is not None:
        quote = '"' if " " in feed.addresses else ""  # section 3.2.1
        _add(root, _cap("addresses"), f"{quote}{feed.addresses}{quote}")
    if notice.why:
        _add(root, _cap("note"), notice.why)
    if notice.references:
        told = (f"{feed.sender},{name},{cap_time(sent)}" for name, sent in notice.references)
        _add(root, _cap("references"), " ".join(told))
    _add_info(root, notice, organization, road)
    return root


def title(notice: Notice) -> str:
    """Return what a message says in one sentence."""
    if notice.step is Step.CANCEL:
        return f"Warning of stopped traffic cancelled: {notice.why}"
    return headline(notice.answer)


def _add_info(root: ET.Element, notice: Notice, organization: str, road: str) -> None:
    end = notice.answer.end
    assert end is not None
    assert end.at is not None
    is_over = notice.step is Step.CANCEL
    info = ET.SubElement(root, _cap("info"))
    _add(info, _cap("language"), "en-US")
    _add(info, _cap("category"), "Transport")
    _add(info, _cap("event"), "Stopped traffic")
    over = "AllClear" if notice.is_dissolved else "None"
    _add(info, _cap("responseType"), over if is_over else "Prepare")
    past = "Past" if notice.is_dissolved else "Unknown"
    _add(info, _cap("urgency"), past if is_over else "Immediate")
    _add(info, _cap("severity"), "Unknown" if is_over else "Severe")
    _add(info, _cap("certainty"), "Unknown" if is_over else "Observed")
    _add(info, _cap("effective"), cap_time(notice.sent))
    _add(info, _cap("onset"), cap_time(notice.began))
    _add(info, _cap("expires"), cap_time(notice.expires))
    _add(info, _cap("senderName"), organization)
    _add(info, _cap("headline"), title(notice))
    if is_over:
        _add(info, _cap("description"), OVER if notice.is_dissolved else NOT_CLEAR)
    else:
        _add(info, _cap("description"), _description(end, road))
        _add(info, _cap("instruction"), "Slow down and be prepared to stop.")
    area = ET.SubElement(info, _cap("area"))
    _add(area, _cap("areaDesc"), f"{road} {notice.answer.approach}".strip())
    _add(area, _cap("circle"), _circle(end))


def _description(end: End, road: str) -> str:
    assert end.at is not None
    lat, lon = end.at
    beyond = "or farther upstream" if end.is_bound else f"measured to ± {end.sigma_m:.1f} m"
    return (
        f"Traffic is stopped on {road}. The end of the queue is at {lat:.5f}, {lon:.5f} "
        f"(station {end.station_m:.0f} m, {beyond}); {end.vehicles} vehicles were seen in it."
    )


def _circle(end: End) -> str:
    """Return a circle about the queue's end that holds the queue as it is seen."""
    assert end.at is not None
    radius_km = max((end.measured_m - end.station_m + end.length_m) / 1000, LEAST_RADIUS_KM)
    return f"{end.at[0]:.6f},{end.at[1]:.6f} {radius_km:.3f}"


def cap_time(utc: datetime) -> str:
    """Return a time as CAP 1.2 wants it: whole seconds, and -00:00 for UTC (section 3.3.2)."""
    return utc.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S-00:00")


def _cap(name: str) -> str:
    return f"{{{NAMESPACE}}}{name}"


def _atom(name: str) -> str:
    return f"{{{ATOM}}}{name}"


def _add(parent: ET.Element, name: str, text: str) -> None:
    ET.SubElement(parent, name).text = text


def _text(root: ET.Element) -> bytes:
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))
