"""Waze CIFS: an incident for each queue that stands now.

A feed without an incident says nothing: CIFS has no way to say that a road is clear.
Source: developers.google.com/waze/data-feed/cifs-specification.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from queuetail.feeds.answers import Answer, iso
from queuetail.feeds.episodes import Notice, NoticeBook
from queuetail.feeds.settings import CifsFeed

PATH = "/feeds/cifs.json"
KINDS = {
    "jam": ("JAM", "JAM_STAND_STILL_TRAFFIC"),
    "hazard": ("HAZARD", "HAZARD_ON_ROAD_CONSTRUCTION"),
}
SHORTEST_M = 30.0  # a line needs a length that a map can match


class CifsPages:
    """Builds the feed from the messages that stand."""

    content_type = "application/json"

    def __init__(self, road: str, feed: CifsFeed, book: NoticeBook) -> None:
        self._street, self._feed, self._book = feed.street or road, feed, book

    def take(self, answers: Sequence[Answer], now_s: float) -> bool:
        """Take the newest answers; true when an incident changed."""
        return bool(self._book.take(answers, now_s))

    def end(self, now_s: float, utc: datetime) -> None:
        """Let go of every incident."""
        self._book.end(now_s, utc)

    def build(self, now_s: float, utc: datetime) -> bytes:
        """Return the feed; what has expired is not in it."""
        incidents = [{"incident": self.incident(n)} for n in self._book.current(now_s)]
        text = json.dumps({"incidents": incidents}, indent=1, ensure_ascii=False, allow_nan=False)
        return (text + "\n").encode()

    def incident(self, notice: Notice) -> dict[str, Any]:
        """Return one incident; its line runs from the end of the queue in driving direction."""
        end, road = notice.answer.end, notice.answer.road
        assert end is not None
        assert road is not None
        head_m = max(end.measured_m + end.length_m, end.station_m + SHORTEST_M)
        points = road.path(end.station_m, head_m)
        kind, subtype = KINDS[self._feed.kind]
        return {
            "id": notice.id,
            "type": kind,
            "subtype": subtype,
            "polyline": " ".join(f"{lat:.7f} {lon:.7f}" for lat, lon in points),
            "street": self._street,
            "direction": "ONE_DIRECTION",
            "starttime": _offset(notice.began),
            "endtime": _offset(notice.expires),
            "description": "Stopped traffic ahead, be prepared to stop",
        }


def _offset(utc: datetime) -> str:
    """Return a time in ISO 8601 with an offset, as CIFS shows it."""
    return iso(utc).replace("Z", "+00:00")
