"""Views: which part of the picture a preset works on, and back from its pixels to the ground."""

from __future__ import annotations

import numpy as np

from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import covariance, px_to_enu
from queuetail.geo.paper import ground_offset_m
from queuetail.types import (
    Approach,
    Detections,
    Floats,
    Frame,
    GroundMapping,
    GroundPoints,
    Image,
    Raster,
)


class WholeFrame:
    """The whole frame in colour, scaled to a fixed width: the paper's 720×406."""

    def __init__(self, width_px: int) -> None:
        self._width_px = width_px

    def render(
        self, frame: Frame, mapping: GroundMapping, approaches: tuple[Approach, ...]
    ) -> Raster:
        """Return the frame scaled once, by the decoder's own scaler; never enlarged."""
        width, height = frame.size
        out_width = min(self._width_px, width)
        out_height = max(round(height * out_width / width), 1)
        H_px_raster = np.diag([width / out_width, height / out_height, 1.0])
        return Raster(frame.bgr(out_width, out_height), H_px_raster)

    def cover(self, footprints: None) -> Image:
        """Return an empty mask: the paper's background learns everything, stopped cars too."""
        return np.empty((0, 0), np.uint8)

    def low(self, footprints: None) -> None:
        """Return nothing: the paper's blobs hide nothing of each other."""

    def locate(
        self, detections: Detections, raster: Raster, mapping: GroundMapping
    ) -> GroundPoints:
        """Place each blob's centre on the ground by the paper's equations; NaN above the horizon.

        The extent is that of the box: along the line of sight and across it, whichever is longer.
        """
        boxes = boxes_to_px(detections.boxes, raster)
        centre = boxes[:, :2] + boxes[:, 2:] / 2
        half_width, half_height = boxes[:, 2] / 2, boxes[:, 3] / 2
        zero = np.zeros(len(boxes))
        left = paper_px_to_enu(mapping, centre - np.column_stack([half_width, zero]))
        right = paper_px_to_enu(mapping, centre + np.column_stack([half_width, zero]))
        near = paper_px_to_enu(mapping, centre + np.column_stack([zero, half_height]))
        far = paper_px_to_enu(mapping, centre - np.column_stack([zero, half_height]))
        across = np.linalg.norm(right - left, axis=1)
        along = np.linalg.norm(far - near, axis=1)
        spread = covariance(mapping, centre)
        return GroundPoints(
            px=centre,
            boxes_px=boxes,
            enu=paper_px_to_enu(mapping, centre),
            sigma_m=np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2),
            length_m=np.maximum(across, along),
            width_m=np.minimum(across, along),
        )


def boxes_to_px(boxes: Floats, raster: Raster) -> Floats:
    """Scale boxes (x, y, width, height) from raster pixels to input-video pixels."""
    scale = np.array([raster.H_px_raster[0, 0], raster.H_px_raster[1, 1]])
    return np.asarray(boxes * np.tile(scale, 2))


def paper_px_to_enu(mapping: GroundMapping, px: Floats) -> Floats:
    """Return ground metres by the paper's equations, or by control points if given."""
    if mapping.pose is None or mapping.origin is None:
        return px_to_enu(mapping, px)
    lat, lon = np.array(mapping.pose.lat_deg), np.array(mapping.pose.lon_deg)
    camera = enu_from_geodetic(lat, lon, mapping.origin)
    return np.asarray(ground_offset_m(px, mapping.pose) + camera)
