"""What feeds may tell of an answer: conservative places, no clear while unknown."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from feed_answers import CLEAR, LOST, START, answer, published, queue

from queuetail.feeds.answers import Reader, headline, iso
from queuetail.geo.earth import distance_m
from queuetail.types import QueueStatus


def test_the_posted_end_lies_upstream_of_the_measured_one() -> None:
    end = answer(queue(2000.0, sigma_m=4.0)).end
    assert end is not None
    assert (end.station_m, end.measured_m) == (1992.0, 2000.0)
    assert end.at is not None
    measured = answer(queue(2000.0, sigma_m=0.0)).end
    assert measured is not None
    assert measured.at is not None
    assert end.at[0] < measured.at[0]  # the road leads north
    assert distance_m(*end.at, *measured.at) == pytest.approx(8.0, abs=0.05)


def test_the_place_is_the_middle_of_the_carriageway_and_the_course_that_of_the_road() -> None:
    road = answer(queue()).road
    assert road is not None
    assert road.course_deg(2000.0) == pytest.approx(0.0)
    path = road.path(2000.0, 1000.0)
    assert len(path) == 21
    assert path[0][0] > path[-1][0]
    assert path[0][1] == pytest.approx(-97.05 + math.degrees(3.6 / 5_160_000), abs=1e-6)


@pytest.mark.parametrize("broken", [{"station_m": math.nan}, {"sigma_m": math.inf}])
def test_an_end_without_a_place_is_unknown(broken: dict[str, float]) -> None:
    state = queue()
    assert state.eoq is not None
    state = dataclasses.replace(state, eoq=dataclasses.replace(state.eoq, **broken))
    told = answer(state)
    assert told.status is QueueStatus.UNKNOWN
    assert "has no place" in headline(told)
    nothing = answer(dataclasses.replace(state, eoq=None))
    assert nothing.status is QueueStatus.UNKNOWN


def test_an_old_answer_is_unknown_and_says_how_old() -> None:
    told = answer(CLEAR, made_s=10.0)
    assert told.at_age(12.9, 3.0) is told
    old = told.at_age(14.0, 3.0)
    assert old.status is QueueStatus.UNKNOWN
    assert "no answer for 4 s" in headline(old)


def test_without_coordinates_there_is_a_station_and_no_place() -> None:
    told = Reader(2.0).read(published(queue(), is_placed=False))[0]
    assert told.has_queue
    assert not told.is_placed


def test_where_the_road_is_stays_known_while_nothing_is_seen() -> None:
    reader = Reader(2.0)
    reader.read(published(CLEAR))
    lost = reader.read(published(LOST, at_s=1.0))[0]
    assert lost.road is not None
    assert lost.status is QueueStatus.UNKNOWN


def test_a_frame_without_states_is_unknown() -> None:
    told = Reader(2.0).read(published())
    assert [a.status for a in told] == [QueueStatus.UNKNOWN]


def test_speeds_are_those_of_the_approach() -> None:
    seen = published(CLEAR)
    vehicles = dataclasses.replace(
        seen.observation.vehicles,
        approach=np.array([0, 0, -1]),
        speed_mps=np.array([10.0, 20.0, 99.0]),
    )
    seen = dataclasses.replace(
        seen, observation=dataclasses.replace(seen.observation, vehicles=vehicles)
    )
    told = Reader(2.0).read(seen)[0]
    assert (told.speed_mps, told.vehicles_seen) == (15.0, 2)


def test_words_and_times() -> None:
    assert headline(answer(CLEAR)) == "NB: no queue"
    assert headline(answer(LOST)) == "NB: end of queue unknown: no picture for 3.0 s"
    assert headline(answer(queue())) == "NB: stopped traffic, queue of 180 m (591 ft), 12 vehicles"
    beyond = answer(queue(status=QueueStatus.BEYOND_VIEW))
    assert "at least 180 m" in headline(beyond)
    assert iso(START) == "2026-05-14T15:30:00.000Z"
