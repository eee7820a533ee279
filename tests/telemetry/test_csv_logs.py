"""CSV logs: our own, AirData's and DJI's, and what files in the wild do to them."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from queuetail.errors import InputError
from queuetail.telemetry import FlightLog, read_telemetry
from queuetail.telemetry.read import VideoClock
from queuetail.telemetry.reading import stamp_of

OWN = "t_s,lat,lon,height_agl_m,heading_deg\n0,36.1,-97.0,100,350\n1,36.1,-97.0,110,10\n"
AIRDATA = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet), "
    "compass_heading(degrees),isVideo,gimbal_heading(degrees),gimbal_pitch(degrees)\n"
)


def read(tmp_path: Path, content: str | bytes, video: VideoClock | None = None) -> FlightLog:
    path = tmp_path / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return read_telemetry(path, video)


def test_the_bundled_flight(flagger: Path) -> None:
    flight = read_telemetry(flagger / "telemetry.csv")
    assert len(flight.samples) == 801
    assert flight.span_s == (0.0, 80.0)
    assert flight.notes == ()
    first = flight.at(0)
    assert (first.lat_deg, first.lon_deg) == (36.11000042, -97.05766392)
    assert (first.height_agl_m, first.heading_deg, first.hfov_deg) == (110.067, 74.946, 84.0)
    assert first.gimbal_pitch_deg == -55.047


@pytest.mark.parametrize(
    "content",
    [
        OWN.encode(),
        OWN.encode("utf-8-sig"),
        OWN.replace("\n", "\r\n").encode(),
        OWN.replace("\n", "\r").encode(),
        OWN.replace(",", ";").encode(),
        OWN.replace(",", "\t").encode(),
        OWN.replace(",", ";").replace(".", ",").encode(),
        OWN.encode("utf-16"),
        OWN.encode("utf-16-le"),
        OWN.encode("utf-16-be"),
        OWN.upper().encode(),
        ("\n\n" + OWN).encode(),
    ],
)
def test_encodings_line_ends_and_delimiters(tmp_path: Path, content: bytes) -> None:
    flight = read(tmp_path, content)
    sample = flight.at(0.5)
    assert (sample.lat_deg, sample.height_agl_m) == (36.1, pytest.approx(105))
    assert sample.heading_deg == pytest.approx(0, abs=1e-9)


def test_missing_columns_empty_cells_and_extra_columns(tmp_path: Path) -> None:
    flight = read(tmp_path, "t_s,wind,height_agl_m\n0,3,\n1,,90\n2,1,95\n")
    assert flight.fields == {"height_agl_m"}
    assert flight.at(1.5).height_agl_m == pytest.approx(92.5)
    assert any("columns not used: wind" in note for note in flight.notes)


def test_a_bad_number_names_file_and_line(tmp_path: Path) -> None:
    flight = read(tmp_path, "t_s,height_agl_m\n0,90\n1,9o\nx,91\n2,90\n")
    note = next(note for note in flight.notes if "unreadable" in note)
    assert "log.csv: 2 cells were unreadable and dropped (first: line 3, height_agl_m '9o')" in note
    assert any("1 of 4 lines dropped: no time" in note for note in flight.notes)


def test_a_cut_off_last_line_is_not_believed(tmp_path: Path) -> None:
    flight = read(tmp_path, "t_s,height_agl_m,heading_deg\n0,100,1\n1,100,1\n2,10")
    assert flight.span_s == (0, 1)
    assert any("cut off" in note for note in flight.notes)


def test_utc_starts_at_the_videos_own_start(tmp_path: Path) -> None:
    content = "utc,height_agl_m\n" + "".join(f"2026-06-01T14:00:{s:02d}Z,{s}\n" for s in range(20))
    inside = VideoClock(start_utc=datetime(2026, 6, 1, 14, 0, 5, tzinfo=UTC))
    flight = read(tmp_path, content, inside)
    assert flight.span_s == (-5, 14)
    assert flight.at(0).height_agl_m == 5
    assert any("follow the video's own start time" in note for note in flight.notes)
    outside = VideoClock(start_utc=datetime(2020, 1, 1, tzinfo=UTC))
    for clock in (outside, VideoClock(), None):
        flight = read(tmp_path, content, clock)
        assert flight.span_s == (0, 19)
        assert any("first sample is taken as the video's first frame" in n for n in flight.notes)


def test_a_clock_that_was_not_set_yet_is_dropped(tmp_path: Path) -> None:
    late = "".join(f"2026-06-01T14:00:{s:02d}Z,{s}\n" for s in range(9))
    flight = read(tmp_path, "utc,height_agl_m\n1970-01-01T00:00:00Z,7\n" + late)
    assert flight.span_s == (0, 8)
    assert any("1 of 10 samples: dropped (clock over a day off" in note for note in flight.notes)


@pytest.mark.parametrize(
    ("text", "microsecond"),
    [
        ("2017.08.05 14:11:51,393,525", 393_000),
        ("2017-08-05 14:11:51.393", 393_000),
        ("2017/8/5 14:11:51", 0),
        ("2017-08-05T16:11:51+02:00", 0),
    ],
)
def test_stamps(text: str, microsecond: int) -> None:
    assert stamp_of(text) == datetime(2017, 8, 5, 14, 11, 51, microsecond, tzinfo=UTC)


def test_no_stamps() -> None:
    assert stamp_of("2017.13.05 14:11:51") is None
    assert stamp_of("yesterday") is None


def test_utc_with_another_zone(tmp_path: Path) -> None:
    content = "utc,height_agl_m\n2026-06-01T09:00:00-05:00,1\n2026-06-01T14:00:01Z,2\n"
    assert read(tmp_path, content).span_s == (0, 1)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"", "empty"),
        (b" \n\n", "empty"),
        (b"t_s,lat,lon\n", "no telemetry in it"),
        (b"t_s,speed\n0,1\n", "none of the columns"),
        (b"lat,lon\n1,2\n", "no time column"),
        (b"0,36.1,-97.0,100\n1,36.1,-97.0,100\n", "no telemetry that queuetail knows"),
        (b"hello world\n", "no telemetry that queuetail knows"),
        (bytes(range(256)) * 40, "no telemetry that queuetail knows"),
        (b"t_s,lat,lon\n0,361,5\n1,361,5\n", "2 of 2 samples: latitude dropped"),
        (b"t_s,height_agl_m\n0,-5000\n1,nan\n", "none of its 2 samples can be used"),
        (b"t_s,lat,lon\nnan,1,2\n", "time is not a number"),
    ],
)
def test_bad_input_is_one_sentence(tmp_path: Path, content: bytes, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)
    assert "log.csv" in str(caught.value)


def test_no_such_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such telemetry file"):
        read_telemetry(tmp_path / "none.csv")
    with pytest.raises(InputError, match="is a folder"):
        read_telemetry(tmp_path)


def test_airdata_units_and_the_camera(tmp_path: Path) -> None:
    rows = "".join(
        f"{100 * i},2026-06-01 14:00:{i // 10:02d},40.1,-7.5,328.084,10,{int(i >= 30)},20,-90\n"
        for i in range(100)
    )
    flight = read(tmp_path, AIRDATA + rows)
    sample = flight.at(0)
    assert flight.span_s == pytest.approx((-3.0, 6.9))
    assert sample.height_agl_m == pytest.approx(100.0, abs=1e-3)
    assert (sample.heading_deg, sample.gimbal_pitch_deg) == (20, -90)
    assert any("isVideo" in note for note in flight.notes)


def test_airdata_with_two_recordings_takes_the_one_that_fits(tmp_path: Path) -> None:
    on = [*range(10, 20), *range(40, 80)]
    rows = "".join(f"{100 * i},,40.1,-7.5,300,10,{int(i in on)},20,-90\n" for i in range(100))
    assert read(tmp_path, AIRDATA + rows).span_s[0] == pytest.approx(-1.0)
    long = read(tmp_path, AIRDATA + rows, VideoClock(duration_s=4.0))
    assert long.span_s[0] == pytest.approx(-4.0)
    assert any("number 2" in note for note in long.notes)


def test_airdata_without_marks_follows_utc_to_a_tenth(tmp_path: Path) -> None:
    rows = "".join(
        f"{100 * i},2026-06-01 14:00:{(i + 4) // 10:02d},40.1,-7.5,300,10,0,20,-90\n"
        for i in range(50)
    )
    clock = VideoClock(start_utc=datetime(2026, 6, 1, 14, 0, 2, tzinfo=UTC))
    assert read(tmp_path, AIRDATA + rows, clock).span_s == pytest.approx((-1.6, 3.3))


def test_airdata_heights_prefer_the_ground_and_metres(tmp_path: Path) -> None:
    header = (
        "time(millisecond),latitude,longitude,height_above_takeoff(meters),"
        "height_above_ground_at_drone_location(meters),height_sonar(meters),compass_heading(degrees)\n"
    )
    rows = "0,40,-7,50,61,0,90\n100,40,-7,50,62,3,90\n"
    flight = read(tmp_path, header + rows)
    assert [s.height_agl_m for s in flight.samples] == [61, 62]
    assert flight.at(0).heading_deg == 90
    assert any("compass" in note for note in flight.notes)


def test_airdata_sample_without_a_time_column(shared: Path) -> None:
    path = shared / "telemetry" / "henistein_filtered_rotunda.csv"
    flight = read_telemetry(path)
    assert len(flight.samples) == 629
    assert flight.span_s == pytest.approx((0, 62.8))
    sample = flight.at(0)
    assert (sample.lat_deg, sample.lon_deg) == (40.2732472373219, -7.499214414693)
    assert sample.height_agl_m == pytest.approx(264.763788 * 0.3048)
    assert (sample.heading_deg, sample.gimbal_pitch_deg) == (308.2, -89.9)
    spread = read_telemetry(path, VideoClock(duration_s=20.97))
    assert spread.span_s[1] == pytest.approx(20.97 * 628 / 629)
    assert any("spread evenly" in note for note in spread.notes)


def test_dji_frame_table(shared: Path) -> None:
    flight = read_telemetry(shared / "songdo" / "U_video_cut.csv")
    assert len(flight.samples) == 151
    sample = flight.at(2.0)
    assert (sample.lat_deg, sample.lon_deg, sample.height_agl_m) == (37.38892, 126.66295, 146.0)
    assert sample.hfov_deg == pytest.approx(73.74, abs=0.01)
    assert sample.heading_deg is None
