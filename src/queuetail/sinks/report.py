"""report.html: one self-contained page that tells what a run found."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import jinja2
import numpy as np
from av.error import FFmpegError

from queuetail.config import MPS_PER_MPH
from queuetail.errors import InputError
from queuetail.sinks import RunInfo
from queuetail.sinks.annotated import NAME as ANNOTATED
from queuetail.sinks.annotated import output_size
from queuetail.sinks.folder import (
    QueueTable,
    TrackTable,
    read_events,
    read_queue,
    read_run,
    read_tracks,
)
from queuetail.sinks.overlay import Overlay
from queuetail.sinks.report_map import Still, map_scene
from queuetail.sinks.report_plots import eoq_over_time, site_map, time_space
from queuetail.types import Floats, Frame, Image, Observation, QueueStatus

FEET_PER_M = 1 / 0.3048
MAX_PICTURE_BYTES = 400_000
MAX_EVENTS = 200
NAME = "report.html"


@dataclass(frozen=True, slots=True)
class Section:
    """One approach in the report."""

    name: str
    figures: tuple[tuple[str, str, str], ...]  # what, how much, remark
    eoq_svg: str
    time_space_svg: str


class Report:
    """Keeps the frame with the longest queue (or the last with vehicles); writes at the end."""

    def __init__(self, info: RunInfo) -> None:
        self._out = info.out
        self._still: Still | None = None
        self._score = (-1, 0.0)

    def write(self, frame: Frame, observation: Observation) -> None:
        """Keep the frame where it is the best so far; it is converted at the end only."""
        score = _score(observation)
        if score >= self._score:
            self._score, self._still = score, Still(frame, observation)

    def close(self) -> None:
        """Write the page from the run folder's other files, which are closed before."""
        write_report(self._out, self._still)


def write_report(run_dir: Path, still: Still | None = None) -> Path:
    """Write report.html from a run folder's files and return its path.

    `still` is the frame to show; without it, the annotated video gives the picture, if it is
    there.  Raises InputError where `run_dir` is not a run folder or cannot be written.
    """
    run, tables = read_run(run_dir), read_queue(run_dir)
    tracks = {t.approach: t for t in read_tracks(run_dir)}
    scene = map_scene(run, tables, still)
    picture = _jpeg(_drawn(still)) if still else _picture_from_video(run_dir, tables)
    sections = [
        Section(
            name=table.approach,
            figures=tuple(key_figures(table, tracks.get(table.approach))),
            eoq_svg=eoq_over_time(table),
            time_space_svg=time_space(table, tracks.get(table.approach)),
        )
        for table in tables
    ]
    events = read_events(run_dir)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("queuetail", "sinks"), autoescape=True, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    page = environment.get_template("report.html.j2").render(
        run=run,
        site=_site_name(run),
        summary=summary(tables),
        sections=sections,
        picture=picture,
        picture_caption=_caption(still, tables),
        map_svg=site_map(scene) if scene else None,
        map_has_north=scene is not None and scene.origin is not None,
        map_has_picture=scene is not None and scene.base is not None,
        events=[_event_cells(e) for e in events[:MAX_EVENTS]],
        events_left_out=max(len(events) - MAX_EVENTS, 0),
    )
    path = run_dir / NAME
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    return path


def summary(tables: tuple[QueueTable, ...]) -> str:
    """Return the run's result in one or two sentences."""
    if not tables:
        return "No frame was processed, so there is nothing to report."
    if all(t.approach == "" for t in tables):
        return "No approach was found in this run, so nothing can be said of queues on it."
    words = []
    for table in tables:
        name = table.approach
        queued = table.having(QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)
        unknown = table.having(QueueStatus.UNKNOWN)
        durations_s = table.durations_s
        if queued.any():
            longest = _finite(table.length_m)
            length = f", at most {_metres(longest.max())} long" if len(longest) else ""
            words.append(
                f"{name}: a queue stood for {_duration(durations_s[queued].sum())}{length}."
            )
        elif unknown.all():
            words.append(f"{name}: unknown for the whole run.")
        else:
            words.append(f"{name}: no queue was seen.")
        if unknown.any() and not unknown.all():
            words.append(f"For {_duration(durations_s[unknown].sum())} the answer was unknown.")
    return " ".join(words)


def key_figures(table: QueueTable, tracks: TrackTable | None) -> list[tuple[str, str, str]]:
    """Return (what, how much, remark) for one approach."""
    total_s = float(table.durations_s.sum())
    queued_s = _time_s(table, QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW)
    unknown_s = _time_s(table, QueueStatus.UNKNOWN)
    station, length = _finite(table.station_m), _finite(table.length_m)
    growth, sigma = _finite(table.growth_mps), _finite(table.sigma_m)
    figures = [
        ("time queued", _duration(queued_s), _share(queued_s, total_s)),
        ("unknown", _share(unknown_s, total_s) or "none", _duration(unknown_s)),
    ]
    if len(station):
        figures += [
            ("longest queue", *_metres_and_feet(length)),
            ("most upstream end", f"{station.min():.0f} m", "station"),
            ("most downstream end", f"{station.max():.0f} m", "station"),
            (
                "typical uncertainty",
                f"± {np.median(sigma):.1f} m" if len(sigma) else "–",
                "1 sigma",
            ),
            ("fastest growth", *_growth(growth)),
        ]
    if tracks is not None:
        speed = _finite(tracks.speed_mps)
        figures.append(("vehicles seen", f"{len(np.unique(tracks.track_id))}", "tracks"))
        if len(speed):
            mean = float(speed.mean())
            figures.append(
                ("mean speed", f"{mean / MPS_PER_MPH:.0f} mph", f"{mean * 3.6:.0f} km/h")
            )
    else:
        figures.append(("vehicles seen", "none", ""))
    return figures


def _score(observation: Observation) -> tuple[int, float]:
    """Rank frames for the picture: a longer queue, else any vehicles, else any frame."""
    lengths = [s.eoq.length_m for s in observation.states if s.eoq is not None]
    if lengths:
        return 2, float(np.nanmax([*lengths, 0.0]))
    return (1, 0.0) if len(observation.vehicles) else (0, 0.0)


def _drawn(still: Still) -> Image:
    width, height = still.frame.size
    size = output_size(width, height)
    image = still.frame.bgr(*size).copy()
    Overlay((width, height), size, "speeds in mph").draw(image, still.observation)
    return image


def _picture_from_video(run_dir: Path, tables: tuple[QueueTable, ...]) -> str | None:
    """Return the annotated frame at the longest queue, or the last, if the video is there."""
    path, t_s = run_dir / ANNOTATED, _longest_s(tables)
    if not path.is_file():
        return None
    image = None
    try:
        with av.open(path) as container:
            if t_s is not None:
                container.seek(int(max(t_s - 0.01, 0) * av.time_base))
            for picture in container.decode(video=0):
                image = picture
                if t_s is not None and (picture.time or 0.0) >= t_s - 0.01:
                    break
    except (FFmpegError, OSError):
        return None  # the report stands without a picture, and says so
    return _jpeg(np.asarray(image.to_ndarray(format="bgr24"), np.uint8)) if image else None


def _longest_s(tables: tuple[QueueTable, ...]) -> float | None:
    best, best_s = -1.0, None
    for table in tables:
        length = np.nan_to_num(table.length_m, nan=-1.0)
        if len(length) and length.max() > best:
            best, best_s = float(length.max()), float(table.t_s[length.argmax()])
    return best_s


def _jpeg(image: Image) -> str | None:
    """Return the picture as a data URI of at most MAX_PICTURE_BYTES."""
    for quality in (85, 75, 65, 50, 35, 20, 10):
        done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
        text = base64.b64encode(data.tobytes()).decode() if done else ""
        if 0 < len(text) <= MAX_PICTURE_BYTES:
            return f"data:image/jpeg;base64,{text}"
    return None


def _caption(still: Still | None, tables: tuple[QueueTable, ...]) -> str:
    t_s = still.observation.t_s if still else _longest_s(tables)
    if _longest_s(tables) is None:
        return "The last frame with vehicles; no queue was seen."
    return f"The longest queue, {t_s:.1f} s after the start."


def _site_name(run: dict[str, Any]) -> str:
    site = run.get("site")
    name = site.get("name") if isinstance(site, dict) else site
    return str(name or "unnamed site")


def _event_cells(event: dict[str, Any]) -> dict[str, str]:
    """Return an event's cells as text; what is missing or of another type stays empty."""

    def number(key: str, form: str) -> str:
        value = event.get(key)
        return format(value, form) if isinstance(value, int | float) else ""

    reasons = event.get("reasons")
    lat, lon = number("eoq_lat", ".5f"), number("eoq_lon", ".5f")
    return {
        "t_s": number("t_s", ".1f"),
        "approach": str(event.get("approach", "")),
        "event": str(event.get("event", "")).replace("_", " "),
        "station": number("eoq_station_m", ".0f"),
        "sigma": number("eoq_sigma_m", ".1f"),
        "length": number("length_m", ".0f"),
        "place": f"{lat}, {lon}" if lat and lon else "",
        "reasons": "; ".join(map(str, reasons)) if isinstance(reasons, list) else "",
    }


def _time_s(table: QueueTable, *wanted: QueueStatus) -> float:
    return float(table.durations_s[table.having(*wanted)].sum())


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"


def _share(part_s: float, total_s: float) -> str:
    return f"{100 * part_s / total_s:.0f} %" if total_s > 0 else ""


def _metres(value: float) -> str:
    return f"{value:.0f} m ({value * FEET_PER_M:.0f} ft)"


def _metres_and_feet(length: Floats) -> tuple[str, str]:
    if not len(length):
        return "–", ""
    return f"{length.max():.0f} m", f"{length.max() * FEET_PER_M:.0f} ft"


def _typical(sigma: Floats) -> str:
    return f"± {np.median(sigma):.1f} m" if len(sigma) else "–"


def _growth(growth: Floats) -> tuple[str, str]:
    """Return a growth that only one value in twenty exceeds: the largest is often one outlier."""
    fast = float(np.percentile(growth, 95)) if len(growth) else 0.0
    if fast <= 0:
        return "none", "never grew"
    return f"{fast:.1f} m/s", f"{fast / MPS_PER_MPH:.1f} mph, 95th percentile"
