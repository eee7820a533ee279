"""The queue over time, by table: who is queued, what the road's state is, and how sure."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from fleet import fleet

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose
from queuetail.traffic.growth import Growth
from queuetail.traffic.road import assign
from queuetail.traffic.state import QueueWatch, _Memory, step, with_companions
from queuetail.types import (
    Approach,
    CameraPose,
    Origin,
    PoseSigma,
    QueueState,
    QueueStatus,
    RoadRaster,
    RoadVehicles,
    Scene,
    TrackState,
)

LIMIT_MPS = 10.0
ROAD = (Approach("NB", np.array([[0.0, 0.0], [600.0, 0.0]]), 0.0, 2, 3.6),)
SPAN = (100.0, 400.0)
POSE = CameraPose(36.11, -97.0544, 150.0, 0.0, -90.0, 0.0, intrinsics_from_hfov(1280, 720, 84.0))
MAPPING = mapping_from_pose(POSE, Origin(36.11, -97.057))

SLOW, BETWEEN, FAST = 3.0, 11.0, 20.0  # below the limit; above it but not by a quarter; free


@pytest.mark.parametrize(
    ("queued", "speeds", "after"),
    [
        # (seconds, speed) … -> queued
        (False, [(0.0, FAST), (5.0, FAST)], False),
        (False, [(0.0, SLOW)], False),
        (False, [(0.0, SLOW), (0.5, SLOW)], False),
        (False, [(0.0, SLOW), (1.1, SLOW)], True),
        (False, [(0.0, SLOW), (0.5, FAST), (0.6, SLOW), (1.2, SLOW)], False),
        (False, [(0.0, SLOW), (0.5, BETWEEN), (0.6, SLOW), (1.2, SLOW)], False),
        (False, [(0.0, BETWEEN), (9.0, BETWEEN)], False),
        (False, [(0.0, LIMIT_MPS), (9.0, LIMIT_MPS)], False),
        (True, [(0.0, SLOW), (9.0, SLOW)], True),
        (True, [(0.0, BETWEEN), (9.0, BETWEEN)], True),
        (True, [(0.0, FAST)], True),
        (True, [(0.0, FAST), (0.5, FAST)], True),
        (True, [(0.0, FAST), (1.1, FAST)], False),
        (True, [(0.0, FAST), (0.8, SLOW), (0.9, FAST), (1.5, FAST)], True),
        (True, [(0.0, FAST), (0.8, BETWEEN), (0.9, FAST), (1.5, FAST)], True),
        (False, [(0.0, SLOW), (1.1, SLOW), (1.2, FAST), (2.3, FAST)], False),
        (False, [(0.0, -SLOW), (1.1, -SLOW)], True),  # noise of a standing one
    ],
)
def test_a_vehicle_is_queued_by_speed_and_time(
    queued: bool, speeds: Sequence[tuple[float, float]], after: bool
) -> None:
    memory = _Memory(queued=queued)
    for t_s, speed in speeds:
        step(memory, speed, t_s, LIMIT_MPS)
    assert memory.queued is after
    assert memory.seen_s == speeds[-1][0]


def vehicles(
    rears: Sequence[float], speeds: Sequence[float] | None = None, sigma_m: float = 0.3
) -> RoadVehicles:
    """Return vehicles of 5 m in lane 1 by their rears' stations."""
    speeds = speeds or [0.0] * len(rears)
    tracks = fleet([(r + 2.5, -1.8) for r in rears], [(v, 0.0) for v in speeds])
    return assign(dataclasses.replace(tracks, sigma_m=np.full(len(rears), sigma_m)), ROAD)


@pytest.mark.parametrize(
    ("rears", "slow", "queued"),
    [
        ([], [], []),
        ([200], [1], [0]),  # a lone slow vehicle is no queue
        ([200, 208], [1, 1], [1, 1]),
        ([208, 200], [1, 1], [1, 1]),
        ([200, 259], [1, 1], [1, 1]),
        ([200, 261], [1, 1], [0, 0]),
        ([200, 230, 259], [1, 0, 1], [1, 0, 1]),
        ([120, 200, 208], [1, 1, 1], [0, 1, 1]),  # far behind the rest
        ([150, 200, 208], [1, 1, 1], [1, 1, 1]),
        ([200, 208, 300, 310], [1, 1, 1, 1], [1, 1, 1, 1]),  # two queues
        ([200, 208], [1, 0], [0, 0]),
        ([200, 208], [0, 0], [0, 0]),
    ],
)
def test_a_queue_takes_two(rears: list[float], slow: list[int], queued: list[int]) -> None:
    nobody = np.zeros(len(rears), np.bool_)
    found = with_companions(vehicles(rears), np.array(slow, np.bool_), nobody)
    assert found.astype(int).tolist() == queued


def test_two_parts_of_one_vehicle_are_no_queue_and_two_side_by_side_are() -> None:
    slow, nobody = np.ones(2, np.bool_), np.zeros(2, np.bool_)
    close = vehicles([200.0, 203.0])
    assert not with_companions(close, slow, nobody).any()
    beside = dataclasses.replace(close, lane=np.array([1, 2]))
    assert with_companions(beside, slow, nobody).all()


class Watched:
    """A watch and its clock."""

    def __init__(self) -> None:
        self.watch = QueueWatch(LIMIT_MPS)
        self.t_s = 0.0

    def see(
        self,
        seen: RoadVehicles,
        seconds: float = 0.1,
        spans: dict[int, tuple[float, float]] | None = None,
        sigma: PoseSigma | None = None,
    ) -> tuple[RoadVehicles, QueueState]:
        spans = {0: SPAN} if spans is None else spans
        raster = RoadRaster(np.zeros((1, 1), np.uint8), 5.0, (), 1, ROAD, spans)
        mapping = dataclasses.replace(MAPPING, pose_sigma=sigma or PoseSigma())
        for _ in range(max(round(seconds / 0.1), 1)):
            marked, (state,) = self.watch.update(seen, ROAD, Scene(self.t_s, raster, mapping))
            self.t_s += 0.1
        return marked, state


QUEUE = [250.0, 258.0, 266.0, 274.0]


def test_an_empty_road_is_clear_and_free_traffic_is_too() -> None:
    watched = Watched()
    _, first = watched.see(vehicles([]), 0.8)
    assert first.status is QueueStatus.UNKNOWN
    assert "watched" in first.reasons[0]
    assert watched.see(vehicles([]), 0.5)[1].status is QueueStatus.CLEAR
    _, state = watched.see(vehicles([150, 200, 250], [28, 28, 28]), 5.0)
    assert state.status is QueueStatus.CLEAR
    assert state.eoq is None


def test_a_queue_forms_within_two_seconds_and_tells_its_end() -> None:
    watched = Watched()
    assert watched.see(vehicles(QUEUE))[1].status is QueueStatus.UNKNOWN
    marked, state = watched.see(vehicles(QUEUE), 1.9)
    assert state.status is QueueStatus.QUEUED
    assert state.eoq is not None
    assert state.eoq.station_m == pytest.approx(250.0)
    assert state.eoq.length_m == pytest.approx(29.0)
    assert state.eoq.vehicles == 4
    assert state.eoq.lat_deg is not None
    assert marked.queued.all()


def test_a_lone_slow_vehicle_and_free_ones_are_no_queue() -> None:
    watched = Watched()
    marked, state = watched.see(vehicles([150, 250, 300], [28, 2, 28]), 10.0)
    assert state.status is QueueStatus.CLEAR
    assert not marked.queued.any()


@pytest.mark.parametrize(
    ("before_mps", "after_mps", "station_m", "queues"),
    [
        (28.0, 4.0, SPAN[1] - 10, True),  # for one that the picture does not show any more
        (28.0, 4.0, SPAN[1] - 20, False),  # there is nobody ahead
        (12.0, 4.0, SPAN[1] - 10, False),  # a tractor
        (28.0, 0.0, SPAN[1] - 6, True),
        (28.0, 0.0, SPAN[1] - 12, False),  # the first at a stop line
    ],
)
def test_who_brakes_where_the_picture_ends_follows_one_beyond(
    before_mps: float, after_mps: float, station_m: float, queues: bool
) -> None:
    watched = Watched()
    watched.see(vehicles([station_m - 30], [before_mps]), 2.0)
    marked, state = watched.see(vehicles([station_m], [after_mps]), 2.0)
    assert state.status is (QueueStatus.QUEUED if queues else QueueStatus.CLEAR)
    assert marked.queued.any() == queues
    if queues:
        assert state.eoq is not None
        assert state.eoq.station_m == pytest.approx(station_m)


def test_nobody_is_supposed_beyond_the_end_of_the_road() -> None:
    watched, end = Watched(), (100.0, 599.0)
    watched.see(vehicles([560.0], [28.0]), 2.0, {0: end})
    assert watched.see(vehicles([592.0], [0.0]), 9.0, {0: end})[1].status is QueueStatus.CLEAR


def test_tentative_vehicles_do_not_queue() -> None:
    watched = Watched()
    seen = vehicles(QUEUE)
    doubted = dataclasses.replace(
        seen, tracks=dataclasses.replace(seen.tracks, states=(TrackState.TENTATIVE,) * 4)
    )
    assert watched.see(doubted, 5.0)[1].status is QueueStatus.CLEAR


def test_one_bad_frame_does_not_clear_and_dissolving_takes_no_two_seconds() -> None:
    watched = Watched()
    watched.see(vehicles(QUEUE), 3.0)
    assert watched.see(vehicles([]))[1].status is QueueStatus.QUEUED
    assert watched.see(vehicles(QUEUE))[1].status is QueueStatus.QUEUED
    _, state = watched.see(vehicles(QUEUE, [20.0] * 4), 2.0)
    assert state.status is QueueStatus.CLEAR
    assert state.eoq is None


def test_a_queue_that_runs_out_of_the_picture_is_beyond_view() -> None:
    watched = Watched()
    _, state = watched.see(vehicles([SPAN[0] + 1, 110, 118]), 3.0)
    assert state.status is QueueStatus.BEYOND_VIEW
    assert state.eoq is not None
    _, state = watched.see(vehicles([SPAN[0] + 100, 210, 218]), 3.0)
    assert state.status is QueueStatus.QUEUED


def test_an_approach_out_of_the_picture_is_unknown_with_the_reason_never_clear() -> None:
    watched = Watched()
    watched.see(vehicles(QUEUE), 3.0)
    _, state = watched.see(vehicles([]), spans={})
    assert state.status is QueueStatus.UNKNOWN
    assert state.eoq is None
    assert "not in the picture" in state.reasons[0]


@pytest.mark.parametrize("rate", [-2.0, 0.0, 3.0])
def test_growth_is_positive_while_the_end_moves_upstream(rate: float) -> None:
    growth = Growth()
    found = [growth.update(0.1 * n, 300.0 - rate * 0.1 * n) for n in range(60)]
    assert found[5] is None
    assert found[-1] == pytest.approx(rate, abs=1e-6)
    assert growth.update(6.1, None) is None
    assert growth.update(6.2, 300.0) is None


def test_sigma_grows_with_the_vehicles_and_with_the_mappings() -> None:
    def sigma(track_m: float, misfit: float) -> float:
        pose_sigma = PoseSigma(horizontal_m=1.5 * misfit, yaw_deg=misfit, pitch_deg=0.5 * misfit)
        _, state = Watched().see(vehicles(QUEUE, None, track_m), 3.0, sigma=pose_sigma)
        assert state.eoq is not None
        return state.eoq.sigma_m

    assert sigma(0.3, 0.0) < sigma(2.0, 0.0)
    assert sigma(0.3, 0.0) < sigma(0.3, 0.3) < sigma(0.3, 1.0)
    assert sigma(0.0, 0.0) > 0.2  # never sure to the centimetre


def test_two_sigma_reach_to_who_is_about_to_join_or_to_stay_last() -> None:
    def sigma(speeds: list[float], seconds: float = 0.1) -> float:
        watched = Watched()
        standing = [FAST, 0.0, 0.0, 0.0, 0.0]
        watched.see(vehicles([230.0, *QUEUE], standing), 3.0)
        _, state = watched.see(vehicles([230.0, *QUEUE], speeds), seconds)
        assert state.eoq is not None
        assert state.eoq.station_m == pytest.approx(QUEUE[0])
        return state.eoq.sigma_m

    settled = sigma([FAST, 0.0, 0.0, 0.0, 0.0])
    assert settled < 3.0
    assert sigma([BETWEEN, 0.0, 0.0, 0.0, 0.0]) == pytest.approx(np.hypot(settled, 10.0), rel=0.01)
    assert sigma([FAST, FAST, 0.0, 0.0, 0.0]) == pytest.approx(np.hypot(settled, 4.0), rel=0.05)


def test_what_is_not_seen_does_not_become_queued() -> None:
    coasting = vehicles(QUEUE)
    states = (TrackState.COASTING,) * len(QUEUE)
    coasting = dataclasses.replace(
        coasting, tracks=dataclasses.replace(coasting.tracks, states=states)
    )
    watched = Watched()
    assert watched.see(coasting, 5.0)[1].status is QueueStatus.CLEAR
    watched.see(vehicles(QUEUE), 3.0)
    assert watched.see(coasting, 5.0)[1].status is QueueStatus.QUEUED
