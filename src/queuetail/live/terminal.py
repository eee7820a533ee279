"""What a live run shows: one line kept fresh on a terminal, a line per change elsewhere."""

from __future__ import annotations

import re
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from queuetail.live.records import Published
from queuetail.sinks.words import status_words
from queuetail.types import QueueStatus

COLOURS = {
    QueueStatus.CLEAR: "green",
    QueueStatus.QUEUED: "bold red",
    QueueStatus.BEYOND_VIEW: "bold red",
    QueueStatus.UNKNOWN: "bold yellow",
}
REFRESH_HZ = 2


class StatusView:
    """Shows the newest answer; call :meth:`show` as often as you like."""

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or Console()
        self._live = (
            Live(console=self._console, refresh_per_second=REFRESH_HZ)
            if self._console.is_terminal
            else None
        )
        self._last: tuple[str, ...] = ()

    def __enter__(self) -> StatusView:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, published: Published | None) -> None:
        """Show an answer, where it says anything new."""
        if published is None:
            return
        if self._live is not None:
            self._live.update(status_text(published))
            return
        kind = kind_of(published)
        if kind != self._last:
            self._last = kind
            self._console.print(
                status_text(published), soft_wrap=True, highlight=False, no_wrap=True
            )


def status_text(published: Published) -> Text:
    """Return one line per approach, and one on the run's health."""
    health = published.health
    lines = Text()
    for state in published.observation.states:
        name = f"{state.approach}: " if state.approach else ""
        lines.append(f"{published.utc:%H:%M:%S} {name}")
        lines.append(status_words(state), COLOURS[state.status])
        lines.append("\n")
    parts = []
    if health.frame_rate_hz is not None:
        parts.append(f"{health.frame_rate_hz:.0f} pictures/s")
    if health.latency_p50_ms is not None and health.latency_p99_ms is not None:
        parts.append(f"latency {health.latency_p50_ms:.0f} ms (99 %: {health.latency_p99_ms:.0f})")
    if health.telemetry_age_s:
        parts.append(f"telemetry {max(health.telemetry_age_s.values()):.1f} s old")
    parts.append(f"{health.frames_dropped} dropped, {health.reconnects} reconnects")
    lines.append(f"         {' · '.join(parts)}", "dim")
    for warning in health.warnings:
        lines.append(f"\n         {warning}", "yellow")
    return lines


def kind_of(published: Published) -> tuple[str, ...]:
    """Return what makes one answer differ from another in kind: not its numbers."""
    states = published.observation.states
    texts = [f"{s.approach} {s.status.value} {'; '.join(s.reasons)}" for s in states]
    return tuple(re.sub(r"[\d.]+", "#", text) for text in (*texts, *published.health.warnings))
