"""Health as data: for `/health`, for `/metrics`, and for whatever page shows it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import GaugeMetricFamily, Metric

from queuetail.live.feed import LIMIT_S, NEEDED
from queuetail.live.records import Health, OutletState, Published
from queuetail.live.runtime import STALL_S
from queuetail.types import QueueStatus

METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"
DELIVERY = tuple(OutletState)


def unwell(newest: Published | None, health: Health) -> tuple[str, ...]:
    """Return a sentence for each thing that keeps answers from being made or delivered."""
    found = []
    if newest is None or newest.frame is None:
        reason = newest.observation.registration.reason if newest else ""
        found.append(reason or "there is no answer yet")
    elif health.frame_age_s is None or health.frame_age_s > STALL_S:
        found.append("no picture comes")
    for name in NEEDED:
        age_s = health.telemetry_age_s.get(name, 0.0)
        if age_s > LIMIT_S:
            found.append(f"the {name.replace('_', ' ')} is {age_s:.0f} s old")
    found += [
        f"{o.name} does not deliver: {o.last_error}"
        for o in health.outlets
        if o.state is OutletState.FAILED
    ]
    return tuple(found)


def health_record(newest: Published | None, health: Health) -> dict[str, Any]:
    """Return all of it for JSON; ``ok`` is false where something keeps answers away."""
    problems = unwell(newest, health)
    return {
        "ok": not problems,
        "problems": problems,
        "answers": newest.number if newest else 0,
        "utc": newest.utc.isoformat() if newest else None,
        "approaches": [
            {
                "approach": state.approach,
                "status": state.status.value,
                "eoq_station_m": state.eoq.station_m if state.eoq else None,
                "reasons": state.reasons,
            }
            for state in (newest.observation.states if newest else ())
        ],
        **asdict(health),
    }


def metrics(newest: Published | None, health: Health) -> bytes:
    """Return health in Prometheus' text format."""
    registry = CollectorRegistry()
    registry.register(_Collected(newest, health))
    return generate_latest(registry)


class _Collected:
    """One reading, in the form that the Prometheus library asks for."""

    def __init__(self, newest: Published | None, health: Health) -> None:
        self._newest, self._health = newest, health

    def collect(self) -> Iterator[Metric]:
        """Yield every metric that has a value."""
        health = self._health
        well = not unwell(self._newest, health)
        yield _gauge("ok", "1 when answers are made and delivered", float(well))
        for name, text, value in (
            ("frame_age_seconds", "since the newest picture arrived", health.frame_age_s),
            ("registration_quality", "0 (lost) to 1", health.registration),
            ("frame_rate_hz", "pictures processed per second", health.frame_rate_hz),
            ("frames_captured", "pictures decoded in this run", health.frames_captured),
            ("frames_processed", "pictures processed in this run", health.frames_processed),
            ("frames_dropped", "pictures left out for newer ones", health.frames_dropped),
            ("reconnects", "times the video was connected again", health.reconnects),
            ("memory_bytes", "of the process", _times(health.memory_mb, 1e6)),
            ("disk_free_bytes", "where files are written", _times(health.disk_free_mb, 1e6)),
            ("latency_p50_seconds", "arrival to answer, median", _times(health.latency_p50_ms)),
            ("latency_p99_seconds", "arrival to answer, 99 %", _times(health.latency_p99_ms)),
        ):
            if value is not None:
                yield _gauge(name, text, float(value))
        yield from self._by_quantity()
        yield from self._by_outlet()
        yield from self._by_approach()

    def _by_quantity(self) -> Iterator[Metric]:
        yield _labelled(
            "telemetry_age_seconds", "of each quantity", "quantity", self._health.telemetry_age_s
        )
        yield _labelled(
            "telemetry_rate_hz", "of each quantity", "quantity", self._health.telemetry_rate_hz
        )

    def _by_outlet(self) -> Iterator[Metric]:
        outlets = self._health.outlets
        for name, text, values in (
            ("outlet_delivered", "deliveries", {o.name: o.delivered for o in outlets}),
            ("outlet_dropped", "dropped before delivery", {o.name: o.dropped for o in outlets}),
            ("outlet_waiting", "waiting for delivery", {o.name: o.waiting for o in outlets}),
            (
                "outlet_state",
                "0 off, 1 ok, 2 retrying, 3 failed",
                {o.name: DELIVERY.index(o.state) for o in outlets},
            ),
        ):
            yield _labelled(name, text, "outlet", values)

    def _by_approach(self) -> Iterator[Metric]:
        status = GaugeMetricFamily(
            "queuetail_queue_status",
            "1 for the status that each approach has",
            labels=("approach", "status"),
        )
        station = GaugeMetricFamily(
            "queuetail_eoq_station_meters", "of the end of the queue", labels=("approach",)
        )
        for state in self._newest.observation.states if self._newest else ():
            for each in QueueStatus:
                status.add_metric((state.approach, each.value), float(state.status is each))
            if state.eoq is not None:
                station.add_metric((state.approach,), state.eoq.station_m)
        yield status
        yield station


def _gauge(name: str, text: str, value: float) -> Metric:
    return GaugeMetricFamily(f"queuetail_{name}", text, value=value)


def _labelled(name: str, text: str, label: str, values: dict[str, Any]) -> Metric:
    family = GaugeMetricFamily(f"queuetail_{name}", text, labels=(label,))
    for key, value in values.items():
        family.add_metric((key,), float(value))
    return family


def _times(value: float | None, factor: float = 1e-3) -> float | None:
    return None if value is None else value * factor
