"""Draw what each stage of the road preset sees, on the bundled flight, for docs/method.md.

python benchmarks/method_pictures.py examples/flagger docs/images
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt  # the backend is chosen before it is loaded

from queuetail.config import read_site
from queuetail.flight import Flight, open_flight
from queuetail.geo.ground import enu_to_px
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.traffic.road import place
from queuetail.types import (
    Approach,
    Floats,
    Frame,
    Image,
    LaneDetections,
    Masks,
    Observation,
    RoadRaster,
    TelemetrySample,
)

MOMENT_S = 58.0  # the queue stands, and cars roll up to it
STRETCH_M = 75.0  # of the strip that is shown, around the end of the queue
SCALE = 2
SMALLER_THAN = 78_000  # bytes
GREEN, RED, YELLOW, WHITE = (90, 220, 90), (60, 60, 240), (40, 220, 250), (255, 255, 255)


@dataclass(slots=True)
class Stages:
    """What the stages of one frame hand on, and the answers of all frames."""

    frame: Frame | None = None
    seen: Observation | None = None
    raster: RoadRaster | None = None
    road: Image | None = None
    masks: Masks | None = None
    detections: LaneDetections | None = None
    times: list[float] = field(default_factory=list)
    stations: list[tuple[float, float]] = field(default_factory=list)  # with sigma


class Listening:
    """Hands a part's calls on, and keeps the last result of one method."""

    def __init__(self, part: Any, method: str) -> None:
        self.last: Any = None
        self._part, self._method = part, method

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._part, name)
        if name != self._method:
            return found

        def call(*arguments: Any) -> Any:
            self.last = found(*arguments)
            return self.last

        return call


def watch(flight_dir: Path) -> Stages:
    """Run the road preset over the flight; keep the stages of the frame at MOMENT_S."""
    stages = Stages()
    site = read_site(flight_dir / "site.toml")
    with open_flight(flight_dir / "flight.mp4", flight_dir / "telemetry.csv", site) as flight:
        size = flight.video.width_px, flight.video.height_px
        pipeline = PRESETS["road"](site, flight.origin, *size, lambda stage: None)
        view = Listening(pipeline.view, "render")
        background = Listening(pipeline.background, "apply")
        detector = Listening(pipeline.detector, "find")
        model: Any = pipeline.background  # its road in the present light is its own affair
        pipeline.view, pipeline.background, pipeline.detector = view, background, detector
        pace = Pace(pipeline.longest_s)
        for frame in flight.frames():
            if not pace.takes(frame.t_s):
                continue
            seen = pipeline.step(frame, _said(flight, frame))
            eoq = seen.states[0].eoq
            stages.times.append(frame.t_s)
            stages.stations.append((eoq.station_m, eoq.sigma_m) if eoq else (np.nan, np.nan))
            if stages.frame is None and frame.t_s >= MOMENT_S and eoq is not None:
                stages.frame, stages.seen = frame, seen
                raster = view.last
                stages.raster = RoadRaster(
                    raster.image.copy(), raster.px_per_m, raster.bands, raster.plan,
                    raster.approaches, raster.spans,
                )  # fmt: skip
                stages.road = cv2.convertScaleAbs(model._lit)
                stages.masks, stages.detections = background.last, detector.last
                stages.frame = Frame(frame.index, frame.t_s, frame.luma, _kept(frame))
    return stages


def _said(flight: Flight, frame: Frame) -> TelemetrySample:
    return flight.telemetry_at(frame.t_s)


def _kept(frame: Frame) -> Any:
    """Convert now: the decoder takes its picture back."""
    picture = frame.bgr(*frame.size).copy()
    return lambda width, height: cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def the_frame(stages: Stages) -> Image:
    """Return the frame with its lanes, its vehicles and the end of the queue."""
    assert stages.frame is not None
    assert stages.seen is not None
    picture = stages.frame.bgr(*stages.frame.size)
    for approach in stages.seen.approaches:
        for lane in range(approach.lanes + 1):
            line = _line_px(approach, lane, stages)
            cv2.polylines(picture, [line], False, YELLOW, 2, cv2.LINE_AA)
    boxes = stages.seen.vehicles.tracks.boxes_px
    for (x, y, width, height), queued in zip(boxes, stages.seen.vehicles.queued, strict=True):
        colour = RED if queued else GREEN
        ends = (round(x), round(y)), (round(x + width), round(y + height))
        cv2.rectangle(picture, *ends, colour, 2, cv2.LINE_AA)
    eoq = stages.seen.states[0].eoq
    assert eoq is not None
    cv2.drawMarker(picture, (round(eoq.px[0]), round(eoq.px[1])), WHITE, cv2.MARKER_CROSS, 40, 3)
    return np.asarray(cv2.resize(picture, (960, 540), interpolation=cv2.INTER_AREA))


def _line_px(approach: Approach, lane: int, stages: Stages) -> np.ndarray[Any, Any]:
    assert stages.seen is not None
    assert stages.raster is not None
    stations = np.linspace(*stages.raster.spans[0], 60)
    offset = np.full(60, -lane * approach.lane_width_m)
    px = enu_to_px(stages.seen.mapping, place(approach, stations, offset))  # type: ignore[arg-type]
    return np.rint(px).astype(np.int32)


def cut(image: Image, stages: Stages) -> Image:
    """Return the stretch around the end of the queue, in colour and enlarged."""
    columns = _stretch(stages)
    part = image[:, columns[0] : columns[1]]
    size = part.shape[1] * SCALE, part.shape[0] * SCALE
    large = cv2.resize(part, size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR))


def _stretch(stages: Stages) -> tuple[int, int]:
    assert stages.raster is not None
    assert stages.seen is not None
    eoq = stages.seen.states[0].eoq
    assert eoq is not None
    middle = _columns(stages, np.array([eoq.station_m]))[0] + 0.15 * STRETCH_M
    half = STRETCH_M / 2 * stages.raster.px_per_m
    first = max(round(middle - half), 0)
    return first, min(round(first + 2 * half), stages.raster.image.shape[1])


def _columns(stages: Stages, station_m: Floats) -> Floats:
    assert stages.raster is not None
    begin, _ = stages.raster.bands[0].visible_columns
    return begin + (station_m - stages.raster.spans[0][0]) * stages.raster.px_per_m


def the_tracks(stages: Stages) -> Image:
    """Return the strip with the measured intervals (thin) and the vehicles followed (thick)."""
    assert stages.raster is not None
    assert stages.seen is not None
    assert stages.detections is not None
    picture = cut(stages.raster.image, stages)
    first = _stretch(stages)[0]
    band, found = stages.raster.bands[0], stages.detections
    for lane, rear, front in zip(found.lane, found.rear_column, found.front_column, strict=True):
        row = round(band.lane_rows[lane - 1] * SCALE)
        ends = [(round((c - first) * SCALE), row) for c in (rear, front)]
        cv2.line(picture, ends[0], ends[1], YELLOW, 2)
    vehicles = stages.seen.vehicles
    rears = _columns(stages, vehicles.rear_station_m)
    fronts = _columns(stages, vehicles.rear_station_m + vehicles.tracks.length_m)
    for i, (rear, front) in enumerate(zip(rears, fronts, strict=True)):
        row = band.lane_rows[vehicles.lane[i] - 1]
        half = 0.95 * stages.raster.px_per_m
        colour = RED if vehicles.queued[i] else GREEN
        corners = [
            (round((column - first) * SCALE), round((row + side) * SCALE))
            for column, side in ((rear, -half), (front, half))
        ]
        cv2.rectangle(picture, corners[0], corners[1], colour, 2)
        label = f"{vehicles.tracks.ids[i]}: {vehicles.speed_mps[i]:.0f} m/s"
        at = corners[0][0], corners[0][1] - 5
        cv2.putText(picture, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, WHITE, 1, cv2.LINE_AA)
    return picture


def draw_end_of_queue(stages: Stages, flight_dir: Path, out: Path) -> None:
    """Plot the end of the queue over time, with two sigmas, and the truth."""
    with (flight_dir / "truth.csv").open(encoding="utf-8") as file:
        rows = [r for r in csv.DictReader(file) if r["eoq_station_m"]]
    times, values = np.array(stages.times), np.array(stages.stations)
    figure, axes = plt.subplots(figsize=(8.6, 3.4), dpi=110)
    true = [(float(r["t_s"]), float(r["eoq_station_m"])) for r in rows]
    axes.plot(*zip(*true, strict=True), ".", color="0.6", ms=5, label="truth")
    station, sigma = values.T
    axes.fill_between(times, station - 2 * sigma, station + 2 * sigma, alpha=0.25, lw=0)
    axes.plot(times, station, lw=1.4, label="queuetail, ± 2 sigma")
    axes.set(xlabel="seconds", ylabel="station, m (downstream is up)", xlim=(0, times[-1]))
    axes.legend(loc="best", frameon=False)
    axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(out, pil_kwargs={"quality": 85})
    plt.close(figure)


def save(picture: Image, out: Path) -> None:
    """Write a JPEG as fine as fits the limit."""
    for quality in range(88, 30, -6):
        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        if len(data) < SMALLER_THAN:
            break
    out.write_bytes(data.tobytes())


def main(flight_dir: Path, out: Path) -> None:
    """Draw all pictures."""
    stages = watch(flight_dir)
    assert stages.raster is not None
    assert stages.road is not None
    assert stages.masks is not None
    save(the_frame(stages), out / "method-frame.jpg")
    save(cut(stages.raster.image, stages), out / "method-strip.jpg")
    save(cut(stages.road, stages), out / "method-road.jpg")
    save(cut(stages.masks.foreign, stages), out / "method-mask.jpg")
    save(the_tracks(stages), out / "method-tracks.jpg")
    draw_end_of_queue(stages, flight_dir, out / "method-eoq.jpg")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit(str(__doc__))
    main(Path(sys.argv[1]), Path(sys.argv[2]))
