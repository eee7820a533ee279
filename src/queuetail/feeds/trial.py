"""An answer that knows nothing, for trying feeds without a run."""

from __future__ import annotations

from datetime import UTC, datetime

from queuetail.config import Site
from queuetail.live.blind import blind_observation
from queuetail.live.records import Health, Published

WHY = "the feeds are being tried"


def unknown_answer(site: Site) -> Published:
    """Return an answer in which every approach of a site is unknown."""
    names = tuple(approach.name for approach in site.approach)
    seen = blind_observation((), names, 0.0, WHY)
    return Published(0, datetime.now(UTC), None, seen, Health())
