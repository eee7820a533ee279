"""One step of the pipeline: parts called in order, and unknown where there is no place."""

from __future__ import annotations

import numpy as np

from queuetail.config import Site, parse_settings
from queuetail.pipeline import Pipeline
from queuetail.presets import PRESETS
from queuetail.types import Frame, Origin, QueueStatus, TelemetrySample, Unknown

ORIGIN = Origin(36.11, -97.057)
AT_100_M = TelemetrySample(0.0, 36.11, -97.057, 100.0, 0.0, -90.0, 0.0, 84.0)
AXIS = [[36.109, -97.057], [36.111, -97.057]]
ROAD = parse_settings(Site, {"approach": [{"name": "NB", "axis": AXIS, "lanes": 2}]}, "x")


def frame(index: int) -> Frame:
    luma = np.full((360, 640), 90, np.uint8)
    return Frame(index, index / 25, luma, lambda w, h: np.full((h, w, 3), 90, np.uint8))


def pipeline(site: Site, laps: list[str]) -> Pipeline:
    return PRESETS["paper"](site, ORIGIN, 640, 360, laps.append)


def test_an_empty_road_is_clear() -> None:
    laps: list[str] = []
    seen = pipeline(ROAD, laps).step(frame(7), AT_100_M)
    assert seen.frame_index == 7
    assert seen.t_s == 7 / 25
    assert [s.status for s in seen.states] == [QueueStatus.CLEAR]
    assert len(seen.vehicles) == 0
    assert seen.detections_px.shape == (0, 4)
    assert len(laps) == len(set(laps)) >= 6


def test_without_telemetry_all_is_unknown_with_reasons_never_clear() -> None:
    line = pipeline(ROAD, [])
    for sample in (TelemetrySample(0.0), AT_100_M, TelemetrySample(0.1)):
        seen = line.step(frame(0), sample)
        if sample is AT_100_M:
            assert seen.states[0].status is QueueStatus.CLEAR
            continue
        assert isinstance(seen.mapping, Unknown)
        (state,) = seen.states
        assert state.status is QueueStatus.UNKNOWN
        assert state.approach == "NB"
        assert "telemetry lacks lat_deg" in state.reasons
        assert state.eoq is None


def test_without_a_road_all_is_unknown_with_reasons() -> None:
    seen = pipeline(Site(), []).step(frame(0), AT_100_M)
    (state,) = seen.states
    assert state.status is QueueStatus.UNKNOWN
    assert "where the road is" in state.reasons[0]
    assert seen.approaches == ()
