"""The command line: bad input gets exit code 2 and one sentence; no traceback, no empty folder."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from queuetail.cli import main, parser
from queuetail.commands.recorded import pixel
from short_flight import cut_flight

LOG_HEAD = "t_s,lat,lon,height_agl_m,heading_deg,gimbal_pitch_deg,gimbal_roll_deg,hfov_deg\n"
GOOD_ROW = "36.11018968,-97.05753594,110.05,75.02,-55.00,-0.00,84.0\n"
POINT = "[[control_point]]\npx = [{0}, {0}]\nenu_m = [{0}, {0}]\n"


class Bench:
    """A folder with a tiny good video and log, for runs in which one thing is bad."""

    def __init__(self, folder: Path, flagger: Path) -> None:
        self.folder = folder
        self.video = cut_flight(flagger / "flight.mp4", folder / "tiny.mp4", 0.1)
        self.log = self.write("log.csv", LOG_HEAD + "0.0," + GOOD_ROW + "1.0," + GOOD_ROW)
        self.site = flagger / "site.toml"

    def write(self, name: str, data: str | bytes) -> Path:
        path = self.folder / name
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        return path

    def run(self, **changed: Path | str | None) -> list[str]:
        """Return the arguments of a good run, but for what is changed."""
        chosen = {"telemetry": self.log, "site": self.site, "out": self.folder / "o", **changed}
        video = chosen.pop("video", self.video)
        options = [f"--{k}={v}" for k, v in chosen.items() if v is not None]
        return ["run", str(video), "--no-video", "--preset", "paper", *options]


@pytest.fixture
def bench(tmp_path: Path, flagger: Path) -> Bench:
    return Bench(tmp_path, flagger)


def sound(path: Path) -> Path:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("aac", rate=16_000)
        frame = av.AudioFrame.from_ndarray(
            np.zeros((1, 1024), np.float32), format="fltp", layout="mono"
        )
        frame.sample_rate = 16_000
        container.mux([*stream.encode(frame), *stream.encode()])
    return path


def cut_in_half(b: Bench) -> Path:
    data = b.video.read_bytes()
    return b.write("half.mp4", data[: len(data) // 2])


Case = tuple[Callable[[Bench], list[str]], str]
BAD: dict[str, Case] = {
    "no such video": (lambda b: b.run(video="none.mp4"), "none.mp4: there is no such file"),
    "folder": (lambda b: b.run(video=b.folder), "is a folder, not a video"),
    "not a video": (lambda b: b.run(video=b.log), "is not a video"),
    "text": (lambda b: b.run(video=b.write("a.txt", "hello " * 99)), "is not a video"),
    "empty video": (lambda b: b.run(video=b.write("e.mp4", "")), "is empty (0 bytes)"),
    "sound": (lambda b: b.run(video=sound(b.folder / "s.m4a")), "has no video stream"),
    "no index": (lambda b: b.run(video=cut_in_half(b)), "cut off before its index"),
    "no such log": (lambda b: b.run(telemetry="none.csv"), "there is no such telemetry file"),
    "no log": (lambda b: b.run(telemetry=None), "name its log with --telemetry"),
    "empty log": (lambda b: b.run(telemetry=b.write("e.csv", "")), "the telemetry file is empty"),
    "log of a head": (
        lambda b: b.run(telemetry=b.write("h.csv", LOG_HEAD)),
        "there is no telemetry in it",
    ),
    "log of something else": (
        lambda b: b.run(telemetry=b.write("x.csv", "a,b\n1,2\n")),
        "is no telemetry that queuetail knows",
    ),
    "log of bytes": (
        lambda b: b.run(telemetry=b.write("x.bin", bytes(range(256)) * 9)),
        "is no telemetry that queuetail knows",
    ),
    "log of another time": (
        lambda b: b.run(telemetry=b.write("late.csv", LOG_HEAD + "900.0," + GOOD_ROW)),
        "they do not overlap; set offset_s under [telemetry]",
    ),
    "impossible latitude": (
        lambda b: b.run(telemetry=b.write("i.csv", LOG_HEAD + "0,361" + GOOD_ROW[11:])),
        "found in the log: 1 of 1 samples: latitude dropped (outside ±90°)",
    ),
    "misspelt column": (
        lambda b: b.run(
            telemetry=b.write("m.csv", LOG_HEAD.replace("height", "heigth") + "0.0," + GOOD_ROW)
        ),
        "lacks height_agl_m; give height_agl_m under [telemetry] in the site file (--site); "
        "found in the log: columns not used: heigth_agl_m",
    ),
    "nan": (
        lambda b: b.run(telemetry=b.write("i.csv", LOG_HEAD + "0,nan,nan,nan,nan,nan,nan,nan\n")),
        "i.csv",
    ),
    "altitude of -5 km": (
        lambda b: b.run(
            telemetry=b.write("i.csv", LOG_HEAD + "0.0," + GOOD_ROW.replace("110.05", "-5000"))
        ),
        "lacks height_agl_m",
    ),
    "log without a pitch": (
        lambda b: b.run(telemetry=b.write("p.csv", "t_s,lat,lon,height_agl_m\n0,36.1,-97.0,100\n")),
        "lacks heading_deg, gimbal_pitch_deg, hfov_deg",
    ),
    "no such site": (lambda b: b.run(site="none.toml"), "there is no such site file"),
    "site syntax": (lambda b: b.run(site=b.write("s.toml", "[site\n")), "not valid TOML"),
    "unknown site key": (
        lambda b: b.run(site=b.write("s.toml", "[site]\nposted_sped_mph = 65\n")),
        "did you mean 'posted_speed_mph'?",
    ),
    "axis of one point": (
        lambda b: b.run(site=b.write("s.toml", "[[approach]]\nname='a'\naxis = [[36, -97]]\n")),
        "an axis needs two points or more",
    ),
    "too few control points": (
        lambda b: b.run(site=b.write("s.toml", "".join(map(POINT.format, range(3))))),
        "at least 4",
    ),
    "control points on a line": (
        lambda b: b.run(site=b.write("s.toml", "".join(map(POINT.format, range(5))))),
        "s.toml: [[control_point]]: the control points are nearly on a line",
    ),
    "output below a file": (
        lambda b: b.run(out=b.video / "o"),
        "the output folder cannot be written",
    ),
    "output is a file": (lambda b: b.run(out=b.video), "the output folder cannot be written"),
    "no such run to export": (lambda b: ["export", str(b.folder / "none")], "none"),
    "export of no run": (lambda b: ["export", str(b.folder)], ""),
    "locate outside": (
        lambda b: ["locate", str(b.video), "5000,10", "--telemetry", str(b.log)],
        "lies outside",
    ),
    "locate without a log": (lambda b: ["locate", str(b.video), "50,10"], "--telemetry"),
    "locate after the end": (
        lambda b: ["locate", str(b.video), "50,10", "--time", "99", "--telemetry", str(b.log)],
        "has no picture at 99 s",
    ),
    "locate at no time": (
        lambda b: ["locate", str(b.video), "50,10", "--time", "nan", "--telemetry", str(b.log)],
        "has no picture at nan s",
    ),
    "locate in no still": (lambda b: ["locate", str(b.write("x.jpg", "x")), "50,10"], "x.jpg"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_sentence(
    case: str, bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments, says = BAD[case]
    assert main(arguments(bench)) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("queuetail: ")
    assert shown.err.count("\n") == 1
    assert shown.err.endswith("\n")
    assert says in shown.err
    assert not (bench.folder / "o" / "run.json").exists()


@pytest.mark.parametrize(
    ("video", "says"),
    [
        ("aphill_short.ts", "not MISB ST 0601 but another set"),
        ("h264_klv.ts", "found in the log: "),
    ],
)
def test_what_is_wrong_with_telemetry_inside_a_video_is_said(
    video: str, says: str, shared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["run", str(shared / "telemetry" / video), "--out", str(tmp_path / "o")]
    assert main(arguments) == 2
    assert says in capsys.readouterr().err


def test_the_good_run_of_the_bench_is_good(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    """So that each bad one fails for its own reason."""
    assert main(bench.run()) == 0
    shown = capsys.readouterr()
    assert "results in" in shown.out
    assert "SB" in shown.out


def test_some_impossible_samples_are_dropped_and_counted(
    bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = "0.5,361" + GOOD_ROW[11:] + "0.6," + GOOD_ROW.replace("110.05", "-5000")
    log = bench.write("some.csv", LOG_HEAD + "0.0," + GOOD_ROW + bad + "1.0," + GOOD_ROW)
    assert main(bench.run(telemetry=log)) == 0
    notes = [line for line in capsys.readouterr().out.splitlines() if "note:" in line]
    assert notes
    assert "2" in " ".join(notes) or len(notes) == 2


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["walk"],
        ["run"],
        ["run", "a", "--preset", "none"],
        ["simulate", "a", "--out", "b", "--seed=-4"],
        ["simulate", "--random", "1e3", "--out", "b"],
    ],
)
def test_bad_usage_exits_with_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "usage: queuetail" in capsys.readouterr().err


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    for option in ("--version", "--help"):
        with pytest.raises(SystemExit) as stopped:
            main([option])
        assert stopped.value.code == 0
    assert "queuetail 0." in capsys.readouterr().out


def test_every_command_explains_its_options() -> None:
    commands = next(a for a in parser()._actions if isinstance(a, argparse._SubParsersAction))
    assert {"run", "locate", "export"} <= set(commands.choices)
    for name, command in commands.choices.items():
        for action in command._actions:
            described = action.help or action.metavar or action.choices
            assert described, f"{name} {action.dest}"


@pytest.mark.parametrize(
    ("text", "expected"), [("640,360", (640, 360)), ("1.5, 2", (1.5, 2)), ("-3,1e2", (-3, 100))]
)
def test_pixels_are_parsed(text: str, expected: tuple[float, float]) -> None:
    assert pixel(text) == expected


@pytest.mark.parametrize("text", ["640", "640,360,1", "a,b", "", ","])
def test_what_is_no_pixel_is_refused(text: str) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="write it as 640,360"):
        pixel(text)
