"""What the topics of a recording hold, as JSON Schemas: ours, and Foxglove's where they fit.

Sources: mcap.dev/spec, registry entry "jsonschema"; foxglove/schemas, LocationFix and Log.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
INTEGER: Schema = {"type": "integer"}
TEXT: Schema = {"type": "string"}
MAYBE_NUMBER: Schema = {"type": ["number", "null"]}
UTC: Schema = {"type": "string", "format": "date-time"}
PAIR: Schema = {"type": "array", "items": NUMBER, "minItems": 2, "maxItems": 2}
MAYBE_PAIR: Schema = {**PAIR, "type": ["array", "null"]}
TEXTS: Schema = {"type": "array", "items": TEXT}
TIME: Schema = {
    "type": "object",
    "title": "time",
    "properties": {
        "sec": {"type": "integer", "minimum": 0},
        "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999},
    },
}


def _object(title: str, description: str, **properties: Schema) -> Schema:
    return {
        "title": title,
        "description": description,
        "type": "object",
        "properties": properties,
        "required": sorted(properties),
    }


SAMPLE = {
    "lat_deg": MAYBE_NUMBER,
    "lon_deg": MAYBE_NUMBER,
    "height_agl_m": MAYBE_NUMBER,
    "heading_deg": MAYBE_NUMBER,
    "gimbal_pitch_deg": MAYBE_NUMBER,
    "gimbal_roll_deg": MAYBE_NUMBER,
    "hfov_deg": MAYBE_NUMBER,
}
EOQ = _object(
    "queuetail.EndOfQueue",
    "The rear bumper of the most upstream queued vehicle",
    station_m=MAYBE_NUMBER,
    sigma_m=MAYBE_NUMBER,
    enu_m={"type": "array", "items": MAYBE_NUMBER, "minItems": 2, "maxItems": 2},
    px={"type": "array", "items": MAYBE_NUMBER, "minItems": 2, "maxItems": 2},
    lat_deg=MAYBE_NUMBER,
    lon_deg=MAYBE_NUMBER,
    track_id=INTEGER,
    length_m=MAYBE_NUMBER,
    vehicles=INTEGER,
    growth_mps=MAYBE_NUMBER,
)
STATE = _object(
    "queuetail.QueueState",
    "The answer for one approach",
    approach=TEXT,
    status={"enum": ["clear", "queued", "beyond_view", "unknown"]},
    reasons=TEXTS,
    eoq={"anyOf": [EOQ, {"type": "null"}]},
)

RUN = _object(
    "queuetail.Run",
    "What the run was started with: the first message of every segment",
    format=INTEGER,
    queuetail_version=TEXT,
    preset=TEXT,
    site={"type": "object"},
    source=TEXT,
    started_utc=UTC,
    time_shift_s=NUMBER,
)
FRAME = _object(
    "queuetail.Frame",
    "A frame that was processed: which it is in the video, its time, and its telemetry",
    number=INTEGER,
    session=INTEGER,
    pts_s=MAYBE_NUMBER,
    index=INTEGER,
    t_s=NUMBER,
    utc=UTC,
    size_px=PAIR,
    origin=MAYBE_PAIR,
    registration=_object(
        "queuetail.Registration",
        "How well the picture's motion is known",
        quality=NUMBER,
        reason=TEXT,
        epoch=INTEGER,
    ),
    telemetry={"anyOf": [{"type": "object", "properties": SAMPLE}, {"type": "null"}]},
    telemetry_t_s=MAYBE_NUMBER,
)
ANSWER = _object(
    "queuetail.Answer",
    "What was published: one state per approach",
    number=INTEGER,
    t_s=NUMBER,
    utc=UTC,
    of_frame={"type": "boolean"},
    doubts=TEXTS,
    states={"type": "array", "items": STATE},
)
TELEMETRY = _object(
    "queuetail.Telemetry",
    "A telemetry sample as it arrived",
    utc=UTC,
    t_s=NUMBER,
    source=TEXT,
    sample={"type": "object", "properties": SAMPLE},
)
EVENT = _object(
    "queuetail.Event",
    "What changed, as in a run's events.jsonl",
    t_s=NUMBER,
    approach=TEXT,
    event=TEXT,
    status=TEXT,
    eoq_lat=MAYBE_NUMBER,
    eoq_lon=MAYBE_NUMBER,
    eoq_station_m=MAYBE_NUMBER,
    eoq_sigma_m=MAYBE_NUMBER,
    length_m=MAYBE_NUMBER,
    vehicles={"type": ["integer", "null"]},
    growth_mps=MAYBE_NUMBER,
    reasons=TEXTS,
)
HEALTH: Schema = {
    "title": "queuetail.Health",
    "description": "How well the run was, once a second: the fields of queuetail's Health record",
    "type": "object",
    "properties": {
        "frame_age_s": MAYBE_NUMBER,
        "registration": MAYBE_NUMBER,
        "frames_captured": INTEGER,
        "frames_processed": INTEGER,
        "frames_dropped": INTEGER,
        "reconnects": INTEGER,
        "frame_rate_hz": MAYBE_NUMBER,
        "latency_p50_ms": MAYBE_NUMBER,
        "latency_p99_ms": MAYBE_NUMBER,
        "warnings": TEXTS,
    },
}
LOCATION_FIX: Schema = {
    "title": "foxglove.LocationFix",
    "description": "A navigation satellite fix for any Global Navigation Satellite System",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "frame_id": TEXT,
        "latitude": NUMBER,
        "longitude": NUMBER,
        "altitude": NUMBER,
        "position_covariance": {"type": "array", "items": NUMBER, "minItems": 9, "maxItems": 9},
        "position_covariance_type": {
            "title": "foxglove.PositionCovarianceType",
            "oneOf": [
                {"title": "UNKNOWN", "const": 0},
                {"title": "APPROXIMATED", "const": 1},
                {"title": "DIAGONAL_KNOWN", "const": 2},
                {"title": "KNOWN", "const": 3},
            ],
        },
    },
}
LOG: Schema = {
    "title": "foxglove.Log",
    "description": "A log message",
    "type": "object",
    "properties": {
        "timestamp": TIME,
        "level": {
            "title": "foxglove.LogLevel",
            "oneOf": [
                {"title": "UNKNOWN", "const": 0},
                {"title": "DEBUG", "const": 1},
                {"title": "INFO", "const": 2},
                {"title": "WARNING", "const": 3},
                {"title": "ERROR", "const": 4},
                {"title": "FATAL", "const": 5},
            ],
        },
        "message": TEXT,
        "name": TEXT,
        "file": TEXT,
        "line": INTEGER,
    },
}

TOPICS: dict[str, Schema] = {
    "/run": RUN,
    "/frame": FRAME,
    "/answer": ANSWER,
    "/telemetry": TELEMETRY,
    "/event": EVENT,
    "/health": HEALTH,
    "/camera": LOCATION_FIX,
    "/eoq": LOCATION_FIX,  # and one below it for every approach: /eoq/NB
    "/log": LOG,
}


def schema_of(topic: str) -> Schema:
    """Return the schema of a topic; what is below a topic has the same."""
    return TOPICS[f"/{topic.split('/')[1]}"]
