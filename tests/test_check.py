"""The accuracy check: errors as by hand, offsets as they were hidden, speeds, the command."""

from __future__ import annotations

import csv
import dataclasses
import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from queuetail.accuracy.improve import Improvement, improve, shifted
from queuetail.accuracy.points import KnownPoint, measure
from queuetail.accuracy.speed import check_speed
from queuetail.accuracy.table import read_points, write_points
from queuetail.check import with_offsets
from queuetail.cli import main
from queuetail.config import Site, TelemetryFill, parse_settings, read_site
from queuetail.errors import InputError
from queuetail.flight import open_flight
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.live.feed import LiveFeed
from queuetail.mapping import corrected
from queuetail.site_editor import save, whole_text, with_table
from queuetail.types import CameraPose, Floats, Frame, GroundMapping, Origin, TelemetrySample
from queuetail.video.stream_session import Captured

ORIGIN = Origin(36.11, -97.057)
LENS = intrinsics_from_hfov(1280, 720, 84.0)
TRUE = CameraPose(36.11, -97.057, 110.0, 75.0, -55.0, 0.0, LENS)
SPREAD = [(100, 100), (1200, 120), (1180, 700), (90, 690), (640, 360), (640, 100), (300, 500)]
HIDDEN = (-3.0, 1.5, -6.0)  # heading, pitch, height


def haversine_by_hand_m(lat1: float, lon1: float, lat2: float, lon2: float) -> float:
    """The formula as Messenger et al. (2023) print it, in plain arithmetic."""
    a1, a2 = math.radians(lat1), math.radians(lat2)
    d = math.radians(lon2 - lon1)
    h = math.sin((a2 - a1) / 2) ** 2 + math.cos(a1) * math.cos(a2) * math.sin(d / 2) ** 2
    return 2 * 6_371_008.8 * math.asin(math.sqrt(h))


def known(
    px: list[tuple[int, int]], noise_m: float = 0.0, noise_px: float = 0.0
) -> list[KnownPoint]:
    """Points as the true pose sees them, with the care of a user."""
    rng = np.random.default_rng(5)
    enu = px_to_enu(mapping_from_pose(TRUE, ORIGIN), np.array(px, float))
    lat, lon = geodetic_from_enu(enu + rng.normal(0.0, noise_m, enu.shape), ORIGIN)
    clicks: Floats = np.array(px, float) + rng.normal(0.0, noise_px, (len(px), 2))
    return [
        KnownPoint(0.0, (float(u), float(v)), float(a), float(b))
        for (u, v), a, b in zip(clicks, lat, lon, strict=True)
    ]


def told(offsets: tuple[float, float, float] = HIDDEN, pitch_deg: float = -55.0) -> GroundMapping:
    """What telemetry says: the true pose less what is hidden."""
    pose = dataclasses.replace(
        TRUE,
        yaw_deg=TRUE.yaw_deg - offsets[0],
        pitch_deg=pitch_deg - offsets[1],
        height_agl_m=TRUE.height_agl_m - offsets[2],
    )
    return mapping_from_pose(pose, ORIGIN)


def improved(points: list[KnownPoint], mapping: GroundMapping | None = None) -> Improvement:
    return improve(points, [mapping or told()] * len(points))


def test_errors_are_haversine_distances_by_hand() -> None:
    points = known(SPREAD)
    errors = measure(points, [told()] * len(points))
    by_hand = [
        haversine_by_hand_m(p.lat_deg, p.lon_deg, p.point.lat_deg, p.point.lon_deg)
        for p in errors.placed
    ]
    assert [p.error_m for p in errors.placed] == pytest.approx(by_hand, abs=1e-6)
    assert errors.mean_m == pytest.approx(sum(by_hand) / len(by_hand))
    assert errors.worst_m == pytest.approx(max(by_hand))
    parts = [math.hypot(p.along_m, p.across_m) for p in errors.placed]
    assert parts == pytest.approx(by_hand, rel=0.005)  # sphere and ellipsoid differ by 0.3 %


def test_a_point_above_the_horizon_has_no_error() -> None:
    level = told((0.0, 0.0, 0.0), pitch_deg=-5.0)
    errors = measure(known(SPREAD[:2]), [level] * 2)
    assert errors.unseen == 2
    assert math.isnan(errors.mean_m)
    with pytest.raises(ValueError, match="below the horizon"):
        improved(known(SPREAD[:2]), level)


def test_improve_finds_what_is_hidden_in_exact_points() -> None:
    found = improved(known(SPREAD))
    assert [o.value for o in found.offsets] == pytest.approx(HIDDEN, abs=1e-3)
    assert found.before.mean_m > 6.0
    assert found.after.worst_m < 0.01
    assert found.helps


@pytest.mark.parametrize("hidden", [(40.0, -5.0, 30.0), (0.5, 0.2, 1.0), (170.0, 3.0, -10.0)])
def test_improve_finds_small_and_large_offsets_in_careless_points(
    hidden: tuple[float, float, float],
) -> None:
    """Clicks off by 2 px and places off by 0.5 m: the mean error is below 1 m after."""
    found = improved(known(SPREAD, 0.5, 2.0), told(hidden))
    for offset, true in zip(found.offsets, hidden, strict=True):
        assert abs(offset.value - true) < 4 * offset.sigma
    assert found.after.mean_m < 1.0
    assert found.held_out_m < 1.5


def test_one_wrong_point_is_named_and_hardly_matters() -> None:
    points = known(SPREAD, 0.2, 1.0)
    points[3] = dataclasses.replace(points[3], lat_deg=points[3].lat_deg + 3e-4)  # 33 m
    found = improved(points)
    assert found.misfits == (3,)
    assert found.heading_deg.value == pytest.approx(HIDDEN[0], abs=0.7)
    assert found.height_m.value == pytest.approx(HIDDEN[2], abs=2.5)


def test_offsets_that_points_do_not_determine_are_left_alone() -> None:
    one = improved(known(SPREAD[4:5]))
    assert not one.pitch_deg.is_determined or not one.height_m.is_determined
    assert [o.value for o in one.offsets if not o.is_determined] == [0.0]
    assert math.isnan(one.held_out_m)
    together = improved(known([(640, 360), (645, 362), (641, 366)], 0.5, 2.0))
    assert not (together.pitch_deg.is_determined and together.height_m.is_determined)
    below = told((0.0, 0.0, 0.0), pitch_deg=-90.0)
    assert not improved(known([(640, 360), (642, 361)]), below).heading_deg.is_determined


def test_right_telemetry_stays_as_it_is() -> None:
    found = improved(known(SPREAD, 0.5, 2.0), told((0.0, 0.0, 0.0)))
    for offset in found.offsets:
        assert abs(offset.value) < 3 * offset.sigma


def test_a_picture_that_registration_moved_keeps_its_motion() -> None:
    """The pose is corrected below what registration or averaging changed."""
    plain = told()
    shift = np.array([[1.0, 0.0, 4.0], [0.0, 1.0, -2.0], [0.0, 0.0, 1.0]])
    moved = dataclasses.replace(plain, H_enu_px=shift @ plain.H_enu_px)
    moved = dataclasses.replace(moved, H_px_enu=np.linalg.inv(moved.H_enu_px))
    px = np.array([[300.0, 400.0]])
    same = shifted(moved, np.zeros(3))
    assert px_to_enu(same, px) == pytest.approx(px_to_enu(moved, px), abs=1e-6)
    truth = shifted(moved, np.array(HIDDEN))
    lat, lon = geodetic_from_enu(px_to_enu(truth, np.array(SPREAD, float)), ORIGIN)
    points = [
        KnownPoint(0.0, p, float(a), float(b)) for p, a, b in zip(SPREAD, lat, lon, strict=True)
    ]
    found = improve(points, [moved] * len(points))
    assert [o.value for o in found.offsets] == pytest.approx(HIDDEN, abs=1e-3)


def test_control_points_have_no_pose_to_correct() -> None:
    fixed = dataclasses.replace(told(), pose=None)
    with pytest.raises(ValueError, match="no pose"):
        improved(known(SPREAD), fixed)


def test_speed_of_a_vehicle_driven_at_a_known_speed() -> None:
    t_s = np.arange(0.0, 10.0, 0.1)
    speeds = np.where(t_s < 5, 19.0, 3.0) + 0.1 * np.sin(t_s)
    check = check_speed(7, t_s, speeds, 20.0, (0.0, 4.9))
    assert check.measured_mps == pytest.approx(19.0, abs=0.1)
    assert check.factor == pytest.approx(20 / 19, abs=0.01)
    assert check.error_mps == pytest.approx(-1.0, abs=0.1)
    with pytest.raises(ValueError, match="0 measured speeds"):
        check_speed(7, t_s, speeds, 20.0, (50.0, 60.0))
    with pytest.raises(ValueError, match="stands still"):
        check_speed(7, t_s, speeds * 0, 20.0)


def test_points_are_written_as_they_are_read(tmp_path: Path) -> None:
    points = [KnownPoint(1.5, (10.25, 20.5), 36.11, -97.05, "the sign, left")]
    path = tmp_path / "points.csv"
    path.write_text(write_points(points))
    assert read_points(path) == points


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("t_s,u_px,v_px,lat\n", "line 1: the column lon is missing"),
        ("t_s,u_px,v_px,lat,lon\n", "has no points"),
        ("t_s,u_px,v_px,lat,lon\n1,2,x,4,5\n", "line 2: 'x' is not a number (v_px)"),
        ("t_s,u_px,v_px,lat,lon\n1,2,3,95,5\n", "line 2: lat 95 is not between"),
        ("t_s,u_px,v_px,lat,lon\n1,2,3,nan,5\n", "line 2: 'nan' is not a number (lat)"),
        ("t_s,u_px,v_px,lat,lon\n1,2\n", "line 2: '' is not a number (v_px)"),
    ],
)
def test_a_bad_table_is_refused_with_its_line(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "points.csv"
    path.write_text(text)
    with pytest.raises(InputError) as refusal:
        read_points(path)
    assert sentence in str(refusal.value)


def test_offsets_are_added_to_what_telemetry_or_constants_say(flagger: Path) -> None:
    fill = TelemetryFill(heading_offset_deg=350.0 - 360.0, pitch_offset_deg=1.0, height_offset_m=-3)
    sample = TelemetrySample(0.0, 36.0, -97.0, 100.0, 5.0, -60.0)
    assert corrected(sample, fill) == TelemetrySample(0.0, 36.0, -97.0, 97.0, 355.0, -59.0)
    assert corrected(TelemetrySample(1.0), fill) == TelemetrySample(1.0)
    site = Site(telemetry=fill.model_copy(update={"gimbal_roll_deg": 2.0}))
    paths = flagger / "flight.mp4", flagger / "telemetry.csv"
    with open_flight(*paths, Site()) as plain, open_flight(*paths, site) as other:
        before, after = plain.telemetry_at(10.0), other.telemetry_at(10.0)
    assert before.height_agl_m is not None
    assert after.height_agl_m == pytest.approx(before.height_agl_m - 3)


def test_offsets_are_added_to_live_telemetry() -> None:
    site = parse_settings(
        Site, {"telemetry": {"heading_deg": 10.0, "heading_offset_deg": 2.5}}, "site"
    )
    feed = LiveFeed(None, site)
    luma = np.zeros((2, 2), np.uint8)
    frame = Frame(0, 4.0, luma, lambda w, h: np.zeros((h, w, 3), np.uint8))
    fields = {f.name: 0 for f in dataclasses.fields(Captured)}
    captured = Captured(**{**fields, "frame": frame})
    assert feed.at(captured).heading_deg == 12.5


def test_keys_are_set_in_a_site_files_own_text() -> None:
    text = '# mine\n[site]\nname = "A"  # here\n\n[telemetry]\noffset_s = 1.5\n\n[[approach]]\n'
    text += 'name = "N"\naxis = [\n  [36.0, -97.0],\n  [36.1, -97.0],\n]\n'
    edited = with_table(text, "telemetry", {"height_offset_m": 2.5, "offset_s": 1.0})
    assert "# mine" in edited
    assert "offset_s = 1.0\nheight_offset_m = 2.5\n" in edited
    assert tomllib.loads(edited)["approach"] == tomllib.loads(text)["approach"]
    assert with_table(edited, "telemetry", {"height_offset_m": None}).count("height") == 0
    fresh = with_table("", "telemetry", {"pitch_offset_deg": -1.0})
    assert tomllib.loads(fresh) == {"telemetry": {"pitch_offset_deg": -1.0}}
    inline = with_table("telemetry = {offset_s = 2.0}\n", "telemetry", {"height_offset_m": 1.0})
    assert tomllib.loads(inline)["telemetry"] == {"offset_s": 2.0, "height_offset_m": 1.0}


def test_a_whole_site_file_is_written_and_read_back(root: Path) -> None:
    for path in (root / "examples").rglob("*.toml"):
        if path.name == "scenario.toml":
            continue
        site = read_site(path)
        assert parse_settings(Site, tomllib.loads(whole_text(site)), "x") == site


def test_a_site_file_is_not_overwritten_unasked(tmp_path: Path) -> None:
    path = tmp_path / "sites" / "new.toml"
    save(path, '[site]\nname = "A"\n')
    with pytest.raises(InputError, match="exists already"):
        save(path, '[site]\nname = "B"\n')
    assert save(path, '[site]\nname = "B"\n', overwrite=True).site.name == "B"
    with pytest.raises(InputError, match="unknown key"):
        save(path, '[site]\nnam = "B"\n', overwrite=True)
    assert read_site(path).site.name == "B"


def test_offsets_are_added_to_those_that_were_there() -> None:
    found = improved(known(SPREAD))
    keys = with_offsets(TelemetryFill(heading_offset_deg=-179.0, height_offset_m=1.0), found)
    assert keys["heading_offset_deg"] == pytest.approx(178.0, abs=1e-3)
    assert keys["height_offset_m"] == pytest.approx(-5.0, abs=1e-3)


@pytest.fixture
def biased(flagger: Path, tmp_path: Path) -> Path:
    """The bundled flight's log with heading, pitch and height off, and points of its truth."""
    with (flagger / "telemetry.csv").open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["heading_deg"] = f"{float(row['heading_deg']) + 3.0:.3f}"
        row["gimbal_pitch_deg"] = f"{float(row['gimbal_pitch_deg']) - 1.5:.3f}"
        row["height_agl_m"] = f"{float(row['height_agl_m']) + 6.0:.3f}"
    with (tmp_path / "telemetry.csv").open("w") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    points = []
    with (flagger / "vehicles.csv").open() as file:
        for row in csv.DictReader(file):
            u, v, t_s = float(row["u_px"]), float(row["v_px"]), float(row["t_s"])
            if t_s in (20.0, 30.0, 40.0) and 0 < u < 1280 and 0 < v < 720:
                # Clicks as a hand makes them: whole pixels.
                place = float(row["lat"]), float(row["lon"])
                points.append(KnownPoint(t_s, (round(u), round(v)), *place))
    (tmp_path / "points.csv").write_text(write_points(points))
    return tmp_path


def test_the_command_mends_a_flight_with_wrong_telemetry(
    flagger: Path, biased: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The mean error falls from 6.0 m to below 0.2 m, as docs/check.md says."""
    site, telemetry = str(flagger / "site.toml"), str(biased / "telemetry.csv")
    command = ["check", str(flagger / "flight.mp4"), str(biased / "points.csv")]
    mended = biased / "mended.toml"
    assert main([*command, "--telemetry", telemetry, "--site", site, "--write", str(mended)]) == 0
    said = capsys.readouterr().out
    assert "mean error" in said
    assert (flagger / "site.toml").read_text().splitlines()[0] in mended.read_text()
    fill = read_site(mended).telemetry
    assert fill.heading_offset_deg == pytest.approx(-3.0, abs=0.3)
    assert main([*command, "--telemetry", telemetry, "--site", str(mended)]) == 0
    after = capsys.readouterr().out.splitlines()[-1]
    assert float(after.split("mean error ")[1].split(" m")[0]) < 0.2
    assert main([*command, "--telemetry", telemetry, "--write", str(mended)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_the_command_checks_measured_places_and_speeds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "measured.csv"
    table.write_text("lat,lon,measured_lat,measured_lon\n36,-97,36.0001,-97\n36,-97,36,-97.0001\n")
    assert main(["check", str(table)]) == 0
    by_hand = [
        haversine_by_hand_m(36, -97, 36.0001, -97),
        haversine_by_hand_m(36, -97, 36, -97.0001),
    ]
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"2 points: mean error {sum(by_hand) / 2:.2f} m, worst {max(by_hand):.2f} m"
    columns = (
        "t_s,track_id,approach,lane,lat,lon,station_m,offset_m,speed_mps,length_m,u_px,v_px,state"
    )
    rows = [f"{t / 10},17,N,1,,,10,,20.0,4.5,1,1,confirmed" for t in range(20)]
    (tmp_path / "tracks.csv").write_text("\n".join([columns, *rows, ""]))
    assert main(["check", str(tmp_path), "--speed", "17=45", "--speed", "17=44@0-1"]) == 0
    assert "measured 44.7 ± 0.0 mph, true 45.0 mph: -0.3 mph; multiply by 1.006" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["DIR"], "say which vehicle"),
        (["DIR", "--speed", "9=45"], "is not a run folder"),
        (["flight.mp4"], "name the table of points"),
        (["points.csv", "--speed", "9=45"], "needs the folder of a run"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, words: list[str], sentence: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = [str(tmp_path) if w == "DIR" else w for w in words]
    (tmp_path / "tracks.csv").unlink(missing_ok=True)
    assert main(["check", *given]) == 2
    error = capsys.readouterr().err
    assert sentence in error or "has no tracks.csv" in error


@pytest.mark.parametrize("text", ["17", "x=45", "17=-3", "17=45@9", "17=45@9-3"])
def test_a_speed_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(SystemExit):
        main(["check", "out", "--speed", text])
