"""The documents that others fetch, against official schemas and the published rules."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from cap_schema import check_alert
from feed_answers import CLEAR, LOST, START, answer, published, queue
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree
from wzdx_schema import device_feed_validator

from queuetail.feeds.answers import Reader
from queuetail.feeds.cap import ATOM, CapPages, alert_text
from queuetail.feeds.cap import NAMESPACE as CAP
from queuetail.feeds.cifs import CifsPages
from queuetail.feeds.episodes import NoticeBook
from queuetail.feeds.settings import CapFeed, CifsFeed, FeedsSettings, WzdxFeed
from queuetail.feeds.wzdx import WzdxPages
from queuetail.types import QueueState, QueueStatus

SETTINGS = FeedsSettings(organization="Example DOT", road="I-35", direction="northbound")
ALERTS = CapFeed(sender="noc@example.org", addresses="noc")
BEYOND = queue(status=QueueStatus.BEYOND_VIEW)

# developers.google.com/waze/data-feed/cifs-specification, read in November 2026: required and
# requested elements of an incident, its types, and the form of times and lines.
LINE = r"^-?\d{1,2}\.\d{6,} -?\d{1,3}\.\d{6,}( -?\d{1,2}\.\d{6,} -?\d{1,3}\.\d{6,})+$"
TIME = r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?[+-]\d\d:\d\d$"
CIFS_SCHEMA = {
    "type": "object",
    "required": ["incidents"],
    "additionalProperties": False,
    "properties": {
        "incidents": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["incident"],
                "additionalProperties": False,
                "properties": {
                    "incident": {
                        "type": "object",
                        "required": ["id", "type", "polyline", "street", "starttime", "endtime"],
                        "additionalProperties": False,
                        "properties": {
                            "id": {"type": "string", "minLength": 1},
                            "type": {
                                "enum": [
                                    *("ROAD_CLOSED", "ACCIDENT", "HAZARD"),
                                    *("POLICE", "CHIT_CHAT", "JAM"),
                                ]
                            },
                            "subtype": {
                                "enum": ["JAM_STAND_STILL_TRAFFIC", "HAZARD_ON_ROAD_CONSTRUCTION"]
                            },
                            "polyline": {"type": "string", "pattern": LINE},
                            "street": {"type": "string", "minLength": 1},
                            "direction": {"enum": ["ONE_DIRECTION", "BOTH_DIRECTIONS"]},
                            "starttime": {"type": "string", "pattern": TIME},
                            "endtime": {"type": "string", "pattern": TIME},
                            "description": {"type": "string"},
                        },
                    }
                },
            },
        }
    },
}


def wzdx(**keys: Any) -> WzdxPages:
    return WzdxPages("a site", SETTINGS, WzdxFeed(**keys))


def cifs(kind: str = "jam") -> CifsPages:
    book = NoticeBook("run", 120.0, 40.0, 2.0, 25.0)
    return CifsPages("I-35", CifsFeed.model_validate({"kind": kind}), book)


def cap() -> CapPages:
    return CapPages("Example DOT", "I-35", ALERTS, NoticeBook("run", 120.0, 40.0, 2.0, 25.0))


@pytest.mark.parametrize("state", [CLEAR, LOST, queue(), BEYOND], ids=lambda s: s.status.value)
def test_wzdx_is_a_valid_device_feed(state: QueueState, shared: Path) -> None:
    pages = wzdx(cc0=True, contact_name="NOC", contact_email="noc@example.org")
    pages.take((answer(state),), 0.0)
    record = json.loads(pages.build(1.0, START))
    device_feed_validator(shared).validate(record)
    (feature,) = record["features"]
    assert feature["properties"]["core_details"]["device_type"] == "traffic-sensor"
    assert feature["properties"]["eoq"]["status"] == state.status.value
    is_lost = state.status is QueueStatus.UNKNOWN
    status = feature["properties"]["core_details"]["device_status"]
    assert status == ("warning" if is_lost else "ok")


def test_the_wzdx_schema_refuses_what_is_wrong(shared: Path) -> None:
    """The stand-ins for geojson.org's schemas and the registry do check."""
    validator = device_feed_validator(shared)
    for example in (shared / "wzdx" / "examples" / "DeviceFeed").glob("*.geojson"):
        validator.validate(json.loads(example.read_text("utf-8")))
    pages = wzdx()
    pages.take((answer(queue()),), 0.0)
    wrongs: list[Callable[[dict[str, Any]], object]] = [
        lambda r: r["features"][0]["geometry"].update(type="Polygon"),
        lambda r: r["features"][0]["properties"]["core_details"].update(device_type="queue"),
        lambda r: r["features"][0]["properties"]["core_details"].update(road_direction="north"),
        lambda r: r["features"][0]["properties"].pop("collection_interval_end_date"),
        lambda r: r["feed_info"].update(license="MIT"),
    ]
    for wrong in wrongs:
        record = pages.record(1.0, START)
        wrong(record)
        assert not validator.is_valid(record)


def test_wzdx_places_the_sensor_at_the_posted_end_in_geojson_order() -> None:
    pages = wzdx()
    pages.take((answer(queue()),), 0.0)
    (feature,) = pages.record(0.0, START)["features"]
    end = feature["properties"]["eoq"]["end"]
    assert feature["geometry"]["coordinates"] == [end["lon"], end["lat"]]
    assert end["station_m"] == end["measured_station_m"] - 2 * end["sigma_m"]
    pages.take((answer(LOST, 1.0, 1.0),), 1.0)
    (lost,) = pages.record(1.0, START)["features"]
    assert lost["id"] == feature["id"]


def test_wzdx_tells_an_old_answer_as_unknown_and_has_no_feature_without_a_place() -> None:
    pages = wzdx()
    assert pages.record(0.0, START)["features"] == []
    pages.take((answer(CLEAR),), 0.0)
    (feature,) = pages.record(3.5, START)["features"]
    assert feature["properties"]["eoq"]["status"] == "unknown"
    assert "no answer for 4 s" in feature["properties"]["core_details"]["description"]
    pages.end(3.6, START)
    (feature,) = pages.record(3.6, START)["features"]
    assert "ended" in feature["properties"]["core_details"]["description"]
    pages.take(Reader(2.0).read(published(queue(), is_placed=False)), 4.0)
    assert pages.record(4.0, START)["features"] == []


def test_a_file_of_wzdx_is_due_when_the_status_changes_and_every_few_seconds() -> None:
    pages = wzdx(update_s=5)
    due = [
        pages.take((answer(state, at_s, at_s),), at_s)
        for at_s, state in ((0, CLEAR), (1, CLEAR), (2, LOST), (3, LOST), (7, LOST))
    ]
    assert due == [True, False, True, False, True]


@pytest.mark.parametrize("kind", ["jam", "hazard"])
def test_cifs_is_as_waze_published_it(kind: str) -> None:
    pages = cifs(kind)
    pages.take((answer(queue()),), 0.0)
    record = json.loads(pages.build(1.0, START))
    jsonschema.validate(record, CIFS_SCHEMA)
    incident = record["incidents"][0]["incident"]
    assert incident["type"] == kind.upper()
    numbers = [float(text) for text in incident["polyline"].split()]
    lats = numbers[::2]
    assert lats == sorted(lats)  # in the direction of travel, which is north here
    assert lats[0] == pytest.approx(36.1279973)


def test_cifs_keeps_an_incidents_name_and_lets_it_go() -> None:
    pages = cifs()
    pages.take((answer(queue()),), 0.0)
    first = json.loads(pages.build(0.0, START))["incidents"][0]["incident"]
    pages.take((answer(queue(1900.0), 5.0, 5.0),), 5.0)
    moved = json.loads(pages.build(5.0, START))["incidents"][0]["incident"]
    assert (moved["id"], moved["starttime"]) == (first["id"], first["starttime"])
    assert moved["endtime"] > first["endtime"]
    assert moved["polyline"] != first["polyline"]
    for at_s in (6.0, 8.0):
        pages.take((answer(LOST, at_s, at_s),), at_s)
    assert json.loads(pages.build(8.0, START)) == {"incidents": []}


def test_cifs_lets_an_incident_go_when_no_answer_comes_any_more() -> None:
    pages = cifs()
    pages.take((answer(queue()),), 0.0)
    assert json.loads(pages.build(121.0, START)) == {"incidents": []}


def test_cap_messages_follow_the_standard_from_alert_to_cancel() -> None:
    book = NoticeBook("run", 120.0, 40.0, 0.0, 25.0)
    texts = [
        alert_text(notice, "Example DOT", "I-35", ALERTS)
        for at_s, state in (
            (0.0, queue()),
            (1.0, BEYOND),
            (2.0, LOST),
            (3.0, queue()),
            (4.0, CLEAR),
        )
        for notice in book.take((answer(state, at_s, at_s),), at_s)
    ]
    alerts = [check_alert(text) for text in texts]
    kinds = [a.findtext(f"{{{CAP}}}msgType") for a in alerts]
    assert kinds == ["Alert", "Update", "Cancel", "Alert", "Cancel"]
    references = [a.findtext(f"{{{CAP}}}references") for a in alerts]
    assert references[1] == "noc@example.org,run-1.0,2026-05-14T15:30:00-00:00"
    assert references[2] == "noc@example.org,run-1.1,2026-05-14T15:30:01-00:00"
    responses = [a.findtext(f".//{{{CAP}}}responseType") for a in alerts]
    assert responses == ["Prepare", "Prepare", "None", "Prepare", "AllClear"]


def test_cap_feed_holds_valid_messages_until_they_expire() -> None:
    pages = cap()
    pages.take((answer(queue()),), 0.0)
    pages.take((answer(queue(1900.0), 1.0, 1.0),), 1.0)
    feed = etree.fromstring(pages.build(1.0, START))
    assert feed.tag == f"{{{ATOM}}}feed"
    (entry,) = feed.findall(f"{{{ATOM}}}entry")
    assert entry.findtext(f"{{{ATOM}}}id")
    (content,) = entry.findall(f"{{{ATOM}}}content")
    assert content.get("type") == "application/cap+xml"
    check_alert(etree.tostring(content[0]))
    assert etree.fromstring(pages.build(121.5, START)).find(f"{{{ATOM}}}entry") is None


def test_the_rules_for_cap_refuse_what_is_wrong() -> None:
    (notice,) = NoticeBook("run", 120.0, 40.0, 0.0, 25.0).take((answer(queue()),), 0.0)
    text = alert_text(notice, "Example DOT", "I-35", ALERTS).decode()
    for old, new in (
        ("-00:00</cap:sent>", "Z</cap:sent>"),
        ("<cap:urgency>Immediate", "<cap:urgency>Now"),
        ("run-1.0<", "run 1,0<"),
        ("<cap:category>Transport</cap:category>", ""),
        (" 0.183</cap:circle>", "</cap:circle>"),
    ):
        assert old in text
        with pytest.raises((AssertionError, etree.DocumentInvalid)):
            check_alert(text.replace(old, new).encode())


SEQUENCES = st.lists(
    st.tuples(
        st.sampled_from([CLEAR, LOST, queue(), queue(1900.0), BEYOND]),
        st.sampled_from([0.1, 1.0, 2.5, 4.0, 130.0]),
        st.sampled_from([0.0, 2.0, 3.5, 150.0]),
    ),
    min_size=1,
    max_size=15,
)


@given(SEQUENCES)
def test_no_document_is_stale_or_clear_while_nothing_is_known(
    steps: list[tuple[QueueState, float, float]],
) -> None:
    """After each answer every page is asked at once, and after a silence."""
    device, incidents, alerts = wzdx(), cifs(), cap()
    now_s, was_clear = 0.0, False
    for state, pause_s, silence_s in steps:
        now_s += pause_s
        told = (answer(state, now_s, now_s),)
        for pages in (device, incidents, alerts):
            pages.take(told, now_s)
        asked_s = now_s + silence_s
        utc = START + timedelta(seconds=asked_s)
        (feature,) = device.record(asked_s, utc)["features"]
        shown = feature["properties"]["eoq"]
        fresh = silence_s <= SETTINGS.max_age_s
        assert shown["status"] == (state.status.value if fresh else "unknown")
        assert ("no queue" in json.dumps(feature)) == (fresh and state is CLEAR)
        for entry in json.loads(incidents.build(asked_s, utc))["incidents"]:
            assert datetime.fromisoformat(entry["incident"]["endtime"]) > utc
        text = alerts.build(asked_s, utc).decode()
        for expires in re.findall(r"<cap:expires>(.*?)-00:00<", text):
            assert datetime.fromisoformat(f"{expires}+00:00") >= utc - timedelta(seconds=1)
        was_clear = was_clear or state is CLEAR
        assert was_clear or "AllClear" not in text
        now_s = asked_s
