"""Cursor on Target, TIM and DENM, read by others' parsers and by the published layouts."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from feed_answers import CLEAR, LOST, START, answer, queue
from lxml import etree

from queuetail.errors import InputError
from queuetail.feeds import cot, denm, tim
from queuetail.feeds.episodes import Notice, NoticeBook
from queuetail.feeds.settings import CotFeed, DenmFeed, TimFeed
from queuetail.types import QueueState, QueueStatus

BEYOND = queue(status=QueueStatus.BEYOND_VIEW)
DENMS = DenmFeed(url="udp://127.0.0.1:37009", station_id=4711)
TIMS = TimFeed(url="https://ode.example.org/tim")

# usdot-jpo-ode/jpo-ode, docs/ODESwagger.yaml (05d5ecd) with the key names of
# jpo-ode-core/src/test/resources/us/dot/its/jpo/ode/model/timRequest_J2735-2020.json (854f7ad):
# text where that has text, and the ranges that the Swagger file gives.
DEGREES = {"type": "string", "pattern": r"^-?\d{1,3}\.\d{7}$"}
POSITION = {
    "type": "object",
    "required": ["latitude", "longitude"],
    "additionalProperties": False,
    "properties": {"latitude": DEGREES, "longitude": DEGREES, "elevation": {"type": "string"}},
}
SLICES = {"type": "string", "pattern": "^[01]{16}$"}
DIGIT = {"type": "string", "pattern": r"^\d+$"}
UTC_TIME = {"type": "string", "pattern": r"^\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z$"}


def exactly(**properties: Any) -> dict[str, Any]:
    """Return a schema of an object with exactly these properties."""
    return {
        "type": "object",
        "required": list(properties),
        "additionalProperties": False,
        "properties": properties,
    }


NODE = exactly(nodeLong=DEGREES, nodeLat=DEGREES, delta={"enum": ["node-LatLon"]})
REGION = exactly(
    name={"type": "string", "maxLength": 63},
    regulatorID=DIGIT,
    segmentID=DIGIT,
    anchorPosition=POSITION,
    laneWidth={"type": "string", "pattern": r"^\d{1,3}\.\d\d$"},
    directionality={"enum": ["1", "2", "3"]},
    closedPath={"enum": ["true", "false"]},
    description={"enum": ["path", "geometry"]},
    path=exactly(
        scale=DIGIT,
        type={"enum": ["ll", "xy"]},
        nodes={"type": "array", "minItems": 1, "maxItems": 63, "items": NODE},
    ),
    direction=SLICES,
)
FRAME = exactly(
    startDateTime=UTC_TIME,
    durationTime={"type": "integer", "minimum": 0, "maximum": 3200},
    notUsed=DIGIT,
    frameType={"enum": ["unknown", "advisory", "roadSignage", "commercialSignage"]},
    msgId=exactly(
        roadSignID=exactly(
            position=POSITION,
            viewAngle=SLICES,
            mutcdCode={"enum": ["none", "regulatory", "warning", "maintenance", "guide", "rec"]},
        )
    ),
    priority={"enum": list("01234567")},
    notUsed1=DIGIT,
    regions={"type": "array", "minItems": 1, "maxItems": 16, "items": REGION},
    notUsed2=DIGIT,
    notUsed3=DIGIT,
    content={"enum": ["advisory", "workZone", "speedLimit", "exitService", "genericSign"]},
    items={"type": "array", "minItems": 1, "items": {"type": "string"}},
    url={"type": "string"},
)
TIM_SCHEMA = exactly(
    request={"type": "object"},
    tim=exactly(
        msgCnt={"type": "string", "pattern": r"^(\d|\d\d|1[01]\d|12[0-7])$"},
        timeStamp=UTC_TIME,
        packetID={"type": "string", "pattern": "^[0-9A-F]{18}$"},
        urlB={"type": "string"},
        dataframes={"type": "array", "minItems": 1, "maxItems": 8, "items": FRAME},
    ),
)


def notices(*states: QueueState) -> list[Notice]:
    """Return what is sent of states a second apart."""
    book = NoticeBook("site-1-run", 30.0, 10.0, 0.0, 25.0)
    return [
        notice
        for at_s, state in enumerate(states)
        for notice in book.take((answer(state, at_s, at_s),), at_s)
    ]


def test_cot_marks_the_end_and_deletes_the_mark() -> None:
    """By the schema's attributes: all nine are required, times in UTC, errors in metres."""
    events = [etree.fromstring(cot.event(n, CotFeed())) for n in notices(queue(), BEYOND, LOST)]
    for event in events:
        assert event.tag == "event"
        assert event.attrib.keys() == ["version", "uid", "type", "time", "start", "stale", "how"]
        time, start, stale = (
            datetime.fromisoformat(event.get(k)) for k in ("time", "start", "stale")
        )
        assert time == start < stale
        point = event.find("point")
        assert point.attrib.keys() == ["lat", "lon", "hae", "ce", "le"]
        assert float(point.get("ce")) == pytest.approx(4.5)
        assert -90 <= float(point.get("lat")) <= 90
    first, moved, last = events
    assert (first.get("type"), first.get("uid")) == ("b-m-p-s-m", moved.get("uid"))
    assert "beyond view" in moved.findtext("detail/remarks")
    assert last.get("type") == "t-x-d-d"
    assert last.find("detail/link").get("uid") == first.get("uid")
    assert "unknown: no picture" in last.findtext("detail/remarks")


def test_cot_fits_a_datagram() -> None:
    (notice,) = notices(queue())
    assert len(cot.event(notice, CotFeed())) < 1400


def test_denm_is_read_back_by_pycrate() -> None:
    its = pytest.importorskip("pycrate_asn1dir.ITS_DENM_3")
    encoder = denm.Encoder(DENMS)
    told = notices(queue(), queue(1900.0), CLEAR, queue())
    packets = [encoder.encode(notice) for notice in told]
    read = []
    for packet in packets:
        its.DENM_PDU_Descriptions.DENM.from_uper(packet)
        assert its.DENM_PDU_Descriptions.DENM.to_uper() == packet
        read.append(its.DENM_PDU_Descriptions.DENM.get_val())
    first, moved, cancel, again = read
    assert first["header"] == {"protocolVersion": 2, "messageID": 1, "stationID": 4711}
    event = first["denm"]["situation"]["eventType"]
    assert event == {"causeCode": 27, "subCauseCode": 1}
    place = first["denm"]["management"]["eventPosition"]
    assert (place["latitude"], place["longitude"]) == (361279973, -970499600)
    assert place["positionConfidenceEllipse"]["semiMajorConfidence"] == 600
    assert first["denm"]["management"]["validityDuration"] == 10
    assert first["denm"]["location"]["eventPositionHeading"]["headingValue"] == 0
    (trace,) = first["denm"]["location"]["traces"]
    assert sum(p["pathPosition"]["deltaLatitude"] for p in trace) == pytest.approx(-90_110, abs=20)
    actions = [r["denm"]["management"]["actionID"]["sequenceNumber"] for r in read]
    assert actions[0] == actions[1] == actions[2] == (actions[3] - 1) % 65_536
    assert cancel["denm"]["management"]["termination"] == "isCancellation"
    assert "situation" not in cancel["denm"]
    times = [r["denm"]["management"]["referenceTime"] for r in read]
    assert times == sorted(times)
    assert moved["denm"]["management"]["referenceTime"] - times[0] == 1000
    assert again["denm"]["management"].get("termination") is None


def test_its_time_counts_leap_seconds() -> None:
    """ETSI TS 102 894-2 gives this example."""
    assert denm.timestamp_its(datetime(2007, 1, 1, tzinfo=UTC)) == 94_694_401_000
    later = denm.timestamp_its(START)
    assert later == (START - datetime(2004, 1, 1, tzinfo=UTC)) / timedelta(milliseconds=1) + 5000


def test_a_missing_pycrate_is_said_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> object:
        raise ImportError(name)

    monkeypatch.setattr(denm, "import_module", missing)
    with pytest.raises(InputError, match=r"^DENMs need the package pycrate; .* extra v2x$"):
        denm.Encoder(DENMS)


def test_tim_is_as_the_ode_takes_it() -> None:
    for notice in notices(queue(), BEYOND):
        record = tim.message(notice, {"rsus": []}, "I-35", TIMS)
        jsonschema.validate(json.loads(json.dumps(record)), TIM_SCHEMA)
        (frame,) = record["tim"]["dataframes"]
        (region,) = frame["regions"]
        nodes = [float(node["nodeLat"]) for node in region["path"]["nodes"]]
        anchor = float(region["anchorPosition"]["latitude"])
        assert [anchor, *nodes] == sorted([anchor, *nodes])  # in the direction of travel
        assert f"{nodes[-1]:.7f}" == frame["msgId"]["roadSignID"]["position"]["latitude"]
        assert frame["durationTime"] == 1


def test_a_tim_keeps_its_name_and_counts() -> None:
    first, second = (
        tim.message(n, {}, "I-35", TIMS)["tim"] for n in notices(queue(), queue(1900.0))
    )
    assert first["packetID"] == second["packetID"]
    assert (first["msgCnt"], second["msgCnt"]) == ("0", "1")


@pytest.mark.parametrize(
    ("course_deg", "bits"),
    [(0.0, "1100000000000001"), (90.0, "0001110000000000"), (359.0, "1000000000000011")],
)
def test_heading_slices(course_deg: float, bits: str) -> None:
    assert tim.heading_slices(course_deg) == bits


def test_a_long_region_has_as_many_nodes_as_the_format_holds() -> None:
    (notice,) = notices(queue(2900.0))
    feed = TimFeed(url="https://ode.example.org/tim", warn_m=5000)
    record = tim.message(notice, {}, "I-35", feed)
    jsonschema.validate(json.loads(json.dumps(record)), TIM_SCHEMA)


def test_the_file_of_rsus_is_private_and_checked(tmp_path: Path) -> None:
    file = tmp_path / "request.json"
    file.write_text('{"rsus": [{"rsuIndex": 3, "rsuPassword": "x"}]}')
    os.chmod(file, 0o644)
    with pytest.raises(InputError, match="chmod 600"):
        tim.read_request(file)
    os.chmod(file, 0o600)
    assert tim.read_request(file)["rsus"][0]["rsuIndex"] == 3
    file.write_text("[1]")
    with pytest.raises(InputError, match="JSON object with rsus"):
        tim.read_request(file)
