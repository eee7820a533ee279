"""Advice: from answers to signs, by scenes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from queuetail.geo.earth import geodetic_from_enu
from queuetail.signs.advice import Adviser, Answers
from queuetail.signs.records import Decision, Fit, SignState
from queuetail.signs.settings import SignSite, SignsSettings
from queuetail.types import Approach, EndOfQueue, Origin, QueueState, QueueStatus

ORIGIN = Origin(36.11, -97.057)
ROAD = Approach("NB", np.array([[0.0, 0.0], [3000.0, 0.0]]), 0.0, 2, 3.6)
TWO_PHASES = (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))
CAUTION = (("BE", "PREPARED", "TO STOP"),)
AHEAD = (("STOPPED", "TRAFFIC", "AHEAD"), ("PREPARE", "TO STOP"))
WORK = (("ROAD", "WORK", "AHEAD"),)


def queue(
    station_m: float, sigma_m: float = 1.0, growth: float | None = 0.0, beyond: bool = False
) -> QueueState:
    enu = (station_m, -3.0)
    lat, lon = geodetic_from_enu(np.array([enu]), ORIGIN)
    eoq = EndOfQueue(
        station_m, sigma_m, enu, (0, 0), float(lat[0]), float(lon[0]), 1, 50.0, 6, growth
    )
    return QueueState("NB", QueueStatus.BEYOND_VIEW if beyond else QueueStatus.QUEUED, eoq)


CLEAR = QueueState("NB", QueueStatus.CLEAR)
UNKNOWN = QueueState("NB", QueueStatus.UNKNOWN, None, ("the stream is lost",))


class Scene:
    """Signs, and a clock that goes on by tenths of seconds."""

    def __init__(self, *signs: SignSite, **settings: float) -> None:
        self.settings = SignsSettings.model_validate(settings)
        self.adviser = Adviser(self.settings, signs or (sign(),), 65.0)
        self.now_s = 1000.0
        self.road = ROAD

    def all(self, state: QueueState | None, seconds: float = 0.1) -> tuple[Decision, ...]:
        for _ in range(max(round(seconds * 10), 1)):
            self.now_s += 0.1
            answers = state and Answers((state,), (self.road,), ORIGIN, self.now_s)
            decisions = self.adviser.advise(answers, self.now_s)
        return decisions

    def see(self, state: QueueState | None, seconds: float = 0.1) -> Decision:
        return self.all(state, seconds)[0]


def sign(name: str = "PCMS 1", station_m: float = 0.0, **more: object) -> SignSite:
    return SignSite.model_validate({"name": name, "station_m": station_m, **more})


def test_a_queue_forms_grows_over_the_sign_and_dissolves() -> None:
    scene = Scene()
    assert scene.see(CLEAR, 4.0).state is SignState.CLEAR
    first = scene.see(queue(900.0), 1.0)
    assert (first.state, first.phases) == (SignState.WARNING, TWO_PHASES)
    assert first.shown_m == pytest.approx(804.7, abs=0.1)
    assert "the queue ends at station 900" in first.reasons[0]
    shown = []
    for station_m in range(900, -100, -10):
        decision = scene.see(queue(float(station_m), growth=5.0), 2.0)
        if decision.changed or not shown or decision.phases != shown[-1].phases:
            shown.append(decision)
    told = [d.phases[0][-1] for d in shown]
    assert told == ["1/2 MILE", "1/4 MILE", "1000 FT", "500 FT", "AHEAD"]
    assert decision.state is SignState.PASSED
    assert decision.placement is not None
    assert decision.placement.move_m > 400
    waiting = scene.see(CLEAR, 9.0)
    assert waiting.state is SignState.PASSED
    assert waiting.reasons[-1] == "waiting until clear has lasted"
    assert scene.see(CLEAR, 2.0).phases == ()


def test_the_sigma_moves_the_warning_upstream() -> None:
    assert Scene().see(queue(900.0, 1.0), 1.0).shown_m == pytest.approx(804.7, abs=0.1)
    unsure = Scene().see(queue(900.0, 60.0), 1.0)
    assert unsure.shown_m == pytest.approx(402.3, abs=0.1)
    assert unsure.distance_m == pytest.approx(780.0)
    assert Scene().see(queue(100.0, 60.0), 1.0).state is SignState.PASSED
    assert Scene(sigma_factor=0.0).see(queue(900.0, 60.0), 1.0).distance_m == pytest.approx(900)


def test_growth_brings_the_end_nearer_to_who_drives_there() -> None:
    still = Scene().see(queue(900.0), 20.0)
    growing = Scene().see(queue(900.0, growth=4.0), 20.0)
    assert still.distance_m is not None
    assert growing.distance_m is not None
    assert growing.distance_m == pytest.approx(898 * 29.06 / (29.06 + 4.0), abs=5.0)
    assert growing.passes_in_s == pytest.approx(900 / 4.0, rel=0.05)
    assert still.passes_in_s is None
    shrinking = Scene().see(queue(900.0, growth=-4.0), 20.0)
    assert shrinking.distance_m == pytest.approx(still.distance_m)


def test_beyond_view_warns_without_a_distance_at_least_as_far_as_the_bound() -> None:
    near, far, downstream = sign("near", 800.0), sign("far", -9000.0), sign("inside", 1200.0)
    scene = Scene(near, far, downstream)
    decisions = scene.all(queue(1000.0, beyond=True), 1.0)
    assert [d.state for d in decisions] == [SignState.AHEAD, SignState.AHEAD, SignState.PASSED]
    assert {d.phases for d in decisions} == {AHEAD}
    assert decisions[1].placement is None  # nobody knows how far the queue reaches
    assert [d.state for d in Scene(near, far).all(queue(1000.0), 4.0)] == [
        SignState.WARNING,
        SignState.CLEAR,
    ]


def test_unknown_holds_a_cautious_message_then_falls_back_and_never_keeps_a_distance() -> None:
    scene = Scene(sign(default=WORK))
    assert scene.see(None).phases == WORK
    assert scene.see(queue(900.0), 1.0).phases == TWO_PHASES
    assert scene.see(UNKNOWN, 1.9).phases == TWO_PHASES  # a moment's loss is no loss
    lost = scene.see(UNKNOWN, 0.3)
    assert (lost.state, lost.phases) == (SignState.CAUTION, CAUTION)
    assert "the stream is lost" in lost.reasons
    assert scene.see(UNKNOWN, 59.0).phases == CAUTION
    assert scene.see(UNKNOWN, 2.0).phases == WORK
    assert scene.see(UNKNOWN, 300.0).state is SignState.DEFAULT
    assert scene.see(queue(900.0), 1.0).phases == TWO_PHASES


@pytest.mark.parametrize("state", [CLEAR, queue(900.0), queue(50.0), queue(-50.0)])
def test_answers_that_end_are_as_good_as_unknown(state: QueueState) -> None:
    scene = Scene()
    scene.see(state, 5.0)
    decision = scene.see(None, 2.2)
    assert decision.state is SignState.CAUTION
    assert decision.distance_m is None
    assert "2 s old" in decision.reasons[0]
    assert scene.see(None, 60.0).state is SignState.DEFAULT


def test_a_lost_stream_without_any_road_does_not_hide_how_old_the_answer_is() -> None:
    scene = Scene()
    scene.see(queue(900.0), 1.0)
    scene.now_s += 2.1
    nothing = Answers((QueueState("", QueueStatus.UNKNOWN),), (), None, scene.now_s)
    assert scene.adviser.advise(nothing, scene.now_s)[0].state is SignState.CAUTION
    assert scene.adviser.advise(nothing, scene.now_s + 60.1)[0].state is SignState.DEFAULT


def test_an_answer_that_comes_late_is_old_when_it_comes() -> None:
    scene = Scene()
    answers = Answers((queue(900.0),), (ROAD,), ORIGIN, 990.0)
    for now_s in (1000.0, 1001.0, 1002.0):
        assert scene.adviser.advise(answers, now_s)[0].state is SignState.DEFAULT


def test_a_flickering_answer_does_not_make_the_sign_flicker() -> None:
    scene = Scene()
    scene.see(CLEAR, 4.0)
    texts = []
    for n in range(600):
        state = (queue(813.0 + 9 * (n % 3 - 1)), CLEAR, UNKNOWN, queue(820.0))[n % 4]
        decision = scene.see(state)
        if decision.changed:
            texts.append((scene.now_s, decision.phases))
    assert len(texts) <= 3  # in a minute
    assert decision.state is SignState.WARNING


def test_a_short_loss_does_not_blank_or_change_a_clear_sign() -> None:
    scene = Scene()
    scene.see(CLEAR, 5.0)
    assert not any(scene.see(s).changed for s in [UNKNOWN] * 15 + [CLEAR] * 20)


def test_a_queue_out_of_reach_does_not_matter() -> None:
    scene = Scene(reach_m=1000.0)
    scene.see(CLEAR, 4.0)
    decision = scene.see(queue(1200.0), 5.0)
    assert decision.state is SignState.CLEAR
    assert "reach_m" in decision.reasons[1]
    assert scene.see(queue(990.0), 1.0).state is SignState.WARNING


@pytest.mark.parametrize(
    ("station_m", "fit", "goal_m"),
    [
        (600.0, Fit.TOO_CLOSE, 460.0),  # 998 − 1.25 · 429, rounded upstream
        (300.0, Fit.OK, None),
        (-400.0, Fit.OK, None),
        (-900.0, Fit.TOO_FAR, 460.0),
    ],
)
def test_a_portable_sign_is_told_where_to_stand(
    station_m: float, fit: Fit, goal_m: float | None
) -> None:
    decision = Scene(sign(station_m=station_m)).see(queue(1000.0), 1.0)
    assert decision.placement is not None
    assert decision.placement.fit is fit
    assert decision.placement.move_to_station_m == goal_m
    if goal_m is not None:
        assert decision.placement.move_m == station_m - goal_m
        assert decision.placement.move_to_lat_deg == pytest.approx(ORIGIN.lat_deg, abs=1e-3)


@pytest.mark.parametrize(("watched_s", "room_m"), [(40, 100.0), (240, 300.0)])
def test_the_place_to_move_to_leaves_room_for_growth(watched_s: int, room_m: float) -> None:
    """0.5 m/s for the ten minutes of the move, or for five times as long as it was watched."""
    still = Scene(sign(station_m=900.0)).see(queue(1000.0), 40.0).placement
    scene = Scene(sign(station_m=900.0))
    for n in range(watched_s):
        end_m = 1000.0 + 0.5 * (watched_s - n)
        growing = scene.see(queue(end_m, growth=0.5), 1.0).placement
    assert still is not None
    assert growing is not None
    assert still.move_to_station_m is not None
    assert growing.move_to_station_m is not None
    moved_m = still.move_to_station_m - growing.move_to_station_m
    assert moved_m == pytest.approx(room_m, abs=0.12 * room_m + 10)
    fixed = Scene(sign(station_m=900.0, kind="fixed")).see(queue(1000.0), 1.0)
    assert fixed.placement is None


def test_a_jump_of_the_end_is_no_trend() -> None:
    scene = Scene(sign(station_m=900.0))
    before = scene.see(queue(1000.0), 60.0).placement
    after = scene.see(queue(970.0, growth=6.0), 2.0).placement
    assert before is not None
    assert after is not None
    assert before.move_to_station_m is not None
    assert after.move_to_station_m is not None
    assert before.move_to_station_m - after.move_to_station_m < 150


def test_a_sign_by_latitude_and_longitude_is_put_on_the_road() -> None:
    lat, lon = geodetic_from_enu(np.array([[100.0, -12.0]]), ORIGIN)
    at = SignSite.model_validate({"name": "A", "at": [float(lat[0]), float(lon[0])]})
    decision = Scene(at).see(queue(1000.0), 1.0)
    assert decision.distance_m == pytest.approx(898.0, abs=0.5)
    scene = Scene(at)
    nowhere = Answers((queue(1000.0),), (ROAD,), None, 1000.0)
    assert "no coordinates" in scene.adviser.advise(nowhere, 1000.0)[0].reasons[0]


def test_signs_of_two_approaches_follow_their_own() -> None:
    scene = Scene(sign("N", approach="NB"), sign("S", approach="SB"))
    other = dataclasses.replace(ROAD, name="SB")
    states = (queue(900.0), dataclasses.replace(CLEAR, approach="SB"))
    for n in range(40):
        now_s = 1000 + 0.1 * n
        both = scene.adviser.advise(Answers(states, (ROAD, other), ORIGIN, now_s), now_s)
    assert [d.state for d in both] == [SignState.WARNING, SignState.CLEAR]


def test_beacons_flash_while_there_is_something_to_warn_of() -> None:
    scene = Scene(sign(kind="beacon"))
    assert not scene.see(CLEAR, 4.0).beacon
    decision = scene.see(queue(900.0))
    assert decision.beacon
    assert decision.changed
    assert decision.phases == ()
    assert not scene.see(queue(400.0), 1.0).changed
    assert scene.see(UNKNOWN, 3.0).beacon
    assert not scene.see(UNKNOWN, 63.0).beacon


def test_metric_signs_tell_metres() -> None:
    scene = Scene()
    scene.adviser.settings = SignsSettings(units="metric")
    assert scene.see(queue(900.0), 1.0).phases[0][-1] == "800 M"
