"""DJI SRT: every sample in the wild parses right or fails with one sentence."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import av
import pytest

from queuetail.errors import InputError
from queuetail.telemetry import FlightLog, read_telemetry
from queuetail.telemetry.container import subtitle_text
from queuetail.telemetry.lens import effective_focals, hfov_from_equivalent
from queuetail.telemetry.read import VideoClock

CUE = "{n}\n00:00:{n:02d},000 --> 00:00:{n:02d},999\n{text}\n\n"


def read(tmp_path: Path, *texts: str, video: VideoClock | None = None) -> FlightLog:
    path = tmp_path / "log.srt"
    path.write_text("".join(CUE.format(n=n, text=text) for n, text in enumerate(texts)))
    return read_telemetry(path, video)


# name, samples, span, first sample (angles and lens apart), read off the files by eye
SAMPLES = [
    ("jip_MAVIC3.srt", 12318, (0.0, 246.34), (3.41531, -3.3744, -2.4)),
    ("jip_air2s.srt", 17, (0.0, 0.533), (41.424724, 2.234156, 117.0)),
    ("jip_broken_incomplete.SRT", 19, (1.0, 19.0), (-34.7383, -58.4563, 20.1)),
    ("jip_broken_incomplete2.SRT", 6, (0.0, 0.2), (-34.86995, -57.823395, 74.725998)),
    ("jip_matrice_300.srt", 381, (0.0, 380.0), (36.6146, -6.112, 0.3)),
    ("jip_mavic_2_style.SRT", 468, (0.0, 468.0), (-20.2533, 149.0251, None)),
    ("jip_mavic_mini.SRT", 117, (0.0, 116.0), (48.0771, -121.7458, 200.7)),
    ("jip_mavic_pro.SRT", 468, (1.0, 468.0), (-20.2533, 149.0251, 1.9)),
    ("jip_mavic_pro_buggy.SRT", 546, (1.0, 546.0), (42.4668, -1.2218, 0.0)),
    ("jip_mix_p4rtk_mavic2pro.srt", 12, (0.0, 5.338), (-34.6502, -59.409424, 17.39)),
    ("jip_old_format.SRT", 468, (1.0, 468.0), (-20.2533, 149.0251, 1.9)),
    ("jip_p4_rtk.SRT", 55, (0.0, 54.0), (-34.237922, -58.851745, 85.8)),
    ("jip_p4p_sample.SRT", 5, (0.0, 4.0), (47.4692, 8.209, 45.6)),
]


@pytest.mark.parametrize(("name", "count", "span", "first"), SAMPLES)
def test_samples_in_the_wild(
    shared: Path, name: str, count: int, span: tuple[float, float], first: tuple[float, ...]
) -> None:
    flight = read_telemetry(shared / "telemetry" / "dji_srt_parser" / name)
    start = flight.samples[0]
    assert len(flight.samples) == count
    assert flight.span_s == pytest.approx(span)
    assert (start.lat_deg, start.lon_deg, start.height_agl_m) == first


@pytest.mark.parametrize(
    ("name", "sentence"),
    [
        ("jip_broken_empty.SRT", "empty"),
        ("jip_broken_empty2.SRT", "no subtitle cues"),
        ("jip_mavic_air.SRT", "none of its 2 subtitle cues"),
    ],
)
def test_samples_that_say_nothing(shared: Path, name: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        read_telemetry(shared / "telemetry" / "dji_srt_parser" / name)
    assert "\n" not in str(caught.value)


def test_a_cue_that_was_cut_off_gives_no_half_values(shared: Path) -> None:
    flight = read_telemetry(shared / "telemetry/dji_srt_parser/jip_broken_incomplete2.SRT")
    cut = flight.samples[2]  # its text ends at "[latit"
    assert (cut.lat_deg, cut.lon_deg, cut.height_agl_m) == (None, None, None)
    assert flight.samples[5].lat_deg is None  # ends at "[latitude : -34.869941] [lo"


def test_gimbal_angles_of_the_one_liner(shared: Path) -> None:
    first = read_telemetry(shared / "telemetry/dji_srt_parser/jip_p4_rtk.SRT").at(0)
    assert (first.heading_deg, first.gimbal_pitch_deg, first.gimbal_roll_deg) == (110.4, -24.4, 0.0)


def test_guessed_heights_are_said(shared: Path) -> None:
    folder = shared / "telemetry" / "dji_srt_parser"
    air2s = read_telemetry(folder / "jip_air2s.srt")
    assert any("may be above sea level" in note for note in air2s.notes)
    m300 = read_telemetry(folder / "jip_matrice_300.srt")
    assert any("barometer" in note for note in m300.notes)


def test_enterprise_gimbal_and_zoom(shared: Path) -> None:
    flight = read_telemetry(shared / "telemetry" / "lo_ufrj.SRT")
    first = flight.at(0)
    assert (first.heading_deg, first.gimbal_pitch_deg, first.gimbal_roll_deg) == (13.2, -9.3, 0.0)
    assert first.height_agl_m == 90.043
    assert first.hfov_deg == pytest.approx(73.74, abs=0.01)
    # focal_len goes up to 1279.9 mm there and already contains dzoom_ratio (161 mm × 7.95).
    narrowest = min(s.hfov_deg for s in flight.samples if s.hfov_deg is not None)
    assert narrowest == pytest.approx(hfov_from_equivalent(1279.9))


def test_the_bundled_srt_agrees_with_the_bundled_csv(flagger: Path) -> None:
    srt, csv = (read_telemetry(flagger / n) for n in ("flight.srt", "telemetry.csv"))
    for t_s in (0.0, 33.33, 79.9):
        a, b = srt.at(t_s), csv.at(t_s)
        assert a.lat_deg == pytest.approx(b.lat_deg, abs=1e-6)
        assert a.height_agl_m == pytest.approx(b.height_agl_m, abs=0.01)
        assert a.heading_deg == pytest.approx(b.heading_deg, abs=0.06)
        assert a.hfov_deg == pytest.approx(b.hfov_deg, abs=0.01)


def test_newest_dialect(tmp_path: Path) -> None:
    text = (
        "FrameCnt: 1, DiffTime: 40ms\n2026-05-27 13:14:22.911\n[iso: 200] [fnum: 1.8] "
        "[focal_len: 24.00] [latitude: 53.365108] [longitude: 6.460719] "
        "[rel_alt: 6.000 abs_alt: -122.769]"
    )
    first = read(tmp_path, text).at(0)
    assert (first.lat_deg, first.lon_deg, first.height_agl_m) == (53.365108, 6.460719, 6.0)


@pytest.mark.parametrize(
    ("gps", "lat", "lon"),
    [
        ("GPS(2.2335,41.3829,19) BAROMETER:1.9", 41.3829, 2.2335),
        ("GPS(36.6146,-6.1120,0.0M) BAROMETER:21.8M", 36.6146, -6.1120),
        ("GPS(-20.25,149.03,16) BAROMETER:1.9", -20.25, 149.03),  # only a longitude exceeds 90
        ("GPS(149.03,-20.25,0.0M) BAROMETER:1.9M", -20.25, 149.03),
        ("HOME(89.99,20.1)\nGPS(90.01,20.1,16) BAROMETER:1.9", 20.1, 90.01),
    ],
)
def test_order_of_gps(tmp_path: Path, gps: str, lat: float, lon: float) -> None:
    first = read(tmp_path, gps, gps).at(0)
    assert (first.lat_deg, first.lon_deg) == (lat, lon)


def test_one_far_cue_decides_the_order_for_the_whole_flight(tmp_path: Path) -> None:
    flight = read(tmp_path, "GPS(20.1,89.999,16) Hb:1.0", "GPS(20.1,90.001,16) Hb:1.0")
    assert (flight.at(0).lat_deg, flight.at(0).lon_deg) == (20.1, 89.999)


def test_heights_in_feet(tmp_path: Path) -> None:
    flight = read(tmp_path, "F/2.8, GPS (8.2090, 47.4692, 18), D 10ft, H 328.084ft, H.S 0.00ft/s")
    assert flight.at(0).height_agl_m == pytest.approx(100, abs=1e-3)


def test_broken_time_lines_are_skipped_and_counted(tmp_path: Path) -> None:
    path = tmp_path / "log.srt"
    times = (
        "00:00:00,000 --> 00:00:00,100",
        "00:00:xx,100 --> 00:00:00,200",
        "00:00:59,000 --> 00:00:60,000",
    )
    text = "[latitude: 1.5] [longitude: 2.5] [rel_alt: 3.0 abs_alt: 4]"
    path.write_text("".join(f"{n}\n{time}\n{text}\n\n" for n, time in enumerate(times)))
    flight = read_telemetry(path)
    assert [s.t_s for s in flight.samples] == [0, 59]
    assert any("1 of 3 cues skipped: no readable time" in note for note in flight.notes)


def test_cues_without_times_that_share_a_second_are_spread_over_it(tmp_path: Path) -> None:
    path = tmp_path / "log.srt"
    path.write_text(
        "".join(
            f"{i}\n2017.08.05 14:11:{51 + i // 4}\n[latitude : -20.2] [longtitude : 149.0]\n\n"
            for i in range(8)
        )
    )
    assert [s.t_s for s in read_telemetry(path).samples] == [i / 4 for i in range(8)]


def test_a_late_start_is_kept_when_it_lies_in_the_video(tmp_path: Path) -> None:
    path = tmp_path / "log.srt"
    path.write_text("1\n00:00:15,000 --> 00:00:16,000\n[latitude: 1.5] [longitude: 2.5]\n\n")
    assert read_telemetry(path, VideoClock(duration_s=60)).span_s == (15, 15)
    assert read_telemetry(path, VideoClock(duration_s=10)).span_s == (0, 0)
    assert read_telemetry(path).span_s == (0, 0)


def test_gimbal_zeros_throughout_are_no_measurement(tmp_path: Path) -> None:
    text = "[latitude: 1.5] [longitude: 2.5] [gb_yaw: 0.0 gb_pitch: 0.0 gb_roll: 0.0]"
    flight = read(tmp_path, text, text)
    assert flight.fields == {"lat_deg", "lon_deg"}
    assert any("not recorded" in note for note in flight.notes)


def test_subtitles_of_a_film_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="recorded no telemetry"):
        read(tmp_path, "Hello there.", "How are you?")


@pytest.mark.parametrize(
    ("focals", "zooms", "effective"),
    [
        ([24, 24, 24], [1, 1, 1], [24, 24, 24]),
        ([24, 24, 24], [1, 2, 4], [24, 48, 96]),  # the lens and the zoom apart
        ([24, 48, 96], [1, 2, 4], [24, 48, 96]),  # the zoom is in focal_len already
        ([24, 24], [2, 2], [48, 48]),  # no lens has 12 mm: the zoom is not applied yet
        ([48, 48], [2, 2], [48, 48]),
        ([None, 24], [1, 1], [None, 24]),
    ],
)
def test_digital_zoom_is_applied_once(
    focals: list[float | None], zooms: list[float], effective: list[float | None]
) -> None:
    assert effective_focals(focals, zooms) == effective


def test_a_real_focal_length_is_not_taken_for_an_equivalent(tmp_path: Path) -> None:
    flight = read(tmp_path, "[fnum : 280] [focal_len : 88] [latitude: 1.5] [longitude: 2.5] ")
    assert flight.at(0).hfov_deg is None


def test_subtitles_inside_a_video(tmp_path: Path, flagger: Path) -> None:
    path = tmp_path / "flight.mkv"
    with (
        av.open(str(flagger / "flight.srt")) as srt,
        av.open(str(flagger / "flight.mp4")) as mp4,
        av.open(str(path), "w", format="matroska") as both,
    ):
        pairs = [
            (source.demux(source.streams[0]), both.add_stream_from_template(source.streams[0]))
            for source in (mp4, srt)
        ]
        for packets, stream in pairs:
            for packet in islice(packets, 60):
                if packet.size:
                    packet.stream = stream
                    both.mux(packet)
    inside, beside = read_telemetry(path), read_telemetry(flagger / "flight.srt")
    assert len(inside.samples) == 60
    assert inside.at(3.3).height_agl_m == pytest.approx(beside.at(3.3).height_agl_m, abs=0.01)


def test_subtitles_as_quicktime_stores_them() -> None:
    text = b"[latitude: 1.5] [longitude: 2.5]"
    assert subtitle_text(len(text).to_bytes(2, "big") + text + b"styl") == text.decode() + "\n"
    assert subtitle_text(text) == text.decode() + "\n"
