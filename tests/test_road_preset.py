"""The road preset on the bundled flight: with and without a site file, and through a black-out."""

from __future__ import annotations

import csv
import dataclasses
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from queuetail.config import Site, SiteInfo, read_site
from queuetail.flight import Flight, open_flight
from queuetail.geo.earth import enu_from_geodetic
from queuetail.mapping import site_approaches
from queuetail.pipeline import Pipeline
from queuetail.presets import PRESETS
from queuetail.traffic.road import locate
from queuetail.types import Frame, Observation, QueueState, QueueStatus, TelemetrySample, Unknown

END_S = 45.0
# Not a road, only what the truth counts as queued.
NO_ROAD = Site(site=SiteInfo(posted_speed_mph=65))
FORMED_S = 27.4  # two seconds after the queue began to form, in which it may be missed
NEAR_M = 3.0
NEAR_SHARE = {"with site": 0.9, "without site": 0.8}  # the rest: who just became queued
STEP_S = 1 / 15 - 0.002
Change = Callable[[Frame], Frame]


def opened(flagger: Path, site: Site) -> tuple[Flight, Pipeline]:
    flight = open_flight(flagger / "flight.mp4", flagger / "telemetry.csv", site)
    size = flight.video.width_px, flight.video.height_px
    return flight, PRESETS["road"](site, flight.origin, *size, lambda stage: None)


def observed(
    flagger: Path, site: Site, end_s: float, change: Change = lambda frame: frame
) -> Iterator[Observation]:
    flight, pipeline = opened(flagger, site)
    with flight:
        done_s = -np.inf
        for frame in flight.frames():
            if frame.t_s > end_s:
                return
            if frame.t_s - done_s >= STEP_S:
                done_s = frame.t_s
                yield pipeline.step(change(frame), flight.telemetry_at(frame.t_s))


def truth(flagger: Path) -> list[tuple[float, float | None, tuple[float, float] | None]]:
    """Return time, station and place (lat, lon) of the true end of the queue."""
    with (flagger / "truth.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    found = []
    for row in rows:
        place = (float(row["eoq_lat"]), float(row["eoq_lon"])) if row["eoq_lat"] else None
        found.append((float(row["t_s"]), float(row["eoq_station_m"]) if place else None, place))
    return found


@pytest.fixture(scope="module", params=["with site", "without site"])
def flown(request: pytest.FixtureRequest, flagger: Path) -> tuple[str, list[Observation]]:
    site = read_site(flagger / "site.toml") if request.param == "with site" else NO_ROAD
    return request.param, list(observed(flagger, site, END_S))


def the_state(seen: Observation) -> QueueState:
    """Return the one state that matters: of the approach that has a queue, or else the first."""
    return max(seen.states, key=lambda s: s.eoq is not None)


def test_the_end_of_the_queue_is_within_metres_of_the_truth(
    flown: tuple[str, list[Observation]], flagger: Path
) -> None:
    flight, _ = opened(flagger, Site())
    origin = flight.origin
    flight.__exit__(None, None, None)
    assert origin is not None
    site = read_site(flagger / "site.toml")
    (axis,) = site_approaches(site, origin)
    actual = truth(flagger)
    times = np.array([t for t, _, _ in actual])
    errors, missed = [], 0
    for seen in flown[1]:
        t_s, _, place = actual[int(np.abs(times - seen.t_s).argmin())]
        if place is None or t_s < FORMED_S:
            continue
        eoq = the_state(seen).eoq
        if eoq is None or eoq.lat_deg is None or eoq.lon_deg is None:
            missed += 1
            continue
        places = np.array([place, (eoq.lat_deg, eoq.lon_deg)])
        station, _, _ = locate(axis, enu_from_geodetic(places[:, 0], places[:, 1], origin))
        errors.append(abs(float(station[1] - station[0])))
    assert len(errors) > 200
    assert missed / (missed + len(errors)) < 0.05
    assert np.median(errors) < 1.2
    assert np.mean(np.array(errors) < NEAR_M) > NEAR_SHARE[flown[0]]


def test_no_queue_is_seen_before_there_is_one(flown: tuple[str, list[Observation]]) -> None:
    kind, seen = flown
    early = [the_state(o).status for o in seen if 2.0 < o.t_s < 24.0]
    assert len(early) > 200
    wrong = sum(s in (QueueStatus.QUEUED, QueueStatus.BEYOND_VIEW) for s in early)
    assert wrong == 0
    if kind == "with site":
        assert set(early) == {QueueStatus.CLEAR}


def test_without_a_road_the_answer_is_unknown_with_the_reason(
    flown: tuple[str, list[Observation]],
) -> None:
    kind, seen = flown
    first = seen[0].states[0]
    if kind == "without site":
        assert first.status is QueueStatus.UNKNOWN
        assert "where the road is" in first.reasons[0]
        assert seen[0].approaches == ()
        known_s = next(o.t_s for o in seen if o.approaches)
        assert known_s < 20.0
    else:
        assert first.status is QueueStatus.UNKNOWN
        assert "watched" in first.reasons[0]


def test_vehicles_have_metres_lanes_and_speeds(flown: tuple[str, list[Observation]]) -> None:
    driving = next(o for o in flown[1] if o.t_s > 13.0)
    vehicles = driving.vehicles
    assert len(vehicles) >= 3
    assert set(vehicles.lane.tolist()) <= {1, 2}
    free = vehicles.speed_mps[vehicles.speed_mps > 5]
    assert 10 < np.median(free) < 35
    assert (vehicles.tracks.length_m > 2.0).all()
    assert (vehicles.tracks.sigma_m > 0).all()


def test_a_found_road_is_that_of_the_site(flown: tuple[str, list[Observation]]) -> None:
    (approach,) = flown[1][-1].approaches
    assert approach.lanes == 2
    assert approach.lane_width_m == pytest.approx(3.6, abs=0.5)
    ahead = approach.axis_enu[-1] - approach.axis_enu[0]
    assert ahead[1] < 0  # southbound


def black_between(begin_s: float, end_s: float) -> Change:
    def change(frame: Frame) -> Frame:
        if begin_s <= frame.t_s < end_s:
            return dataclasses.replace(frame, luma=np.full_like(frame.luma, 16))
        return frame

    return change


def test_black_pictures_are_unknown_and_the_next_ones_are_not(flagger: Path) -> None:
    site = read_site(flagger / "site.toml")
    seen = list(observed(flagger, site, 6.0, black_between(2.5, 3.5)))
    for observation in seen:
        (state,) = observation.states
        if 2.5 <= observation.t_s < 3.45:
            assert state.status is QueueStatus.UNKNOWN
            assert state.reasons[0]
            assert state.eoq is None
            assert isinstance(observation.mapping, Unknown)
        elif observation.t_s > 4.6 or 1.1 < observation.t_s < 2.45:
            assert state.status is QueueStatus.CLEAR, observation.t_s


def test_a_picture_of_another_scene_never_uses_the_old_mapping(flagger: Path) -> None:
    """A cut to noise: unknown at first, whatever comes after."""
    rng = np.random.default_rng(0)
    noise = rng.integers(20, 235, (720, 1280)).astype(np.uint8)

    def cut(frame: Frame) -> Frame:
        return dataclasses.replace(frame, luma=noise) if frame.t_s >= 1.5 else frame

    site = read_site(flagger / "site.toml")
    after = [o for o in observed(flagger, site, 1.9, cut) if o.t_s >= 1.5]
    assert after
    assert {o.states[0].status for o in after} == {QueueStatus.UNKNOWN}
    assert all(o.states[0].reasons for o in after)


def test_without_telemetry_there_is_no_answer_but_reasons(flagger: Path) -> None:
    site = read_site(flagger / "site.toml")
    flight, pipeline = opened(flagger, site)
    with flight:
        for frame in itertools.islice(flight.frames(), 3):
            (state,) = pipeline.step(frame, TelemetrySample(frame.t_s)).states
            assert state.status is QueueStatus.UNKNOWN
            assert "telemetry" in state.reasons[0]


def test_a_gap_in_telemetry_does_not_end_the_answer(flagger: Path) -> None:
    """Registration carries the picture on while the log is silent."""
    site = read_site(flagger / "site.toml")
    flight, pipeline = opened(flagger, site)
    with flight:
        for number, frame in enumerate(itertools.islice(flight.frames(), 60)):
            silent = number > 40
            sample = TelemetrySample(frame.t_s) if silent else flight.telemetry_at(frame.t_s)
            (state,) = pipeline.step(frame, sample).states
            expected = QueueStatus.UNKNOWN if frame.t_s < 1.0 else QueueStatus.CLEAR
            assert state.status is expected, number
