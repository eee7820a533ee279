"""One pixel's place on earth: of a video with telemetry, and of control points."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from queuetail.cli import main
from queuetail.errors import InputError
from queuetail.geo.earth import distance_m
from queuetail.locate import locate


@pytest.mark.parametrize("time_s", [0.0, 20.0, 45.0, 70.0])
def test_the_bundled_flights_vehicles_are_found_within_a_metre(
    flagger: Path, time_s: float
) -> None:
    with (flagger / "vehicles.csv").open(encoding="utf-8", newline="") as file:
        truth = [r for r in csv.DictReader(file) if float(r["t_s"]) == time_s][:3]
    assert truth
    for row in truth:
        px = float(row["u_px"]), float(row["v_px"])
        if not (0 <= px[0] <= 1280 and 0 <= px[1] <= 720):
            continue
        place = locate(flagger / "flight.mp4", px, time_s, flagger / "telemetry.csv")
        assert place.lat_deg is not None
        assert place.lon_deg is not None
        away = distance_m(place.lat_deg, place.lon_deg, float(row["lat"]), float(row["lon"]))
        assert away < 1.0
        assert 0.5 < place.sigma_m < 10.0


def test_the_log_beside_the_video_is_used(flagger: Path) -> None:
    """It is the drone's own subtitle file: rounded, and without the gimbal's roll."""
    given = locate(flagger / "flight.mp4", (640, 360), 10.0, flagger / "telemetry.csv")
    beside = locate(flagger / "flight.mp4", (640, 360), 10.0)
    assert given.lat_deg is not None
    assert given.lon_deg is not None
    assert beside.lat_deg is not None
    assert beside.lon_deg is not None
    assert distance_m(given.lat_deg, given.lon_deg, beside.lat_deg, beside.lon_deg) < 5.0


def test_local_metres_have_no_latitude(
    flagger: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pairs = [((0, 0), (0, 72)), ((1280, 0), (128, 72)), ((1280, 720), (128, 0)), ((0, 720), (0, 0))]
    site = tmp_path / "site.toml"
    site.write_text(
        "".join(f"[[control_point]]\npx = {list(p)}\nenu_m = {list(e)}\n" for p, e in pairs)
    )
    place = locate(flagger / "flight.mp4", (640, 360), 0.0, None, site)
    assert place.lat_deg is None
    assert place.enu_m == pytest.approx((64, 36))
    video = str(flagger / "flight.mp4")
    assert main(["locate", video, "320,180", "--site", str(site)]) == 0
    assert "32.00 m east, 54.00 m north" in capsys.readouterr().out


def test_a_pixel_above_the_horizon_is_refused(flagger: Path, tmp_path: Path) -> None:
    log = tmp_path / "level.csv"
    log.write_text(
        "t_s,lat,lon,height_agl_m,heading_deg,gimbal_pitch_deg,hfov_deg\n0,36.1,-97,100,0,0,84\n"
    )
    with pytest.raises(InputError, match="at or above the horizon"):
        locate(flagger / "flight.mp4", (640, 100), 0.0, log)


def test_a_gap_in_the_log_is_named(flagger: Path, tmp_path: Path) -> None:
    lines = (flagger / "telemetry.csv").read_text(encoding="utf-8").splitlines()[:21]
    log = tmp_path / "part.csv"
    log.write_text("\n".join(lines) + "\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"at 79\.5 s: telemetry lacks lat_deg"):
        locate(flagger / "flight.mp4", (640, 360), 79.5, log)


def test_the_command_prints_latitude_and_longitude(
    flagger: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = str(flagger / "telemetry.csv")
    command = ["locate", str(flagger / "flight.mp4"), "640,360", "--time", "5", "--telemetry", log]
    assert main(command) == 0
    shown = capsys.readouterr().out
    lat, lon = shown.split()[0].split(",")
    assert float(lat) == pytest.approx(36.11, abs=0.01)
    assert float(lon) == pytest.approx(-97.057, abs=0.01)
    assert "±" in shown
