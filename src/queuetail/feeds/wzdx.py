"""WZDx 4.2 device feed: the drone as a traffic sensor at the end of the queue.

WZDx has no queue object.  The end of the queue is told in `eoq`, an extension of ours beside the
standard's properties, and in plain words in the standard's description; no enumeration is extended.
Source: usdot-jpo-ode/wzdx, schemas/4.2/DeviceFeed.json.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from queuetail import __version__
from queuetail.feeds.answers import Answer, headline, iso
from queuetail.feeds.settings import FeedsSettings, WzdxFeed
from queuetail.feeds.state_json import FORMAT, state_record
from queuetail.types import QueueStatus

PATH = "/feeds/wzdx.geojson"
LICENSE = "https://creativecommons.org/publicdomain/zero/1.0/"
NAMESPACE = uuid.uuid5(uuid.NAMESPACE_URL, "urn:queuetail:wzdx")
KPH_PER_MPS = 3.6


class WzdxPages:
    """Builds the feed from the newest answers; what is too old becomes unknown."""

    content_type = "application/geo+json"

    def __init__(self, site: str, settings: FeedsSettings, feed: WzdxFeed) -> None:
        self._site, self._settings, self._feed = site, settings, feed
        self._answers: tuple[Answer, ...] = ()
        self._written_s: float | None = None

    def take(self, answers: Sequence[Answer], now_s: float) -> bool:
        """Take the newest answers; a file is due every `update_s`, and at each new status."""
        before = {a.approach: a.status for a in self._answers}
        self._answers = tuple(answers)
        changed = before != {a.approach: a.status for a in answers}
        waited_s = None if self._written_s is None else now_s - self._written_s
        if changed or waited_s is None or waited_s >= self._feed.update_s:
            self._written_s = now_s
            return True
        return False

    def end(self, now_s: float, utc: datetime) -> None:
        """Know nothing from now on."""
        self._answers = tuple(a.unknown("queuetail has ended") for a in self._answers)

    def build(self, now_s: float, utc: datetime) -> bytes:
        """Return the feed as GeoJSON; an approach that has no place yet is left out."""
        record = self.record(now_s, utc)
        return (json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()

    def record(self, now_s: float, utc: datetime) -> dict[str, Any]:
        """Return the feed."""
        told = [a.at_age(now_s, self._settings.max_age_s) for a in self._answers]
        feed, settings = self._feed, self._settings
        info: dict[str, Any] = {
            "update_date": iso(utc),
            "version": "4.2",
            "publisher": settings.organization,
            "update_frequency": feed.update_s,
            "data_sources": [
                {
                    "data_source_id": feed.data_source_id,
                    "organization_name": settings.organization,
                    "update_frequency": feed.update_s,
                    "update_date": iso(utc),
                }
            ],
        }
        if feed.contact_name is not None:
            info["contact_name"] = feed.contact_name
        if feed.contact_email is not None:
            info["contact_email"] = feed.contact_email
        if feed.cc0:
            info["license"] = LICENSE
        features = [self._feature(answer) for answer in told if answer.road is not None]
        return {"feed_info": info, "type": "FeatureCollection", "features": features}

    def _feature(self, answer: Answer) -> dict[str, Any]:
        assert answer.road is not None
        settings = self._settings
        end = answer.end
        at = end.at if end is not None else None
        lat, lon = at if at is not None else answer.road.point(answer.road.middle_m)
        core: dict[str, Any] = {
            "device_type": "traffic-sensor",
            "data_source_id": self._feed.data_source_id,
            "device_status": "warning" if answer.status is QueueStatus.UNKNOWN else "ok",
            "update_date": iso(answer.utc),
            "has_automatic_location": True,
            "road_direction": settings.direction,
            "road_names": [settings.road or self._site],
            "name": f"queuetail {answer.approach}".strip(),
            "description": headline(answer),
            "status_messages": list(answer.reasons),
            "is_moving": True,
            "make": "queuetail",
            "firmware_version": __version__,
        }
        properties: dict[str, Any] = {
            "core_details": core,
            "collection_interval_start_date": iso(answer.utc),
            "collection_interval_end_date": iso(answer.utc),
        }
        if answer.speed_mps is not None:
            properties["average_speed_kph"] = round(answer.speed_mps * KPH_PER_MPS, 1)
        # A reader that polls keeps what it got until it asks again.
        valid_s = settings.max_age_s + self._feed.update_s
        properties["eoq"] = {"format": FORMAT, **state_record(answer, valid_s)}
        return {
            "id": str(uuid.uuid5(NAMESPACE, f"{self._feed.data_source_id}/{answer.approach}")),
            "type": "Feature",
            "properties": properties,
            "geometry": {"type": "Point", "coordinates": [lon, lat]},
        }
