"""The track of the end of the queue for other programs: GeoJSON, GPX, KML."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import gpxpy.gpx
import numpy as np

from queuetail.errors import InputError
from queuetail.sinks.folder import QueueTable, read_queue, read_run
from queuetail.types import QueueStatus

FORMATS = ("geojson", "gpx", "kml")
POINT_EVERY_S = 1.0  # a point a second draws the same line as thirty, and opens everywhere
GAP_S = 2.0  # where the end of the queue was not known for longer, the line is broken
KML = "http://www.opengis.net/kml/2.2"


@dataclass(frozen=True, slots=True)
class Point:
    """One place of the end of the queue."""

    t_s: float
    utc: datetime | None
    lat: float
    lon: float
    properties: dict[str, Any]


@dataclass(frozen=True, slots=True)
class EoqTrack:
    """The places of one approach's end of queue, in stretches without gaps."""

    approach: str
    stretches: tuple[tuple[Point, ...], ...]

    @property
    def points(self) -> tuple[Point, ...]:
        """All points in order of time."""
        return tuple(p for stretch in self.stretches for p in stretch)


def export(run_dir: Path, fmt: str, out: Path) -> None:
    """Write the end-of-queue tracks of a run to `out` as ``geojson``, ``gpx`` or ``kml``.

    Raises InputError where the folder is not a run, holds no place on Earth, or cannot be written.
    """
    if fmt not in WRITERS:
        raise InputError(f"unknown format '{fmt}'; known formats: {', '.join(FORMATS)}")
    run = read_run(run_dir)
    tracks = eoq_tracks(run_dir, _start_utc(run))
    text = WRITERS[fmt](tracks, _title(run, run_dir))
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out} cannot be written: {error.strerror}") from None


def eoq_tracks(run_dir: Path, start_utc: datetime | None) -> tuple[EoqTrack, ...]:
    """Read the end-of-queue tracks of a run; raises InputError where there are none."""
    tables = read_queue(run_dir)
    known = [t for t in tables if np.isfinite(t.station_m).any()]
    if not known:
        raise InputError(f"{run_dir} holds no end of queue, so there is nothing to export")
    tracks = tuple(_track(table, start_utc) for table in known if np.isfinite(table.lat).any())
    if not tracks:
        raise InputError(
            f"{run_dir} has places in local metres only; give the site file [site] origin or "
            "control points with latitude and longitude (at = [lat, lon]) and run again"
        )
    return tracks


def _track(table: QueueTable, start_utc: datetime | None) -> EoqTrack:
    stretches: list[list[Point]] = []
    last_s = kept_s = -math.inf
    last_status: QueueStatus | None = None
    for i in np.flatnonzero(np.isfinite(table.lat) & np.isfinite(table.lon)).tolist():
        t_s, status = float(table.t_s[i]), table.status[i]
        if t_s - last_s > GAP_S:
            stretches.append([])
        last_s_before, last_s = last_s, t_s
        due = t_s - kept_s >= POINT_EVERY_S - 1e-6 or status is not last_status
        if not due and stretches[-1] and t_s - last_s_before <= GAP_S:
            continue
        kept_s, last_status = t_s, status
        stretches[-1].append(_point(table, i, start_utc))
    return EoqTrack(table.approach, tuple(tuple(s) for s in stretches))


def _point(table: QueueTable, i: int, start_utc: datetime | None) -> Point:
    values = {
        "eoq_station_m": table.station_m[i],
        "eoq_sigma_m": table.sigma_m[i],
        "length_m": table.length_m[i],
        "vehicles": table.vehicles[i],
        "growth_mps": table.growth_mps[i],
    }
    t_s = float(table.t_s[i])
    properties: dict[str, Any] = {"t_s": t_s, "status": table.status[i].value}
    properties |= {k: float(v) if math.isfinite(v) else None for k, v in values.items()}
    utc = start_utc + timedelta(seconds=t_s) if start_utc else None
    return Point(t_s, utc, float(table.lat[i]), float(table.lon[i]), properties)


def _geojson(tracks: tuple[EoqTrack, ...], title: str) -> str:
    """Return a FeatureCollection as RFC 7946 has it: longitude first."""
    features: list[dict[str, Any]] = []
    for track in tracks:
        lines = [[[p.lon, p.lat] for p in s] for s in track.stretches if len(s) > 1]
        if lines:
            single = len(lines) == 1
            geometry = {
                "type": "LineString" if single else "MultiLineString",
                "coordinates": lines[0] if single else lines,
            }
            features.append(_feature(geometry, {"kind": "eoq_track", "approach": track.approach}))
        last = len(track.points) - 1
        for k, point in enumerate(track.points):
            kind = "last_eoq" if k == last else "eoq"
            properties = {"kind": kind, "approach": track.approach, **point.properties}
            if point.utc:
                properties["utc"] = point.utc.isoformat()
            place = {"type": "Point", "coordinates": [point.lon, point.lat]}
            features.append(_feature(place, properties))
    collection = {"type": "FeatureCollection", "name": title, "features": features}
    return json.dumps(collection, ensure_ascii=False, allow_nan=False, indent=1) + "\n"


def _feature(geometry: dict[str, Any], properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "Feature", "geometry": geometry, "properties": properties}


def _gpx(tracks: tuple[EoqTrack, ...], title: str) -> str:
    """Return GPX 1.1: one track per approach, one segment per stretch, the last EOQ a waypoint."""
    document = gpxpy.gpx.GPX()
    document.creator, document.name = "queuetail", title
    for track in tracks:
        line = gpxpy.gpx.GPXTrack(name=_name(track))
        for stretch in track.stretches:
            segment = gpxpy.gpx.GPXTrackSegment()
            for p in stretch:
                at = gpxpy.gpx.GPXTrackPoint(p.lat, p.lon, time=p.utc, comment=_comment(p))
                segment.points.append(at)
            line.segments.append(segment)
        document.tracks.append(line)
        last = track.points[-1]
        document.waypoints.append(
            gpxpy.gpx.GPXWaypoint(
                last.lat, last.lon, time=last.utc, name=f"last {_name(track)}",
                description=_comment(last),
            )
        )  # fmt: skip
    return document.to_xml("1.1") + "\n"


def _kml(tracks: tuple[EoqTrack, ...], title: str) -> str:
    """Return KML 2.2: a line per stretch, a placemark per point; times only where UTC is known."""
    ET.register_namespace("", KML)
    root = ET.Element(f"{{{KML}}}kml")
    document = _sub(root, "Document")
    _sub(document, "name", title)
    for name, colour in (("eoq", "ff323cff"), ("last", "ff00b0ff")):
        style = _sub(document, "Style", id=name)
        _sub(_sub(style, "LineStyle"), "color", colour)
        _sub(_sub(style, "IconStyle"), "scale", "0.5" if name == "eoq" else "1.1")
        _sub(_sub(style, "LabelStyle"), "scale", "0" if name == "eoq" else "1")
    for track in tracks:
        folder = _sub(document, "Folder")
        _sub(folder, "name", _name(track))
        for stretch in track.stretches:
            mark = _sub(folder, "Placemark")
            _sub(mark, "name", f"{_name(track)} from {stretch[0].t_s:.0f} s")
            _sub(mark, "styleUrl", "#eoq")
            line = _sub(mark, "LineString")
            _sub(line, "tessellate", "1")
            places = stretch if len(stretch) > 1 else stretch * 2  # KML wants two or more
            _sub(line, "coordinates", " ".join(f"{p.lon:.8f},{p.lat:.8f}" for p in places))
        for k, point in enumerate(track.points):
            _kml_point(folder, track, point, k == len(track.points) - 1)
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def _kml_point(folder: ET.Element, track: EoqTrack, point: Point, last: bool) -> None:
    mark = _sub(folder, "Placemark")
    _sub(mark, "name", f"last {_name(track)}" if last else f"{point.t_s:.0f} s")
    _sub(mark, "description", _comment(point))
    if point.utc:
        _sub(_sub(mark, "TimeStamp"), "when", point.utc.isoformat())
    _sub(mark, "styleUrl", "#last" if last else "#eoq")
    data = _sub(mark, "ExtendedData")
    for key, value in point.properties.items():
        if value is not None:
            _sub(_sub(data, "Data", name=key), "value", str(value))
    _sub(_sub(mark, "Point"), "coordinates", f"{point.lon:.8f},{point.lat:.8f}")


def _sub(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    child = ET.SubElement(parent, f"{{{KML}}}{tag}", attributes)
    child.text = _printable(text) if text is not None else None
    return child


def _printable(text: str) -> str:
    """Return `text` without the control characters that XML 1.0 forbids."""
    return "".join(c for c in text if c in "\t\n" or (c >= " " and c not in "\ufffe\uffff"))


def _comment(point: Point) -> str:
    shown = {k: v for k, v in point.properties.items() if v is not None}
    return ", ".join(f"{k} {v:g}" if isinstance(v, float) else f"{k} {v}" for k, v in shown.items())


def _name(track: EoqTrack) -> str:
    return f"end of queue {_printable(track.approach)}".rstrip()


def _title(run: dict[str, Any], run_dir: Path) -> str:
    site = run.get("site")
    name = site.get("name") if isinstance(site, dict) else site
    return _printable(str(name or run_dir.name or "queuetail"))


def _start_utc(run: dict[str, Any]) -> datetime | None:
    video = run.get("video")
    text = video.get("start_utc") if isinstance(video, dict) else None
    try:
        return datetime.fromisoformat(text) if isinstance(text, str) else None
    except ValueError:
        return None


WRITERS: dict[str, Callable[[tuple[EoqTrack, ...], str], str]] = {
    "geojson": _geojson,
    "gpx": _gpx,
    "kml": _kml,
}
