"""The road of the road preset: a site's road is aligned once, a found road keeps its names."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from queuetail.config import CameraOverride, Site, read_site
from queuetail.flight import open_flight
from queuetail.geo.ground import px_to_enu
from queuetail.mapping import RegisteredMapper, TelemetryMapper, site_approaches
from queuetail.registrar import STILL, FrameRegistrar
from queuetail.scouted_road import (
    FoundRoad,
    SiteRoad,
    _differs,
    _is_sure,
    _turned,
    _wait_s,
    _with_old_names,
)
from queuetail.traffic.alignment import Alignment
from queuetail.traffic.lane_evidence import NO_MARKS, gather
from queuetail.traffic.paths import Trajectory
from queuetail.traffic.road import locate
from queuetail.types import (
    Approach,
    Frame,
    GroundMapping,
    Origin,
    Registration,
    TelemetrySample,
    Unknown,
)

ORIGIN = Origin(36.11, -97.057)
SAID = TelemetrySample(0.0, 36.11, -97.057, 120.0, 0.0, -90.0, 0.0, 84.0)
PX = np.array([[320.0, 180.0], [100.0, 40.0], [600.0, 300.0]])


def approach(
    name: str, offset_m: float = 0.0, lanes: int = 2, length_m: float = 300.0, back: bool = False
) -> Approach:
    axis = np.array([[-length_m / 2, offset_m], [length_m / 2, offset_m]])
    return Approach(name, axis[::-1] if back else axis, 0.0, lanes, 3.5)


def mapper() -> RegisteredMapper:
    return RegisteredMapper(TelemetryMapper(640, 360, CameraOverride(), ORIGIN), 640, 360)


def mapped(of: RegisteredMapper) -> GroundMapping:
    found = of.mapping(SAID, STILL)
    assert not isinstance(found, Unknown)
    return found


def alignment(rotation_deg: float, shift_m: float, sigma_m: float = 0.15) -> Alignment:
    """Return the correction by a rotation about the origin and a shift to the north."""
    angle = np.radians(rotation_deg)
    c, s = np.cos(angle), np.sin(angle)
    return Alignment(
        H_true_enu=np.array([[c, -s, 0.0], [s, c, shift_m], [0.0, 0.0, 1.0]]),
        rotation_deg=rotation_deg,
        rotation_sigma_deg=0.05,
        tilt_deg=0.0,
        shift_m=shift_m,
        shift_sigma_m=0.1,
        move_m=abs(shift_m) + abs(angle) * 150.0,
        move_sigma_m=sigma_m,
        residual_m=0.3,
        vehicles=12,
        marks=20,
        verges=30,
    )


def test_a_misalignment_is_applied_once_and_the_road_is_laid_out_anew() -> None:
    of = mapper()
    before = px_to_enu(mapped(of), PX)
    approaches = (approach("NB"),)
    road = SiteRoad(approaches, of)
    found = alignment(1.5, 3.0)
    road._accept(found)
    assert px_to_enu(mapped(of), PX) == pytest.approx(found.apply(before), abs=1e-6)
    assert mapped(of).H_true_enu == pytest.approx(found.H_true_enu)
    assert road.alignment is found
    # The picture in hand was mapped without it; the next one is mapped with it.
    assert road.approaches is approaches
    luma = np.full((360, 640), 90, np.uint8)
    road.look(Frame(0, 0.0, luma, lambda w, h: np.zeros((h, w, 3), np.uint8)), mapped(of), STILL)
    assert road.approaches is not approaches
    assert np.array_equal(road.approaches[0].axis_enu, approaches[0].axis_enu)
    # What is looked at afterwards changes nothing more.
    for n in range(1, 100):
        frame = Frame(n, n / 2, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))
        road.look(frame, mapped(of), STILL)
    assert px_to_enu(mapped(of), PX) == pytest.approx(found.apply(before), abs=1e-6)


def test_a_small_misalignment_is_left_alone_and_told() -> None:
    of = mapper()
    before = px_to_enu(mapped(of), PX)
    approaches = (approach("NB"),)
    road = SiteRoad(approaches, of)
    road._accept(alignment(0.05, 0.1))
    assert px_to_enu(mapped(of), PX) == pytest.approx(before, abs=1e-9)
    assert road.approaches is approaches
    assert road.alignment is not None


def test_after_a_cut_telemetry_may_be_off_by_something_else() -> None:
    of = mapper()
    road = SiteRoad((approach("NB"),), of)
    luma = np.full((360, 640), 90, np.uint8)
    blank = Frame(0, 0.0, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))
    road.look(blank, mapped(of), STILL)
    road._take(alignment(2.0, 0.0))
    assert not road._watching
    road.look(blank, mapped(of), STILL)
    assert not road._watching
    road.look(blank, mapped(of), dataclasses.replace(STILL, epoch=1))
    assert road._watching
    trusted = mapped(of).pose_sigma.yaw_deg
    road._accept(alignment(0.0, 0.1))
    assert mapped(of).pose_sigma.yaw_deg == trusted


@pytest.mark.parametrize(("vehicles", "marks"), [(0, 8), (5, 0), (2, 3)])
def test_few_lines_that_nobody_drives_between_move_nothing(vehicles: int, marks: int) -> None:
    road = SiteRoad((approach("NB"),), mapper())
    road._begin(0.0, 0)
    for sigma_m in (0.15, 0.5):
        few = alignment(0.0, 3.0, sigma_m)
        road._take(dataclasses.replace(few, vehicles=vehicles, marks=marks))
        assert road.alignment is None
    for enough in ({"vehicles": 0, "marks": 12}, {"vehicles": 1, "marks": 8}):
        assert _is_sure(dataclasses.replace(alignment(0.0, 3.0), **enough))


def test_a_rough_alignment_serves_until_a_sure_one_replaces_it() -> None:
    of = mapper()
    before = px_to_enu(mapped(of), PX)
    road = SiteRoad((approach("NB"),), of)
    road._begin(0.0, 0)
    road._take(alignment(0.0, 1.0, sigma_m=0.55))  # by less than two sigmas: nothing is sure
    assert road.alignment is None
    rough, sure = alignment(0.0, 3.0, sigma_m=0.5), alignment(0.0, 2.2)
    road._take(rough)
    assert road._watching
    assert px_to_enu(mapped(of), PX) == pytest.approx(rough.apply(before), abs=1e-6)
    road._take(alignment(0.0, 5.0, sigma_m=0.5))  # one rough alignment is enough
    assert px_to_enu(mapped(of), PX) == pytest.approx(rough.apply(before), abs=1e-6)
    more = dataclasses.replace(alignment(0.0, 5.0, sigma_m=0.5), vehicles=30, marks=40)
    road._take(more)  # unless much more agrees on another
    assert px_to_enu(mapped(of), PX) == pytest.approx(more.apply(before), abs=1e-6)
    # All are of telemetry's own places: none is laid on another.
    road._take(sure)
    assert not road._watching
    assert px_to_enu(mapped(of), PX) == pytest.approx(sure.apply(before), abs=1e-6)


def test_a_road_far_aside_is_moved_early_and_again_with_more_evidence() -> None:
    of = mapper()
    before = px_to_enu(mapped(of), PX)
    road = SiteRoad((approach("NB"),), of)
    road._begin(0.0, 0)
    road._take(alignment(0.0, 2.6, sigma_m=0.9))  # by less than three sigmas
    assert road.alignment is None
    far = alignment(0.0, 4.0, sigma_m=0.9)
    road._take(far)
    assert px_to_enu(mapped(of), PX) == pytest.approx(far.apply(before), abs=1e-6)
    path = np.column_stack([np.linspace(-120.0, 120.0, 75), np.full(75, -2.0)])
    road._seen = gather([Trajectory(np.arange(75) * 0.2, path)] * 5, NO_MARKS)
    more = dataclasses.replace(alignment(0.0, 3.4, sigma_m=0.6), vehicles=30, marks=40)
    road._take(more)
    assert px_to_enu(mapped(of), PX) == pytest.approx(more.apply(before), abs=1e-6)


def test_a_sure_alignment_like_the_rough_one_changes_nothing() -> None:
    of = mapper()
    before = px_to_enu(mapped(of), PX)
    road = SiteRoad((approach("NB"),), of)
    road._begin(0.0, 0)
    rough = alignment(0.0, 3.0, sigma_m=0.5)
    road._take(rough)
    path = np.column_stack([np.linspace(-120.0, 120.0, 75), np.full(75, -2.0)])
    road._seen = gather([Trajectory(np.arange(75) * 0.2, path)] * 5, NO_MARKS)
    road._take(alignment(0.0, 2.8))
    assert not road._watching
    assert px_to_enu(mapped(of), PX) == pytest.approx(rough.apply(before), abs=1e-6)


def test_an_axis_drawn_against_the_traffic_is_told() -> None:
    there = approach("NB")
    t = np.arange(0.0, 15.0, 0.2)
    path = np.column_stack([np.linspace(-120.0, 120.0, len(t)), np.full(len(t), -2.0)])
    along, against = [Trajectory(t, path)] * 5, [Trajectory(t, path[::-1])] * 5
    assert _turned((there,), gather(along, NO_MARKS)) == ()
    assert _turned((there,), gather(against, NO_MARKS)) == ("NB",)
    assert _turned((there,), gather(against[:3], NO_MARKS)) == ()
    assert _turned((there,), gather([*against, *along], NO_MARKS)) == ()
    road = SiteRoad((there,), mapper())
    road._turned = ("NB",)
    assert "turn it round" in road.notes[0]


def test_telemetry_that_was_far_off_is_trusted_less() -> None:
    sigmas = []
    for rotation_deg in (0.0, 1.0, 4.0):
        of = mapper()
        SiteRoad((approach("NB"),), of)._accept(alignment(rotation_deg, 0.0))
        sigmas.append(mapped(of).pose_sigma.yaw_deg)
    assert sigmas == sorted(sigmas)
    assert sigmas[0] < sigmas[-1]


@pytest.mark.parametrize(
    ("new", "differs"),
    [
        ([approach("a")], False),
        ([approach("a", offset_m=0.2)], False),
        ([approach("a", offset_m=1.5)], True),
        ([approach("a", lanes=3)], True),
        ([approach("a", length_m=328.0)], False),
        ([approach("a", length_m=500.0)], True),
        ([approach("a", length_m=340.0)], True),  # 20 m more upstream
        ([Approach("a", np.array([[-150.0, 0.0], [164.0, 0.0]]), 0.0, 2, 3.5)], False),
        ([Approach("a", np.array([[-150.0, 0.0], [166.0, 0.0]]), 0.0, 2, 3.5)], True),
        ([approach("a", back=True)], True),
        ([approach("a"), approach("b", offset_m=12.0, back=True)], True),
    ],
)
def test_only_another_road_is_worth_starting_anew(new: list[Approach], differs: bool) -> None:
    assert _differs((approach("NB"),), tuple(new)) is differs


def test_an_approach_found_again_keeps_its_name() -> None:
    old = (approach("NB"), approach("SB", offset_m=12.0, back=True))
    new = (approach("a", offset_m=11.0, back=True), approach("b", offset_m=0.5, lanes=3))
    found = _with_old_names(new, old)
    assert [a.name for a in found] == ["SB", "NB"]
    assert found[1].lanes == 3


def test_names_stay_unlike_when_one_road_becomes_two() -> None:
    found = _with_old_names((approach("a"), approach("b", offset_m=4.0)), (approach("NB"),))
    assert len({a.name for a in found}) == 2


def test_nothing_is_found_where_nothing_moves() -> None:
    road, mapping = FoundRoad(), mapped(mapper())
    luma = np.random.default_rng(0).integers(80, 100, (360, 640)).astype(np.uint8)
    for n in range(120):
        frame = Frame(n, n / 8, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))
        road.look(frame, mapping, Registration(np.eye(3), 1.0))
    assert road.approaches == ()


def test_lines_are_looked_for_where_the_road_is_known_to_be() -> None:
    road = FoundRoad()
    road._aim(1.0)
    assert road._aim_at == ()
    road.approaches = (approach("a"),)
    road._aim(2.0)
    lines = road._lines
    road._aim(5.0)
    assert road._lines is lines
    assert road._aimed_s == 2.0
    road.approaches = (approach("a", offset_m=3.0),)
    road._aim(8.0)
    assert road._lines is not lines
    road._begin_anew(1)
    assert road._aim_at == ()


@pytest.mark.parametrize(("known_s", "wait_s"), [(-np.inf, 0.5), (0.0, 1), (5.0, 2), (40.0, 16)])
def test_refinements_become_rare(known_s: float, wait_s: float) -> None:
    assert _wait_s(known_s) == pytest.approx(wait_s)


def test_the_bundled_flights_road_is_found_within_12_s_to_a_decimetre(flagger: Path) -> None:
    """Two lanes, southbound."""
    with open_flight(flagger / "flight.mp4", flagger / "telemetry.csv", Site()) as flight:
        size = flight.video.width_px, flight.video.height_px
        assert flight.origin is not None
        told = TelemetryMapper(*size, CameraOverride(), flight.origin)
        registrar, of, road = (
            FrameRegistrar(*size, told),
            RegisteredMapper(told, *size),
            FoundRoad(),
        )
        done_s = -1.0
        for frame in flight.frames():
            if frame.t_s > 12.0:
                break
            if frame.t_s - done_s < 0.11:
                continue
            done_s = frame.t_s
            sample = flight.telemetry_at(frame.t_s)
            registration = registrar.register(frame, sample)
            mapping = of.mapping(sample, registration)
            assert not isinstance(mapping, Unknown)
            road.look(frame, mapping, registration)
    (found,) = road.approaches
    assert found.lanes == 2
    (true,) = site_approaches(read_site(flagger / "site.toml"), flight.origin)
    station, offset, _ = locate(true, found.axis_enu)
    seen = (station > 760.0) & (station < 1040.0)
    assert np.abs(offset[seen]).max() < 0.15
    assert found.lane_width_m == pytest.approx(true.lane_width_m, abs=0.05)
    assert found.lane_width_m == pytest.approx(3.6, abs=0.4)
    ahead = found.axis_enu[-1] - found.axis_enu[0]
    assert ahead[1] < -abs(ahead[0])
