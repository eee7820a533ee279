"""Which telemetry goes with which video."""

from __future__ import annotations

from pathlib import Path

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.flight import open_flight
from queuetail.live.feed import LiveFeed, NoFeed, RecordedFeed, TelemetryFeed
from queuetail.video.stream_source import Kind, StreamSource


def open_feed(spec: str | None, source: StreamSource, site: Site) -> TelemetryFeed:
    """Return the telemetry that `spec` names, not yet started; raises InputError.

    Without one it is what lies beside or in a recording, the KLV inside a stream, or nothing where
    control points say all.
    """
    path = None if spec is None else Path(spec)
    is_log = path is not None and path.is_file()
    if source.kind is Kind.FILE and (spec is None or is_log):
        with open_flight(Path(source.address), path, site) as flight:
            name = flight.telemetry_path.name if flight.telemetry_path else "none"
            return RecordedFeed(flight.telemetry_at, name, site)
    if spec is None:
        return NoFeed() if site.control_point else LiveFeed(None, site)
    if is_log:
        raise InputError(
            f"{spec} is a recorded log, and {source.name} is live; name a live source such as "
            f"radio:/dev/ttyUSB0, or play the log in real time with csv:{spec}"
        )
    from queuetail.telemetry.live_sources import open_source  # noqa: PLC0415 - loads every protocol

    return LiveFeed(open_source(spec), site)
