"""The pictures of a finished run, any of them, and where they lie on the ground."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from threading import Lock
from typing import Any

import av
import numpy as np
from av.container import InputContainer
from av.error import FFmpegError
from av.video.frame import VideoFrame

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.flight import Flight, open_flight
from queuetail.geo.ground import mapping_from_control_points, mapping_from_pose, px_to_enu
from queuetail.mapping import camera_pose
from queuetail.types import (
    Floats,
    Frame,
    GroundMapping,
    Image,
    Origin,
    TelemetrySample,
    Unknown,
)
from queuetail.video.capture import VideoFile, frame_of

ANNOTATED = "annotated.mp4"
AHEAD_S = 4.0  # decoding on is quicker than seeking, up to here
SLACK_S = 0.002
LEAST_PAIRS = 8
MOST_PAIRS = 400


class RunPictures:
    """Decodes the picture at any time; without a video there is none."""

    def __init__(
        self,
        folder: Path,
        record: dict[str, Any],
        video: Path | None,
        telemetry: Path | None,
        site: Site,
    ) -> None:
        """Open `video`, else the run's annotated one if it is there; raises InputError."""
        path = video or (folder / ANNOTATED if (folder / ANNOTATED).is_file() else None)
        self.is_drawn = video is None and path is not None
        told = record.get("video") or {}
        self.name = str(path.name if path is not None else told.get("name") or folder.name)
        self.size: tuple[int, int] | None = None
        self._site = site
        self._flight: Flight | None = None
        self._lock = Lock()
        self._container: InputContainer | None = None
        if path is None:
            return
        with VideoFile(path) as file:
            info = file.info
        self._rotation_deg = info.rotation_deg
        width, height = told.get("width_px"), told.get("height_px")
        self.size = (width, height) if width and height else (info.width_px, info.height_px)
        self._path = path
        self._rewind()
        if video is not None:
            self._flight = flight_of(video, telemetry, site)

    def frame(self, t_s: float, index: int) -> Frame | None:
        """Return the frame at a time; it is decoded when its colours are asked for."""
        if self.size is None:
            return None
        width, height = self.size
        luma = np.broadcast_to(np.zeros(1, np.uint8), (height, width))

        def bgr(width_px: int, height_px: int) -> Image:
            with self._lock:
                picture = self._picture(t_s)
                if picture is None:
                    return np.zeros((height_px, width_px, 3), np.uint8)
                return frame_of(index, t_s, picture, self._rotation_deg).bgr(width_px, height_px)

        return Frame(index, t_s, luma, bgr)

    def telemetry_at(self, t_s: float) -> TelemetrySample | None:
        """Return what telemetry said, where the flight's files were given."""
        return self._flight.telemetry_at(t_s) if self._flight is not None else None

    def mapping_by_pose(self, t_s: float, origin: Origin | None) -> GroundMapping | None:
        """Return where telemetry says that the picture lies."""
        sample = self.telemetry_at(t_s)
        if sample is None or origin is None or self.size is None:
            return None
        pose = camera_pose(sample, *self.size, self._site.camera)
        return None if isinstance(pose, Unknown) else mapping_from_pose(pose, origin)

    def close(self) -> None:
        """Release the files."""
        with self._lock:
            if self._container is not None:
                self._container.close()
        if self._flight is not None:
            self._flight.__exit__(None, None, None)

    def _rewind(self) -> None:
        if self._container is not None:
            self._container.close()
        self._container = av.open(str(self._path))
        stream = self._container.streams.video[0]
        stream.thread_type = "AUTO"
        self._decoded: Iterator[VideoFrame] = self._container.decode(stream)
        self._shown = next(self._decoded, None)
        self._next: VideoFrame | None = None
        self._first_s = (self._shown.time or 0.0) if self._shown is not None else 0.0

    def _picture(self, t_s: float) -> VideoFrame | None:
        """Return the last picture that is not after a time."""
        goal_s = t_s + self._first_s + SLACK_S
        shown_s = (self._shown.time or 0.0) if self._shown is not None else 0.0
        try:
            if self._shown is None or goal_s < shown_s or goal_s > shown_s + AHEAD_S:
                self._seek(goal_s)
            while True:
                if self._next is None:
                    self._next = next(self._decoded, None)
                if self._next is None or (self._next.time or 0.0) > goal_s:
                    return self._shown
                self._shown, self._next = self._next, None
        except FFmpegError:
            return self._shown  # a damaged part: the picture before it stays

    def _seek(self, goal_s: float) -> None:
        assert self._container is not None
        self._container.seek(int(max(goal_s, 0.0) * av.time_base))
        self._decoded = self._container.decode(self._container.streams.video[0])
        self._shown, self._next = next(self._decoded, None), None


def flight_of(video: Path, telemetry: Path | None, site: Site) -> Flight | None:
    """Open the flight for its telemetry; None where it has none and none was asked for."""
    try:
        return open_flight(video, telemetry, site)
    except InputError:
        if telemetry is not None:
            raise
        return None


def mapping_at(
    px: Floats,
    enu: Floats,
    origin: Origin | None,
    by_pose: GroundMapping | None,
    size: tuple[int, int] | None,
) -> GroundMapping | None:
    """Fit where a picture lies to the vehicles in it, and beside the road to telemetry.

    The tables tell pixel and place of each vehicle; telemetry alone would be metres off.
    """
    good = np.isfinite(px).all(axis=1) & np.isfinite(enu).all(axis=1)
    px, enu = px[good], enu[good]
    if len(px) < LEAST_PAIRS:
        return by_pose
    step = len(px) // MOST_PAIRS + 1
    px, enu = px[::step], enu[::step]
    if by_pose is not None and size is not None:
        across, down = np.meshgrid([0.05, 0.5, 0.95], [0.3, 0.6, 0.95])
        beside = np.column_stack([across.ravel() * size[0], down.ravel() * size[1]])
        there = px_to_enu(by_pose, beside)
        seen = np.isfinite(there).all(axis=1)
        px, enu = np.concatenate([px, beside[seen]]), np.concatenate([enu, there[seen]])
    try:
        fitted = mapping_from_control_points(px, enu, origin)
    except (ValueError, np.linalg.LinAlgError):
        return by_pose
    return dataclasses.replace(fitted, pose=by_pose.pose if by_pose is not None else None)
