"""What is drawn over a frame: boxes, speeds, the end of the queue, the status in words."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from queuetail.geo.ground import enu_to_px
from queuetail.sinks.labels import WHITE, Colour, Labels
from queuetail.sinks.words import known_states, mph_words, place_words, status_words
from queuetail.traffic.road import length_m, place
from queuetail.types import (
    Approach,
    Bools,
    EndOfQueue,
    Floats,
    GroundMapping,
    Image,
    Observation,
    QueueState,
    QueueStatus,
    TrackState,
)

CANDIDATE: Colour = (170, 170, 170)
VEHICLE: Colour = (120, 210, 40)
QUEUED: Colour = (0, 176, 255)
END: Colour = (60, 50, 255)
ROAD: Colour = (225, 215, 190)
STATUS_INK: dict[QueueStatus, Colour] = {
    QueueStatus.CLEAR: (150, 230, 110),
    QueueStatus.QUEUED: QUEUED,
    QueueStatus.BEYOND_VIEW: (140, 150, 255),
    QueueStatus.UNKNOWN: (210, 210, 210),
}
CELL_PX = 4  # of the grid that keeps labels apart
DASH_STEP_M = 3.0
MAX_STATIONS = 400
SHIFT = 3  # fractional bits of the coordinates given to cv2's anti-aliased lines
SHOULDER_M = 1.0  # by which the bar at the end of the queue reaches past the lanes
REACH_PX = 20_000  # coordinates beyond this are outside any picture (and break cv2's integers)


class Overlay:
    """Draws observations into pictures; `size` is the input video's, `drawn` the pictures'."""

    def __init__(self, size: tuple[int, int], drawn: tuple[int, int], title: str) -> None:
        self._scale = np.array([drawn[0] / size[0], drawn[1] / size[1]])
        self._size = drawn
        self._title = title
        self._labels = Labels()
        self._taken: Bools = np.zeros((drawn[1] // CELL_PX + 1, drawn[0] // CELL_PX + 1), bool)
        shorter = min(drawn)
        self._text_px = int(np.clip(round(shorter / 45), 11, 30))
        self._small_px = int(np.clip(round(shorter / 60), 10, 24))
        self._line_px = max(round(shorter / 480), 1)

    def draw(self, image: Image, observation: Observation) -> None:
        """Draw one observation into a BGR picture, in place."""
        self._taken.fill(False)
        mapping = observation.mapping
        if isinstance(mapping, GroundMapping):
            for approach in observation.approaches:
                self._draw_road(image, approach, mapping)
        self._boxes(image, observation.detections_px, CANDIDATE, 1)
        states = known_states(observation, tuple(a.name for a in observation.approaches))
        self._draw_status(image, observation.t_s, states)
        ends = [(s, s.eoq) for s in states if s.eoq is not None]
        self._draw_vehicles(image, observation, {end.track_id for _, end in ends})
        by_name = {a.name: a for a in observation.approaches}
        for state, end in ends:
            self._draw_end(image, state, end, by_name.get(state.approach), mapping)
        self._draw_speeds(image, observation)
        self._draw_legend(image)

    def _draw_road(self, image: Image, approach: Approach, mapping: GroundMapping) -> None:
        stations = axis_stations(approach, DASH_STEP_M)
        edges = road_edges_m(approach)
        for i, offset_m in enumerate(edges):
            px = self._scaled(
                enu_to_px(mapping, place(approach, stations, np.full(len(stations), offset_m)))
            )
            pairs = np.stack([px[:-1], px[1:]], axis=1)
            seen = np.asarray((np.abs(pairs) < REACH_PX).all(axis=(1, 2)))  # False for NaN
            if 0 < i < len(edges) - 1:
                seen[1::3] = seen[2::3] = False
            cv2.polylines(image, list(_fixed(pairs[seen])), False, ROAD, 1, cv2.LINE_AA, SHIFT)

    def _boxes(self, image: Image, boxes_px: Floats, colour: Colour, width_px: int) -> None:
        boxes = boxes_px.reshape(-1, 4) * np.tile(self._scale, 2)
        for x, y, w, h in boxes[np.isfinite(boxes).all(axis=1)].round().clip(-REACH_PX, REACH_PX):
            corner, far = (int(x), int(y)), (int(x + w), int(y + h))
            cv2.rectangle(image, corner, far, colour, width_px)

    def _draw_vehicles(self, image: Image, observation: Observation, ends: set[int]) -> None:
        vehicles, tracks = observation.vehicles, observation.vehicles.tracks
        if not len(vehicles):
            return
        believed = np.array([s is not TrackState.TENTATIVE for s in tracks.states])
        coasting = np.array([s is TrackState.COASTING for s in tracks.states])
        last = believed & np.isin(tracks.ids, list(ends))
        queued = believed & vehicles.queued & ~last
        moving = believed & ~vehicles.queued & ~last
        for chosen, colour in ((moving, VEHICLE), (queued, QUEUED)):
            self._boxes(image, tracks.boxes_px[chosen & coasting], colour, 1)
            self._boxes(image, tracks.boxes_px[chosen & ~coasting], colour, self._line_px + 1)
        self._boxes(image, tracks.boxes_px[last], END, self._line_px + 2)
        for x, y, w, h in self._finite(tracks.boxes_px[believed]):
            self._take(int(x), int(y), int(w), int(h))

    def _draw_end(
        self,
        image: Image,
        state: QueueState,
        end: EndOfQueue,
        approach: Approach | None,
        mapping: object,
    ) -> None:
        """Draw the bar across all lanes, thin lines one sigma to either side, and where it is."""
        foot = self._scaled(np.array([end.px], float))[0]
        if approach is not None and isinstance(mapping, GroundMapping):
            sides = np.array([SHOULDER_M, road_edges_m(approach)[-1] - SHOULDER_M])
            for shift_m in (-end.sigma_m, end.sigma_m, 0.0):
                at = np.full(2, end.station_m + shift_m)
                px = self._scaled(enu_to_px(mapping, place(approach, at, sides)))
                if not np.isfinite(px).all() or np.abs(px).max() > REACH_PX:
                    continue
                if shift_m:
                    cv2.polylines(image, [_fixed(px)], False, END, 1, cv2.LINE_AA, SHIFT)
                    continue
                cv2.polylines(
                    image, [_fixed(px)], False, WHITE, 2 * self._line_px + 3, cv2.LINE_AA, SHIFT
                )
                cv2.polylines(
                    image, [_fixed(px)], False, END, 2 * self._line_px + 1, cv2.LINE_AA, SHIFT
                )
                foot = px[int(px[1, 1] > px[0, 1])]
                (x, y), (x2, y2) = px.min(axis=0), px.max(axis=0)
                self._take(int(x), int(y), int(x2 - x) + 1, int(y2 - y) + 1)
        elif np.isfinite(foot).all():
            centre = (int(foot[0]), int(foot[1]))
            cv2.drawMarker(image, centre, END, cv2.MARKER_TILTED_CROSS, 4 * self._text_px, 3)
        if np.isfinite(foot).all():
            beyond = "beyond, upstream of " if state.status is QueueStatus.BEYOND_VIEW else ""
            self._draw_place(image, f"EOQ {beyond}{place_words(end)}", foot)

    def _draw_place(self, image: Image, text: str, foot: Floats) -> None:
        text = self._labels.fitted(text, self._text_px, self._size[0])
        width, height = self._labels.width(text, self._text_px), self._labels.height(self._text_px)
        free_x, free_y = self._size[0] - width, self._size[1] - height
        x = int(np.clip(foot[0] - width / 2, 0, max(free_x, 0)))
        below, above = foot[1] + height / 2, foot[1] - 3.5 * height
        choices = [int(np.clip(y, 0, max(free_y, 0))) for y in (below, above, below + 2 * height)]
        y = next((y for y in choices if self._is_free(x, y, width, height)), choices[0])
        self._labels.draw(image, text, (x, y), self._text_px, WHITE)
        self._take(x, y, width, height)

    def _draw_speeds(self, image: Image, observation: Observation) -> None:
        """Label each vehicle with its speed, most important first, where there is room for it."""
        vehicles, tracks = observation.vehicles, observation.vehicles.tracks
        order = np.argsort(~vehicles.queued, kind="stable").tolist()
        size, height = self._small_px, self._labels.height(self._small_px)
        boxes = tracks.boxes_px.reshape(-1, 4) * np.tile(self._scale, 2)
        for i in order:
            speed_mps = float(vehicles.speed_mps[i])
            if (
                tracks.states[i] is TrackState.TENTATIVE
                or not np.isfinite([*boxes[i], speed_mps]).all()
            ):
                continue
            number = mph_words(abs(speed_mps))
            x, y, w, h = boxes[i].clip(-REACH_PX, REACH_PX)
            for text in (f"{number} mph", number):
                width = self._labels.width(text, size)
                left = int(x + w / 2 - width / 2)
                places = (int(y) - height - CELL_PX, int(y + h) + CELL_PX)
                top = next((p for p in places if self._is_free(left, p, width, height)), None)
                if top is not None:
                    self._labels.draw(image, text, (left, top), size, WHITE)
                    self._take(left, top, width, height)
                    break

    def _draw_status(self, image: Image, t_s: float, states: tuple[QueueState, ...]) -> None:
        size, (width, height) = self._text_px, self._size
        minutes, seconds = divmod(round(max(t_s, 0.0), 1), 60)
        lines = [(f"{int(minutes)}:{seconds:04.1f} · {self._title}", WHITE)]
        lines += [
            (f"{s.approach}: {status_words(s)}" if s.approach else status_words(s),
             STATUS_INK[s.status])
            for s in states
        ]  # fmt: skip
        row = self._labels.height(size)
        for k, (text, ink) in enumerate(lines[: max(height // (3 * row), 1)]):
            shown = self._labels.fitted(text, size, width)
            self._labels.draw(image, shown, (0, k * row), size, ink)
            self._take(0, k * row, self._labels.width(shown, size), row)

    def _draw_legend(self, image: Image) -> None:
        names = (("candidate", CANDIDATE), ("vehicle", VEHICLE), ("queued", QUEUED),
                 ("end of queue", END))  # fmt: skip
        size = self._small_px
        widths = [self._labels.width(f"■ {name}", size) for name, _ in names]
        if sum(widths) > self._size[0]:
            return
        x, y = 0, self._size[1] - self._labels.height(size)
        for (name, colour), width in zip(names, widths, strict=True):
            self._labels.draw(image, f"■ {name}", (x, y), size, colour)
            x += width

    def _scaled(self, px: Floats) -> Floats:
        return np.asarray(px * self._scale)

    def _finite(self, boxes_px: Floats) -> Floats:
        boxes = boxes_px.reshape(-1, 4) * np.tile(self._scale, 2)
        return np.asarray(boxes[np.isfinite(boxes).all(axis=1)].clip(-REACH_PX, REACH_PX))

    def _cells(self, x: int, y: int, width: int, height: int) -> tuple[slice, slice]:
        def cut(low: int, length: int) -> slice:
            return slice(max(low // CELL_PX, 0), max((low + length - 1) // CELL_PX + 1, 0))

        return cut(y, height), cut(x, width)

    def _is_free(self, x: int, y: int, width: int, height: int) -> bool:
        inside = x >= 0 and y >= 0 and x + width <= self._size[0] and y + height <= self._size[1]
        return inside and not self._taken[self._cells(x, y, width, height)].any()

    def _take(self, x: int, y: int, width: int, height: int) -> None:
        self._taken[self._cells(x, y, width, height)] = True


def axis_stations(approach: Approach, step_m: float) -> Floats:
    """Return stations along the whole axis, `step_m` apart or farther on a very long one."""
    end_m = length_m(approach)
    count = min(max(int(end_m / step_m), 1), MAX_STATIONS) + 1
    return np.linspace(0.0, end_m, count) + approach.start_station_m


def road_edges_m(approach: Approach) -> Floats:
    """Return the offsets of all lane edges, left to right, (lanes + 1,)."""
    return -approach.lane_width_m * np.arange(approach.lanes + 1.0)


def _fixed(px: Floats) -> NDArray[np.int32]:
    return np.asarray(np.round(px * 2**SHIFT), np.int32)
