"""A recorded flight: its video, its telemetry and where on earth it is, opened and checked."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

from queuetail.config import Site, TelemetryFill
from queuetail.errors import InputError
from queuetail.mapping import POSE_FIELDS, corrected, site_origin
from queuetail.telemetry import FlightLog, read_telemetry
from queuetail.telemetry.container import NoTelemetryError
from queuetail.telemetry.read import VideoClock
from queuetail.types import Frame, Origin, TelemetrySample
from queuetail.video import VideoFile, VideoInfo
from queuetail.video.ahead import ahead

SIDECARS = (".srt", ".SRT", ".csv", ".CSV")  # what a drone or our simulator puts beside its video
OVERLAP_SLACK_S = 1.0


class Flight:
    """An opened recording: frames in order, and what telemetry says at each of them."""

    def __init__(
        self,
        video: VideoFile,
        log: FlightLog | None,
        telemetry_path: Path | None,
        origin: Origin | None,
        correction: TelemetryFill,
    ) -> None:
        self._file = video
        self._log = log
        self._correction = correction
        self.origin = origin
        self.telemetry_path = telemetry_path
        self.video: VideoInfo = video.info
        self.video_path = video.path

    def __enter__(self) -> Flight:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    def frames(self) -> Iterator[Frame]:
        """Yield the video's frames in order of time, decoded ahead."""
        return ahead(self._file.frames())

    def telemetry_at(self, t_s: float) -> TelemetrySample:
        """Return what telemetry says at `t_s`, corrected; empty where there is none."""
        if self._log is None:
            return TelemetrySample(t_s)
        return corrected(self._log.at(t_s), self._correction)

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the input: damage, dropped samples, assumptions."""
        return (*self._file.notes, *(self._log.notes if self._log is not None else ()))


def open_flight(video: Path, telemetry: Path | None, site: Site) -> Flight:
    """Open a recording; raises InputError when its place on the ground cannot be known."""
    file = VideoFile(video)
    try:
        log, source = _find_log(file, telemetry, site)
        if log is not None and not site.control_point:
            _check_fields(log, source or video, site)
        if log is not None:
            _check_overlap(log, source or video, file.info)
        origin = site_origin(site)
        if origin is None and log is not None and not site.control_point:
            origin = _first_place(log)  # control points in local metres stay local: not one place
    except InputError:
        file.close()
        raise
    return Flight(file, log, source, origin, site.telemetry)


def _find_log(
    file: VideoFile, telemetry: Path | None, site: Site
) -> tuple[FlightLog | None, Path | None]:
    """Read the given log; else, without control points, a sidecar or what the video holds."""
    clock = VideoClock(file.info.start_utc, file.info.duration_s)
    if telemetry is not None:
        return _completed(read_telemetry(telemetry, clock), site), telemetry
    if site.control_point:
        return None, None
    for suffix in SIDECARS:
        sidecar = file.path.with_suffix(suffix)
        if sidecar.is_file():
            return _completed(read_telemetry(sidecar, clock), site), sidecar
    try:
        return _completed(read_telemetry(file.path, clock), site), file.path
    except NoTelemetryError:
        raise InputError(
            f"{file.path} comes with no telemetry: name its log with --telemetry, or give a site "
            "file with at least 4 [[control_point]] entries (--site)"
        ) from None


def _completed(log: FlightLog, site: Site) -> FlightLog:
    """Shift the log by the site's offset and fill what it lacks with the site's constants."""
    constants = site.telemetry.constants
    if site.camera.hfov_deg is not None:
        constants["hfov_deg"] = site.camera.hfov_deg
    return log.shifted(site.telemetry.offset_s).filled(**constants)


def _check_fields(log: FlightLog, source: Path, site: Site) -> None:
    missing = [name for name in POSE_FIELDS if name not in log.fields]
    if not missing:
        return
    in_camera = [name for name in missing if name == "hfov_deg"]
    in_telemetry = [name for name in missing if name != "hfov_deg"]
    tables = []
    if in_telemetry:
        tables.append(f"{', '.join(in_telemetry)} under [telemetry]")
    if in_camera:
        tables.append("hfov_deg under [camera]")
    found = "; ".join(note.removeprefix(f"{log.source}: ") for note in log.notes)
    raise InputError(
        f"{source} lacks {', '.join(missing)}; "
        f"give {' and '.join(tables)} in the site file (--site)"
        + (f"; found in the log: {found}" if found else "")
    )


def _check_overlap(log: FlightLog, source: Path, video: VideoInfo) -> None:
    first_s, last_s = log.span_s
    end_s = video.duration_s if video.duration_s is not None else float("inf")
    if first_s > end_s + OVERLAP_SLACK_S or last_s < -OVERLAP_SLACK_S:
        raise InputError(
            f"{source} covers {first_s:.1f} … {last_s:.1f} s but the video {video.name} runs "
            f"0 … {end_s:.1f} s: they do not overlap; "
            "set offset_s under [telemetry] in the site file"
        )


def _first_place(log: FlightLog) -> Origin | None:
    for sample in log.samples:
        if sample.lat_deg is not None and sample.lon_deg is not None:
            return Origin(sample.lat_deg, sample.lon_deg)
    if {"lat_deg", "lon_deg"} <= log.constants.keys():
        return Origin(log.constants["lat_deg"], log.constants["lon_deg"])
    return None
