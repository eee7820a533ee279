"""Health as data: what is wrong is said, monitoring gets numbers, and 503 means no answers."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from prometheus_client.parser import text_string_to_metric_families

from queuetail.live.blind import blind_observation
from queuetail.live.health import health_record, metrics, unwell
from queuetail.live.records import Health, OutletHealth, OutletState, Published
from queuetail.types import Frame

WELL = Health(
    frame_age_s=0.04,
    telemetry_age_s={"position": 0.1, "hfov": 600.0},
    telemetry_rate_hz={"position": 10.0},
    registration=0.9,
    frames_captured=900,
    frames_processed=450,
    frames_dropped=3,
    reconnects=1,
    frame_rate_hz=15.0,
    latency_p50_ms=40.0,
    latency_p99_ms=80.0,
    memory_mb=300.0,
    disk_free_mb=5000.0,
    outlets=(OutletHealth("queue.csv", OutletState.OK, delivered=450),),
)
FRAME = Frame(0, 1.0, np.zeros((2, 2), np.uint8), lambda w, h: np.zeros((h, w, 3), np.uint8))


def published(health: Health, frame: Frame | None = FRAME) -> Published:
    observation = blind_observation((), ("NB",), 1.0, "no picture for 3.0 s: it is off")
    return Published(7, datetime(2026, 5, 14, 15, 30, tzinfo=UTC), frame, observation, health)


def test_what_keeps_answers_away_is_said() -> None:
    assert unwell(published(WELL), WELL) == ()
    assert unwell(None, Health()) == ("there is no answer yet",)
    blind = published(replace(WELL, frame_age_s=3.0), frame=None)
    assert unwell(blind, blind.health) == ("no picture for 3.0 s: it is off",)
    old = replace(WELL, telemetry_age_s={"position": 9.0})
    assert unwell(published(old), old) == ("the position is 9 s old",)
    full = replace(
        WELL, outlets=(OutletHealth("queue.csv", OutletState.FAILED, last_error="no space left"),)
    )
    assert unwell(published(full), full) == ("queue.csv does not deliver: no space left",)
    trying = replace(WELL, outlets=(OutletHealth("feed", OutletState.RETRYING),))
    assert unwell(published(trying), trying) == ()


def test_the_record_is_json() -> None:
    record = json.loads(json.dumps(health_record(published(WELL), WELL)))
    assert record["ok"] is True
    assert record["latency_p99_ms"] == 80.0
    assert record["approaches"][0]["status"] == "unknown"
    assert record["outlets"][0] == {
        "name": "queue.csv",
        "state": "ok",
        "delivered": 450,
        "dropped": 0,
        "waiting": 0,
        "last_error": "",
        "delivery_age_s": None,
    }
    assert json.loads(json.dumps(health_record(None, Health())))["ok"] is False


def test_metrics_are_what_prometheus_reads() -> None:
    text = metrics(published(WELL), WELL).decode()
    samples = {
        (s.name, *s.labels.values()): s.value
        for family in text_string_to_metric_families(text)
        for s in family.samples
    }
    assert samples["queuetail_ok",] == 1
    assert samples["queuetail_latency_p99_seconds",] == pytest.approx(0.08)
    assert samples["queuetail_memory_bytes",] == pytest.approx(3e8)
    assert samples["queuetail_telemetry_age_seconds", "position"] == pytest.approx(0.1)
    assert samples["queuetail_outlet_state", "queue.csv"] == 1
    assert samples["queuetail_queue_status", "NB", "unknown"] == 1
    assert samples["queuetail_queue_status", "NB", "clear"] == 0
    nothing = metrics(None, Health()).decode()
    assert "queuetail_ok 0.0" in nothing
    assert "queuetail_frame_age_seconds " not in nothing
