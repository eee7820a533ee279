"""evaluate on fabricated runs: known shifts give exactly the expected figures."""

from __future__ import annotations

import dataclasses
import io
import json
from pathlib import Path

import numpy as np
import pytest
from fabricated import Bench, Car, Queue, driving_cars, queue_rows
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from rich.console import Console

from queuetail.errors import InputError
from queuetail.evaluate import evaluate, print_table, to_json, write_report

SITE = """
[[approach]]
name = "east"
lanes = 2
lane_width_m = 3.5
axis = [[36.11, -97.058], [36.11, -97.05]]
"""


def standing(t: float) -> tuple[str, float | None]:
    """A queue from 5 to 15 s whose end moves upstream at 1 m/s."""
    return ("queued", 500.0 - t) if 5 <= t <= 15 else ("clear", None)


def test_the_truth_itself_is_perfect(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars())
    e = evaluate(bench.run(queue_rows(standing, sigma_m=0.5), driving_cars()), truth)
    assert e.approach.name == "east"
    assert e.strict.samples == 101
    assert e.strict.max_m == pytest.approx(0, abs=1e-3)
    assert e.eoq_left_bias_m == pytest.approx(-1.75, abs=1e-3)
    assert e.answers.missed_strict == e.answers.false_strict == 0.0
    assert e.strict.inside_1_sigma == 1.0
    assert (e.episodes.onset_worst_s, e.episodes.dissolve_worst_s) == (0.0, 0.0)
    v = e.vehicles
    assert (v.recall, v.precision, v.idf1) == (1.0, 1.0, 1.0)
    assert v.hota == pytest.approx(1.0, abs=1e-3)
    assert v.speed_rmse_mps == 0.0


@example(shift_m=0.0, late=7, sigma_m=1.0)
@example(shift_m=0.0, late=15, sigma_m=1.0)
@settings(
    max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    shift_m=st.floats(-40, 40).map(lambda x: round(x, 2)),
    late=st.integers(0, 15),
    sigma_m=st.floats(0.1, 20).map(lambda x: round(x, 2)),
)
def test_shifted_and_late(bench: Bench, shift_m: float, late: int, sigma_m: float) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(0.5))
    delay_s = late / 10

    def run(t: float) -> tuple[str, float | None]:
        status, station = standing(round(t - delay_s, 3))
        return status, None if station is None else station + shift_m

    e = evaluate(bench.run(queue_rows(run, sigma_m=sigma_m), driving_cars(0.5)), truth)
    # the end moves upstream at 1 m/s: being late by d puts the run d metres downstream
    expected = abs(shift_m + delay_s)
    assert e.strict.bias_m == pytest.approx(shift_m + delay_s, abs=2e-3)
    assert e.strict.max_m == pytest.approx(expected, abs=2e-3)
    assert e.episodes.onset_worst_s == pytest.approx(delay_s)
    assert e.episodes.dissolve_worst_s == pytest.approx(delay_s)
    assert e.answers.missed_strict == pytest.approx(late / 101)
    assert e.answers.missed_tolerant == 0.0
    assert e.answers.false_strict == pytest.approx(late / 100)
    assert e.answers.false_tolerant == 0.0
    if abs(expected - sigma_m) > 0.01:
        assert e.strict.inside_1_sigma == float(expected < sigma_m)
    assert e.tolerant.samples == e.strict.samples
    if shift_m == 0:  # only late, within the window
        assert e.tolerant.max_m == pytest.approx(0, abs=2e-3)


def test_silence_is_missed_and_never_clear(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars())
    rows = [
        dataclasses.replace(q, status="unknown", station_m=None) if 7 <= q.t_s < 8 else q
        for q in queue_rows(standing)
        if not 10 < q.t_s < 12
    ]
    e = evaluate(bench.run(rows, driving_cars()), truth)
    # 10.3 … 11.7 s are farther than 0.25 s from any row: 15 samples
    assert e.answers.no_answer == pytest.approx(15 / 201)
    assert e.answers.unknown == pytest.approx(10 / 201)
    assert e.answers.missed_strict == pytest.approx(25 / 101)
    assert e.answers.queue_in_view.clear == 0.0
    assert e.episodes.false == 0


def test_end_out_of_view(bench: Bench) -> None:
    truth = bench.truth(
        [dataclasses.replace(q, in_view=int(q.t_s < 10)) for q in queue_rows(standing)],
        [Car(c.t_s, c.name, c.station_m + 250) for c in driving_cars()],
    )

    def run(t: float) -> tuple[str, float | None]:
        status, station = standing(t)
        return ("beyond_view" if station and t >= 10 else status), station

    e = evaluate(bench.run(queue_rows(run), []), truth)
    assert e.answers.queue_beyond_view.samples == 51
    assert e.answers.queue_beyond_view.beyond_view == 1.0
    assert e.strict.samples == 50
    assert e.answers.missed_strict == e.answers.false_strict == 0.0
    assert e.episodes.onset_worst_s == 0.0


def test_a_queue_that_nobody_could_see_is_not_judged(bench: Bench) -> None:
    upstream = [Car(c.t_s, c.name, 100.0) for c in driving_cars() if c.name == "v0"]
    rows = [dataclasses.replace(q, in_view=0) for q in queue_rows(standing)]
    e = evaluate(bench.run(queue_rows(lambda t: ("clear", None)), []), bench.truth(rows, upstream))
    assert e.answers.queue_in_view.samples == e.answers.queue_beyond_view.samples == 0
    assert e.answers.no_queue.samples == 100
    assert e.episodes.episodes == ()


def test_shifted_vehicles(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(5), SITE)
    cars = [
        dataclasses.replace(c, station_m=c.station_m + 1.5, speed_mps=c.speed_mps - 1)
        for c in driving_cars(5)
        if c.name != "v2"
    ]
    v = evaluate(bench.run(queue_rows(standing), cars), truth).vehicles
    assert v.recall == pytest.approx(2 / 3)
    assert v.precision == 1.0
    assert v.geolocation_median_m == pytest.approx(1.5, abs=2e-3)
    assert v.along_bias_m == pytest.approx(1.5, abs=2e-3)
    assert v.speed_bias_mps == pytest.approx(-1.0)
    assert v.det_a == pytest.approx(2 / 3 * 10 / 19, abs=0.04)  # similarity 0.5


def test_truth_is_interpolated_to_the_frames(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars())
    times = np.round(np.arange(0.04, 19.9, 0.1), 3)
    rows = [Queue(float(t), *standing(float(t))) for t in times]
    cars = [Car(float(t), "a", 300 + 10 * float(t), speed_mps=10.0) for t in times]
    v = evaluate(bench.run(rows, cars), truth).vehicles
    assert v.geolocation_median_m == pytest.approx(0, abs=2e-3)


@pytest.mark.parametrize("site", [None, SITE])
def test_the_opposite_carriageway_is_not_taken_and_not_false(
    bench: Bench, site: str | None
) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(), site)
    opposite = [
        Car(c.t_s, f"w{c.name}", 900 - c.station_m, 8.0, 10.0, "west") for c in driving_cars()
    ]
    rows = [
        *queue_rows(lambda t: ("queued", 300.0), approach="west"),
        *queue_rows(standing, approach="north-east"),
    ]
    ours = [dataclasses.replace(c, approach="north-east") for c in driving_cars()]
    e = evaluate(bench.run(rows, [*ours, *opposite]), truth)
    assert e.approach.name == "north-east"
    assert e.approach.others == ("west",)
    assert e.strict.max_m == pytest.approx(0, abs=1e-3)
    assert (e.vehicles.recall, e.vehicles.precision) == (1.0, 1.0)
    alone = evaluate(bench.run(rows[:201], opposite), truth)
    assert alone.approach.name is None
    assert alone.answers.no_answer == 1.0
    assert alone.answers.missed_strict == 1.0


def test_the_name_of_the_truths_approach_decides(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(), SITE)
    rows = [*queue_rows(standing), *queue_rows(lambda t: ("clear", None), approach="ramp")]
    e = evaluate(bench.run(rows, driving_cars()), truth)
    assert (e.approach.name, e.approach.others) == ("east", ("ramp",))
    assert "name" in e.approach.why


def test_no_road_found_is_unknown_throughout(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars())
    rows = queue_rows(lambda t: ("unknown", None), approach="")
    e = evaluate(bench.run(rows, []), truth)
    assert e.answers.unknown == 1.0
    assert e.answers.missed_strict == 1.0
    assert e.vehicles.recall == 0.0
    assert e.vehicles.precision is None


def test_an_empty_road(bench: Bench) -> None:
    truth = bench.truth(queue_rows(lambda t: ("clear", None)), [])
    e = evaluate(bench.run(queue_rows(lambda t: ("clear", None)), []), truth)
    assert e.answers.false_strict == 0.0
    assert e.answers.missed_strict is None
    assert (e.vehicles.instants, e.vehicles.recall, e.vehicles.precision) == (0, None, None)


def test_part_of_the_flight(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars())
    e = evaluate(bench.run(queue_rows(standing, 10.0), driving_cars(10.0)), truth)
    assert e.span.truth_covered == pytest.approx(101 / 201)
    assert e.answers.missed_strict == 0.0
    assert e.vehicles.recall == 1.0


def test_without_positions_only_the_same_axis_will_do(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(), SITE)
    approach = {
        "name": "east", "lanes": 2, "lane_width_m": 3.5, "start_station_m": 0.0,
        "axis": [[36.11, -97.058], [36.11, -97.05]], "axis_enu_m": None,
    }  # fmt: skip
    about = {"settings": {"approach": [approach]}}
    run = bench.run(queue_rows(standing), driving_cars(), about, located=False)
    e = evaluate(run, truth)
    assert e.strict.max_m == pytest.approx(0, abs=1e-3)
    assert e.vehicles.recall == 1.0
    other = bench.run(queue_rows(standing), driving_cars(), located=False)
    with pytest.raises(InputError, match="no latitudes and longitudes"):
        evaluate(other, truth)


def test_another_flight(bench: Bench) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(1))
    far = queue_rows(lambda t: ("queued", 30_000.0))
    with pytest.raises(InputError, match=r"28\.9 km .* different flights"):
        evaluate(bench.run(far, []), truth)
    later = [dataclasses.replace(q, t_s=q.t_s + 100) for q in queue_rows(standing)]
    with pytest.raises(InputError, match="no time in common"):
        evaluate(bench.run(later, []), truth)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("queue.csv", None, "there is no such file"),
        ("queue.csv", "", "line 1 lacks the column 'approach'"),
        ("queue.csv", b"\xff\xfe\x00", "not a CSV file"),
        ("tracks.csv", "t_s,lat\n1,2\n", "line 1 lacks the column 'track_id'"),
        ("run.json", "{", "not valid JSON"),
        ("run.json", "[]", "not a JSON object"),
    ],
)
def test_broken_run(bench: Bench, name: str, text: str | bytes | None, message: str) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(1))
    run = bench.run(queue_rows(standing), driving_cars(1))
    if text is None:
        (run / name).unlink()
    else:
        (run / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(InputError, match=message):
        evaluate(run, truth)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("queue.csv", "0.100,east,clear", "0.100,east,free", "status is 'free'"),
        ("queue.csv", "0.100,east", "x,east", "line 3: t_s is 'x', not a number"),
        ("queue.csv", "0.100,east", "nan,east", "line 3: t_s is 'nan', not a finite number"),
        ("queue.csv", "0.100,east,clear,,,", "0.100,east,clear", "line 3 has 9 cells, not 12"),
        ("tracks.csv", "0.100,v1", "0.100,v0", "track v0 is in two places at 0.1 s"),
    ],
)
def test_garbled_run(bench: Bench, name: str, old: str, new: str, message: str) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(1))
    run = bench.run(queue_rows(standing), driving_cars(1))
    text = (run / name).read_text()
    assert old in text
    (run / name).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        evaluate(run, truth)


def test_broken_truth(bench: Bench, tmp_path: Path) -> None:
    run = bench.run(queue_rows(standing), driving_cars(1))
    truth = bench.truth(queue_rows(standing), driving_cars(1))
    with pytest.raises(InputError, match="does not exist"):
        evaluate(run, tmp_path / "nowhere")
    with pytest.raises(InputError, match="is not a folder"):
        evaluate(run / "queue.csv", truth)
    road = (truth / "road.csv").read_text().splitlines()
    (truth / "road.csv").write_text("\n".join([road[0], road[2], road[1]]))
    with pytest.raises(InputError, match="must increase"):
        evaluate(run, truth)
    (truth / "road.csv").write_text("\n".join(road[:2]))
    with pytest.raises(InputError, match="two points"):
        evaluate(run, truth)
    (truth / "truth.csv").write_text((truth / "truth.csv").read_text().splitlines()[0])
    with pytest.raises(InputError, match="has no rows"):
        evaluate(run, truth)


def test_outputs(bench: Bench, tmp_path: Path) -> None:
    truth = bench.truth(queue_rows(standing), driving_cars(2))
    for rows in (queue_rows(standing, sigma_m=1.0), [Queue(0.0, "unknown", approach="")]):
        e = evaluate(bench.run(rows, driving_cars(2) if len(rows) > 1 else []), truth)
        record = json.loads(json.dumps(to_json(e), allow_nan=False))
        assert record["strict"]["samples"] == e.strict.samples
        assert "timeline" not in record
        screen = io.StringIO()
        print_table(e, Console(file=screen, width=100))
        assert "error, 95th percentile" in screen.getvalue()
        write_report(e, tmp_path / "evaluation.html")
        page = (tmp_path / "evaluation.html").read_text()
        assert page.count("<svg") == 2
        assert "error, 95th percentile" in page
        assert "http://" not in page.replace("http://www.w3.org", "").replace(
            "http://purl.org", ""
        ).replace("http://creativecommons.org", "")


def test_the_bundled_flight_against_itself(flagger: Path, tmp_path: Path) -> None:
    """Stations of truth.csv and vehicles.csv are those that road.csv gives for their places."""
    run = tmp_path / "run"
    run.mkdir()
    truth = np.genfromtxt(flagger / "truth.csv", delimiter=",", names=True)
    lines = [
        f"{r['t_s']:.3f},main,queued,{r['eoq_lat']:.8f},{r['eoq_lon']:.8f},0,1,,,,,"
        if np.isfinite(r["eoq_station_m"])
        else f"{r['t_s']:.3f},main,clear,,,,,,,,,"
        for r in truth
    ]
    header = "t_s,approach,status,eoq_lat,eoq_lon,eoq_station_m,eoq_sigma_m,a,b,c,d,e"
    (run / "queue.csv").write_text("\n".join([header, *lines]))
    header, *rows = (flagger / "vehicles.csv").read_text().splitlines()
    tracks = [header.replace("vehicle_id", "track_id") + ",approach", *(f"{r},main" for r in rows)]
    (run / "tracks.csv").write_text("\n".join(tracks))
    e = evaluate(run, flagger)
    assert e.strict.max_m is not None
    assert e.strict.max_m < 0.02
    assert e.vehicles.recall == e.vehicles.precision == 1.0
    assert e.vehicles.geolocation_p95_m is not None
    assert e.vehicles.geolocation_p95_m < 0.02
