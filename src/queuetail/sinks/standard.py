"""The files that every run writes."""

from __future__ import annotations

from queuetail.sinks import RunInfo, Sink
from queuetail.sinks.annotated import NAME, AnnotatedVideo
from queuetail.sinks.events import EventsJsonl
from queuetail.sinks.report import Report
from queuetail.sinks.tables import QueueCsv, TracksCsv


def standard_sinks(info: RunInfo, video: bool) -> list[Sink]:
    """Open the run folder's files, in the order in which they are to be closed.

    Without `video` an older run's annotated.mp4 is removed: it would show other results.
    """
    sinks: list[Sink] = [QueueCsv(info), TracksCsv(info), EventsJsonl(info)]
    if video:
        sinks.append(AnnotatedVideo(info))
    else:
        (info.out / NAME).unlink(missing_ok=True)
    sinks.append(Report(info))  # last: it reads what the others wrote
    return sinks
