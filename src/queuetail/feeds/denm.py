"""ETSI DENM, cause 27 dangerousEndOfQueue, as unaligned PER for the gateway of a roadside unit.

Source: ETSI EN 302 637-3 V1.3.1 and TS 102 894-2 (units, unavailable values, TimestampIts); the
ASN.1 is compiled by pycrate.
"""

from __future__ import annotations

from datetime import UTC, datetime
from importlib import import_module
from itertools import pairwise
from typing import Any

from queuetail.errors import InputError
from queuetail.feeds.answers import End, LatLon, Road
from queuetail.feeds.episodes import Notice, Step
from queuetail.feeds.settings import DenmFeed

PROTOCOL_VERSION, DENM_ID = 2, 1
DANGEROUS_END_OF_QUEUE = 27
ROADSIDE_UNIT = 15
ITS_EPOCH = datetime(2004, 1, 1, tzinfo=UTC)
# TimestampIts counts leap seconds: 2007-01-01 is 94 694 401 000 ms (TS 102 894-2).
LEAP_SECONDS = tuple(
    datetime(year, month, 1, tzinfo=UTC)
    for year, month in ((2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1))
)
NO_ALTITUDE = {"altitudeValue": 800_001, "altitudeConfidence": "unavailable"}
NO_DELTA_ALTITUDE = 12_800
LARGEST_DELTA = 131_071  # tenths of a microdegree, about 1.4 km
LARGEST_CONFIDENCE_CM = 4093
HEADING_CONFIDENCE = 20  # 2°, in tenths
MOST_POINTS = 40
QUALITY, BOUND_QUALITY = 5, 2  # of 1 (lowest) to 7


class Encoder:
    """Encodes notices; each queue gets a sequence number, as an action of this station."""

    def __init__(self, feed: DenmFeed) -> None:
        """Load the ASN.1; raises InputError where pycrate is missing."""
        try:
            compiled: Any = import_module("pycrate_asn1dir.ITS_DENM_3")
        except ImportError:
            raise InputError(
                "DENMs need the package pycrate; install queuetail with its extra v2x"
            ) from None
        self._type = compiled.DENM_PDU_Descriptions.DENM
        self._feed = feed
        self._numbers: dict[str, int] = {}
        self._first = int((datetime.now(UTC) - ITS_EPOCH).total_seconds()) % 65_536

    def encode(self, notice: Notice) -> bytes:
        """Return a notice as UPER."""
        if notice.id not in self._numbers:
            # A run that begins anew must not go on with the actions of the one before.
            self._numbers[notice.id] = (self._first + len(self._numbers)) % 65_536
        self._type.set_val(message(notice, self._numbers[notice.id], self._feed))
        return bytes(self._type.to_uper())


def message(notice: Notice, number: int, feed: DenmFeed) -> dict[str, Any]:
    """Return a DENM as pycrate takes it; a cancellation has no situation and no location."""
    end, road = notice.answer.end, notice.answer.road
    assert end is not None
    assert road is not None
    header = {
        "protocolVersion": PROTOCOL_VERSION,
        "messageID": DENM_ID,
        "stationID": feed.station_id,
    }
    heading = round(road.course_deg(end.station_m) * 10) % 3600
    management = _management(notice, end, road, heading)
    management["actionID"] = {"originatingStationID": feed.station_id, "sequenceNumber": number}
    management["validityDuration"] = int(feed.valid_s)
    if notice.step is Step.CANCEL:
        management["termination"] = "isCancellation"
        return {"header": header, "denm": {"management": management}}
    cause = {"causeCode": DANGEROUS_END_OF_QUEUE, "subCauseCode": feed.sub_cause}
    trace = road.path(end.station_m, end.station_m - feed.trace_m)
    return {
        "header": header,
        "denm": {
            "management": management,
            "situation": {
                "informationQuality": BOUND_QUALITY if end.is_bound else QUALITY,
                "eventType": cause,
            },
            "location": {
                "eventPositionHeading": {
                    "headingValue": heading,
                    "headingConfidence": HEADING_CONFIDENCE,
                },
                "traces": [_trace(trace)],
            },
        },
    }


def _management(notice: Notice, end: End, road: Road, heading: int) -> dict[str, Any]:
    """Return when and where; the ellipse lies along the road and holds the measured end."""
    assert end.at is not None
    half_length_m = end.measured_m - end.station_m + 2 * end.sigma_m
    half_width_m = road.approach.lanes * road.approach.lane_width_m / 2
    return {
        "detectionTime": timestamp_its(notice.answer.utc),
        "referenceTime": timestamp_its(notice.sent),
        "eventPosition": {
            "latitude": round(end.at[0] * 1e7),
            "longitude": round(end.at[1] * 1e7),
            "positionConfidenceEllipse": {
                "semiMajorConfidence": _confidence(half_length_m),
                "semiMinorConfidence": _confidence(half_width_m),
                "semiMajorOrientation": heading,
            },
            "altitude": NO_ALTITUDE,
        },
        "relevanceDistance": "lessThan5km",
        "relevanceTrafficDirection": "upstreamTraffic",
        "stationType": ROADSIDE_UNIT,
    }


def timestamp_its(utc: datetime) -> int:
    """Return milliseconds since 2004, leap seconds included; 0 by a clock that is not set."""
    leaps = sum(utc >= leap for leap in LEAP_SECONDS)
    return max(round((utc - ITS_EPOCH).total_seconds() * 1000) + 1000 * leaps, 0)


def _trace(points: tuple[LatLon, ...]) -> list[dict[str, Any]]:
    """Return the way to the event: each point against the one nearer to the event."""
    return [
        {
            "pathPosition": {
                "deltaLatitude": _delta(b[0] - a[0]),
                "deltaLongitude": _delta(b[1] - a[1]),
                "deltaAltitude": NO_DELTA_ALTITUDE,
            }
        }
        for a, b in list(pairwise(points))[:MOST_POINTS]
    ]


def _delta(degrees: float) -> int:
    return max(min(round(degrees * 1e7), LARGEST_DELTA), -LARGEST_DELTA)


def _confidence(metres: float) -> int:
    """Return a half axis in centimetres; 4094 is out of range."""
    centimetres = max(round(metres * 100), 1)
    return centimetres if centimetres <= LARGEST_CONFIDENCE_CM else 4094
