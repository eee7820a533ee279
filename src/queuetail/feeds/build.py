"""From the `[feeds]` of a site file to the live sinks and the pages of a run."""

from __future__ import annotations

import re
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from queuetail.config import Site
from queuetail.feeds import cap, cifs, cot, wzdx
from queuetail.feeds.answers import Reader
from queuetail.feeds.denm import Encoder
from queuetail.feeds.episodes import Notice, NoticeBook, Reporter
from queuetail.feeds.mqtt import MqttSink
from queuetail.feeds.posting import Poster
from queuetail.feeds.settings import CapFeed, FeedsSettings
from queuetail.feeds.sinks import Document, PageSink, PushSink, notice_delivery
from queuetail.feeds.sockets import Datagrams
from queuetail.feeds.tim import VALID_MIN, TimPoster
from queuetail.feeds.webhook import Webhook
from queuetail.live.outlet import LiveSink

if TYPE_CHECKING:
    from fastapi import APIRouter

REFRESHES = 3  # within the time that a message stands, where its table does not say how often


@dataclass(frozen=True, slots=True)
class Feeds:
    """The feeds of one run: sinks to subscribe, and documents by path, to be served."""

    sinks: tuple[LiveSink, ...]
    pages: Mapping[str, Callable[[], Document]]

    def close(self) -> None:
        """Close every sink; those that are closed already stay so."""
        for sink in self.sinks:
            sink.close()

    def router(self) -> APIRouter:
        """Return the pages as routes for a FastAPI application."""
        from fastapi import APIRouter, Response  # noqa: PLC0415 - only the console has it

        def serve(page: Callable[[], Document]) -> Response:
            document = page()
            return Response(document.body, media_type=document.content_type, headers=HEADERS)

        router = APIRouter()
        for path, page in self.pages.items():
            router.add_api_route(
                path, partial(serve, page), response_model=None, include_in_schema=False
            )
        return router


HEADERS = {"Cache-Control": "no-store"}  # an answer lives for seconds


def build_feeds(site: Site, environment: Mapping[str, str] | None = None) -> Feeds:
    """Make every feed that the site file switches on; raises InputError for secrets and files.

    The sinks are started, so they have to be closed, also where making a later one fails.
    """
    maker = _Maker(site, environment)
    try:
        maker.make()
    except BaseException:
        for sink in maker.sinks:
            sink.close()
        raise
    return Feeds(tuple(maker.sinks), maker.pages)


class _Maker:
    """Makes the feeds of one run, which share a reader and the run's name."""

    def __init__(self, site: Site, environment: Mapping[str, str] | None) -> None:
        self._site, self._environment = site.site.name, environment
        self._settings: FeedsSettings = site.feeds
        self._road = site.feeds.road or site.site.name
        self._reader = Reader(site.feeds.sigma_factor)
        self._run = f"{slug(site.site.name)}-{uuid.uuid4().hex[:8]}"
        self.sinks: list[LiveSink] = []
        self.pages: dict[str, Callable[[], Document]] = {}

    def make(self) -> None:
        """Make all that are switched on."""
        self._documents()
        settings, environment = self._settings, self._environment
        if settings.mqtt is not None:
            self.sinks.append(
                MqttSink(self._site, self._reader, settings.mqtt, settings.moved_m, environment)
            )
        for hook in settings.webhook:
            book = Reporter(hook.refresh_s, settings.moved_m)
            deliver = Webhook(self._site, self._run, hook, environment).deliver
            self.sinks.append(PushSink(hook.name, self._reader, book, deliver))
        self._messages()

    def _documents(self) -> None:
        """Make the feeds that others fetch."""
        settings = self._settings
        if settings.wzdx is not None:
            pages = wzdx.WzdxPages(self._site, settings, settings.wzdx)
            self._page("wzdx", wzdx.PATH, pages, settings.wzdx.file)
        if settings.cifs is not None:
            incidents = cifs.CifsPages(
                self._road, settings.cifs, self._book("cifs", settings.cifs.valid_s)
            )
            self._page("cifs", cifs.PATH, incidents, settings.cifs.file)
        if settings.cap is not None:
            alerts = cap.CapPages(
                settings.organization,
                self._road,
                settings.cap,
                self._book("cap", settings.cap.valid_s),
            )
            self._page("cap", cap.PATH, alerts, None)
            if settings.cap.url is not None:
                self._posted_alerts(settings.cap, settings.cap.url)

    def _posted_alerts(self, feed: CapFeed, url: str) -> None:
        poster = Poster(url, feed)
        headers = {"Content-Type": cap.CONTENT_TYPE}

        def send(notice: Notice) -> None:
            body = cap.alert_text(notice, self._settings.organization, self._road, feed)
            poster.send(body, headers)

        self._push("cap posts", self._book("cap-post", feed.valid_s), send)

    def _messages(self) -> None:
        """Make the feeds that send messages about each queue."""
        settings = self._settings
        if settings.cot is not None:
            feed = settings.cot
            carrier = cot.sender(feed)
            self._push(
                "cot",
                self._book("cot", feed.valid_s, feed.refresh_s),
                lambda notice: carrier.send(cot.event(notice, feed)),
                carrier.close,
            )
        if settings.tim is not None:
            poster = TimPoster(settings.tim, self._road)
            book = self._book("tim", VALID_MIN * 60.0, settings.tim.refresh_s)
            self._push("tim", book, poster.deliver)
        if settings.denm is not None:
            encoder = Encoder(settings.denm)
            datagrams = Datagrams(settings.denm.url)
            self._push(
                "denm",
                self._book("denm", settings.denm.valid_s, settings.denm.refresh_s),
                lambda notice: datagrams.send(encoder.encode(notice)),
                datagrams.close,
            )

    def _page(
        self,
        name: str,
        path: str,
        pages: wzdx.WzdxPages | cifs.CifsPages | cap.CapPages,
        file: Path | None,
    ) -> None:
        sink = PageSink(name, self._reader, pages, file)
        self.sinks.append(sink)
        self.pages[path] = sink.document

    def _push(
        self,
        name: str,
        book: NoticeBook,
        send: Callable[[Notice], None],
        finish: Callable[[], None] | None = None,
    ) -> None:
        self.sinks.append(PushSink(name, self._reader, book, notice_delivery(send), finish))

    def _book(self, name: str, valid_s: float, refresh_s: float | None = None) -> NoticeBook:
        settings = self._settings
        return NoticeBook(
            f"{self._run}-{name}",
            valid_s,
            refresh_s if refresh_s is not None else valid_s / REFRESHES,
            settings.settle_s,
            settings.moved_m,
        )


def slug(text: str) -> str:
    """Return a name of letters, digits and dashes, as identifiers of every format may hold."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")[:40] or "site"
