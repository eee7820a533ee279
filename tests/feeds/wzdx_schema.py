"""The official WZDx 4.2 schemas as a validator that needs no network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from jsonschema import Draft7Validator, FormatChecker
from referencing import Registry, Resource
from referencing.jsonschema import DRAFT7

BASE = "https://geojson.org/schema/"
POSITION = {"type": "array", "minItems": 2, "items": {"type": "number"}}


def geometry(name: str, coordinates: dict[str, Any]) -> dict[str, Any]:
    """Return a stand-in for one of geojson.org's schemas, which the WZDx repository lacks."""
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "type": "object",
        "required": ["type", "coordinates"],
        "properties": {"type": {"enum": [name]}, "coordinates": coordinates},
    }


STUBS = {
    f"{BASE}Point.json": geometry("Point", POSITION),
    f"{BASE}LineString.json": geometry("LineString", {"type": "array", "items": POSITION}),
    f"{BASE}MultiPoint.json": geometry("MultiPoint", {"type": "array", "items": POSITION}),
}


def device_feed_validator(shared: Path) -> Draft7Validator:
    """Return a validator of device feeds."""
    schemas = [json.loads(p.read_text("utf-8")) for p in (shared / "wzdx" / "4.2").glob("*.json")]
    known = {s["$id"]: s for s in schemas} | STUBS
    pairs = [(uri, Resource.from_contents(s, DRAFT7)) for uri, s in known.items()]
    registry: Registry[Any] = Registry().with_resources(pairs)
    feed = next(s for uri, s in known.items() if uri.endswith("/DeviceFeed.json"))
    return Draft7Validator(feed, registry=registry, format_checker=FormatChecker())
