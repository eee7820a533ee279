"""USDOT ODE: Traveler Information Messages as JSON, which the ODE encodes and sends to RSUs.

Source: usdot-jpo-ode/jpo-ode, docs/ODESwagger.yaml and timRequest_J2735-2020.json; HeadingSlice and
UniqueMSGID are of SAE J2735, as the ODE describes them.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from queuetail.errors import InputError
from queuetail.feeds.answers import Road, iso
from queuetail.feeds.episodes import Notice, Step
from queuetail.feeds.posting import Poster
from queuetail.feeds.secrets import read_private
from queuetail.feeds.settings import TimFeed

VALID_MIN = 1  # the shortest duration that the format knows
SLICE_DEG = 22.5
PRIORITY = "5"  # of 0 to 7
JSON_TYPE = {"Content-Type": "application/json"}
MOST_NODES = 63
COURSES = 8  # parts of the way whose directions are told


class TimPoster:
    """Posts notices to an ODE; for one thread."""

    def __init__(self, feed: TimFeed, road: str) -> None:
        """Read the request's file; raises InputError."""
        self._feed, self._road = feed, road
        self._request = read_request(feed.request_file)
        self._poster = Poster(feed.url, feed)
        self._deposited: set[str] = set()

    def deliver(self, notice: Notice) -> None:
        """Deposit a message, replace it, or delete it from the RSUs.

        Without RSUs the ODE knows no delete: the message then ends by its duration of a minute.
        """
        rsus = self._request.get("rsus", [])
        if notice.step is Step.CANCEL:
            for rsu in rsus:
                index = f"index={rsu.get('rsuIndex', 0)}"
                self._poster.send(json.dumps(rsu).encode(), JSON_TYPE, "DELETE", index)
            self._deposited.discard(notice.id)
            return
        body = json.dumps(message(notice, self._request, self._road, self._feed)).encode()
        method = "PUT" if rsus and notice.id in self._deposited else "POST"
        self._poster.send(body, JSON_TYPE, method)
        self._deposited.add(notice.id)


def read_request(file: Path | None) -> dict[str, Any]:
    """Return the ODE's `request` object (rsus, snmp, sdw) of a file; raises InputError."""
    if file is None:
        return {}
    text = read_private(file, "the passwords of RSUs")
    try:
        record = json.loads(text)
        rsus = record.get("rsus", [])
        if not all(isinstance(rsu, dict) for rsu in rsus):
            raise ValueError
    except (ValueError, AttributeError, TypeError):
        raise InputError(f"{file} has to be a JSON object with rsus, snmp or sdw") from None
    return dict(record)


def message(
    notice: Notice, request: dict[str, Any], road_name: str, feed: TimFeed
) -> dict[str, Any]:
    """Return what the ODE takes: a region that ends at the end of the queue, upstream of it."""
    end, road = notice.answer.end, notice.answer.road
    assert end is not None
    assert end.at is not None
    assert road is not None
    frame = {
        "startDateTime": iso(notice.sent),
        "durationTime": VALID_MIN,
        "notUsed": "0",
        "frameType": "advisory",
        "msgId": {
            "roadSignID": {
                "position": _position(*end.at),
                "viewAngle": heading_slices(road.course_deg(end.station_m)),
                "mutcdCode": "warning",
            }
        },
        "priority": PRIORITY,
        "notUsed1": "0",
        "regions": [
            {
                "name": f"{road_name} {notice.answer.approach} end of queue".strip()[:63],
                **_region(road, end.station_m, feed.warn_m),
            }
        ],
        "notUsed2": "0",
        "notUsed3": "0",
        "content": "workZone",
        "items": list(feed.items),
        "url": "null",
    }
    tim = {
        "msgCnt": str(notice.sequence % 128),
        "timeStamp": iso(notice.sent),
        "packetID": hashlib.sha256(notice.id.encode()).hexdigest()[:18].upper(),
        "urlB": "null",
        "dataframes": [frame],
    }
    return {"request": request, "tim": tim}


def _region(road: Road, end_m: float, warn_m: float) -> dict[str, Any]:
    """Return the carriageway from `warn_m` upstream to a station, in the direction of travel."""
    points = road.path(end_m - warn_m, end_m)
    step = -(-len(points) // MOST_NODES)
    points = (*points[:-1:step], points[-1])
    courses_deg = (road.course_deg(end_m - warn_m * k / COURSES) for k in range(COURSES + 1))
    return {
        "regulatorID": "0",
        "segmentID": "0",
        "anchorPosition": _position(*points[0]),
        "laneWidth": f"{road.approach.lanes * road.approach.lane_width_m:.2f}",
        "directionality": "1",  # forward: from the anchor along the nodes
        "closedPath": "false",
        "description": "path",
        "path": {
            "scale": "0",
            "type": "ll",
            "nodes": [
                {"nodeLong": f"{lon:.7f}", "nodeLat": f"{lat:.7f}", "delta": "node-LatLon"}
                for lat, lon in points[1:]
            ],
        },
        "direction": heading_slices(*courses_deg),
    }


def heading_slices(*courses_deg: float) -> str:
    """Return 16 bits, the first for 0° to 22.5°: the courses' slices and their neighbours."""
    bits = ["0"] * 16
    for course_deg in courses_deg:
        middle = int(course_deg // SLICE_DEG)
        for index in (middle - 1, middle, middle + 1):
            bits[index % 16] = "1"
    return "".join(bits)


def _position(lat: float, lon: float) -> dict[str, str]:
    return {"latitude": f"{lat:.7f}", "longitude": f"{lon:.7f}"}
