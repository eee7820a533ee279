"""The state of one approach as JSON: what MQTT and webhooks carry, and WZDx as its extension."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

from queuetail.feeds.answers import Answer, headline, iso

FORMAT = "queuetail-state-1"


def state_record(answer: Answer, valid_s: float) -> dict[str, Any]:
    """Return an answer for JSON; docs/feeds.md explains every field."""
    return {
        "approach": answer.approach,
        "status": answer.status.value,
        "utc": iso(answer.utc),
        "valid_until": iso(answer.utc + timedelta(seconds=valid_s)),
        "text": headline(answer),
        "reasons": list(answer.reasons),
        "end": _end_record(answer),
    }


def _end_record(answer: Answer) -> dict[str, Any] | None:
    end = answer.end
    if end is None:
        return None
    return {
        "lat": end.at[0] if end.at is not None else None,
        "lon": end.at[1] if end.at is not None else None,
        "station_m": round(end.station_m, 2),
        "measured_station_m": round(end.measured_m, 2),
        "sigma_m": round(end.sigma_m, 2),
        "beyond_view": end.is_bound,
        "length_m": round(end.length_m, 1),
        "vehicles": end.vehicles,
        "growth_mps": None if end.growth_mps is None else round(end.growth_mps, 3) + 0.0,
    }
