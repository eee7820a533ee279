"""Vehicle figures on tiny cases worked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from queuetail.evaluate.vehicles import Seen, interpolate, judge_vehicles, near_edge, pair_up

Row = tuple[int, int, float, float, bool]  # instant, vehicle, station, speed, optional


def seen(*rows: Row) -> Seen:
    """Vehicles on an axis that runs east: station is east, offset north."""
    instant, vehicle, station, speed, optional = (
        (np.array(column) for column in zip(*rows, strict=True))
        if rows
        else (np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0), np.zeros(0, bool))
    )
    place = np.column_stack([station, np.zeros(len(station))])
    return Seen(instant, vehicle, place, place, speed.astype(float), optional)


def judged(truth: Seen, run: Seen, instants: int):  # type: ignore[no-untyped-def]
    return judge_vehicles(truth, run, pair_up(truth, run, instants, 3.0), 3.0)


def test_figures_by_hand() -> None:
    truth = seen(
        (0, 0, 100.0, 10.0, False), (0, 1, 150.0, 10.0, False),
        (1, 0, 110.0, 10.0, False), (1, 1, 160.0, 10.0, False),
    )  # fmt: skip
    run = seen(
        (0, 7, 101.0, 11.0, False),  # + 1 m, + 1 m/s
        (1, 7, 112.0, 13.0, False), (1, 8, 164.0, 10.0, False),  # + 2 m, + 3 m/s; 4 m is too far
    )  # fmt: skip
    figures = judged(truth, run, 2)
    assert figures.recall == 2 / 4
    assert figures.precision == 2 / 3
    assert figures.pairs == 2
    assert figures.geolocation_median_m == pytest.approx(1.5)
    assert figures.along_bias_m == pytest.approx(1.5)
    assert figures.left_bias_m == 0.0
    assert figures.speed_bias_mps == pytest.approx(2.0)
    assert figures.speed_rmse_mps == pytest.approx(np.sqrt((1 + 9) / 2))
    assert figures.idf1 == pytest.approx(2 * 2 / (4 + 3))
    assert figures.mota == pytest.approx(1 - (2 + 1) / 4)
    assert (figures.truth_vehicles, figures.run_tracks) == (2, 2)


def test_identity_switch() -> None:
    truth = seen(*((i, 0, 100.0, 0.0, False) for i in range(4)))
    run = seen(*((i, i // 2, 100.0, 0.0, False) for i in range(4)))
    figures = judged(truth, run, 4)
    assert (figures.recall, figures.precision, figures.id_switches) == (1.0, 1.0, 1)
    assert figures.idf1 == pytest.approx(0.5)
    assert figures.hota == pytest.approx(np.sqrt(0.5))


def test_what_may_but_need_not_be_found() -> None:
    truth = seen((0, 0, 100.0, 0.0, False), (0, 1, 10.0, 0.0, True), (0, 2, 20.0, 0.0, True))
    run = seen(
        (0, 0, 100.0, 0.0, True),  # near the edge by its own place, but it is the truth's: counts
        (0, 1, 10.5, 0.0, False),  # finds what need not be found: neither right nor false
        (0, 2, 500.0, 0.0, True),  # on another road: not false
        (0, 3, 300.0, 0.0, False),  # false
    )
    figures = judged(truth, run, 1)
    assert figures.recall == 1.0
    assert figures.precision == 1 / 2


def test_nobody_there() -> None:
    figures = judged(seen(), seen(), 3)
    assert figures.recall is None
    assert figures.hota is None
    assert figures.geolocation_median_m is None
    only_false = judged(seen(), seen((0, 0, 1.0, 0.0, False)), 3)
    assert (only_false.recall, only_false.precision, only_false.hota) == (None, 0.0, 0.0)
    only_missed = judged(seen((0, 0, 1.0, 0.0, False)), seen(), 3)
    assert (only_missed.recall, only_missed.precision) == (0.0, None)


def test_interpolation() -> None:
    t = np.array([0.0, 0.1, 0.2, 0.2, 0.3, 1.0])
    vehicle = np.array([0, 0, 0, 1, 1, 1])
    values = np.array([[0.0], [1.0], [2.0], [50.0], [60.0], [70.0]])
    instant, who, found = interpolate(t, vehicle, values, np.array([0.05, 0.2, 0.25, 0.6, 1.0]))
    assert list(zip(instant.tolist(), who.tolist(), strict=True)) == [
        (0, 0), (1, 0), (1, 1), (2, 1), (4, 1)
    ]  # fmt: skip
    np.testing.assert_allclose(found[:, 0], [0.5, 2.0, 50.0, 55.0, 70.0])
    assert interpolate(t[:0], vehicle[:0], values[:0], t)[0].tolist() == []


def test_near_edge() -> None:
    px = np.array([[500.0, 100.0], [10.0, 100.0], [500.0, 195.0], [-3.0, 50.0], [np.nan, 1.0]])
    assert near_edge(px, (1000, 200)).tolist() == [False, True, True, True, False]
    assert not near_edge(px, None).any()
