"""Replay: the recorded answers come again; what changed is named; a cut recording serves, too."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from queuetail.cli import main
from queuetail.errors import InputError
from queuetail.live.mcap_file import McapFile, is_finished, read_mcap
from queuetail.live.mcap_records import FORMAT, Record
from queuetail.live.processing import NO_PLACE
from queuetail.live.recording import find_recording, read_recording
from queuetail.live.replay import first_difference, replay, summary
from queuetail.live.segments import segment_paths
from queuetail.presets import ROAD_LONGEST_S
from queuetail.types import Observation

Recorded = tuple[Path, list[Observation]]


def rewritten(folder: Path, out: Path, change: Callable[[str, Record], None]) -> Path:
    """Copy a recording with its messages changed."""
    out.mkdir()
    for paths in segment_paths(folder).values():
        for path in paths:
            shutil.copy(path, out)
    for path in sorted(folder.glob("data-*.mcap")):
        copy = McapFile(out / path.name)
        for message in read_mcap(path):
            change(message.topic, message.record)
            copy.write(message)
        copy.close()
    return out


def test_every_recorded_answer_comes_again(recorded: Recorded) -> None:
    folder, answers = recorded
    result = replay(folder.parent)
    assert result.is_same
    assert result.frames == result.comparison.compared == len(answers)
    assert result.comparison.largest_m == 0.0
    assert result.notes == ()
    assert "the same: all" in "\n".join(summary(result))


def test_another_method_answers_differently(
    recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["replay", str(recorded[0]), "--preset", "paper", "--out", str(out), "--no-video"]
    assert main(command) == 1
    printed = capsys.readouterr().out
    assert "differs: " in printed
    assert "first at 0.000 s: SB: recorded unknown" in printed
    assert {"queue.csv", "tracks.csv", "events.jsonl", "report.html", "run.json"} == {
        p.name for p in out.iterdir()
    }
    assert json.loads((out / "run.json").read_text("utf-8"))["preset"] == "paper"


def test_the_first_difference_and_the_largest_are_named(recorded: Recorded, tmp_path: Path) -> None:
    eoq = {"station_m": 512.0, "sigma_m": 1.0, "px": [1.0, 2.0]}
    was = {"approach": "SB", "status": "queued", "reasons": [], "eoq": eoq}
    assert first_difference([was], [was]) is None
    close = {**was, "eoq": {**eoq, "station_m": 512.0 + 1e-9}}
    assert first_difference([was], [close]) is None
    far = {**was, "eoq": {**eoq, "station_m": 514.5}}
    assert first_difference([was], [far]) == (
        "SB",
        "recorded queued at station 512.0 m ± 1.0 m, now queued at station 514.5 m ± 1.0 m",
    )
    grows = {**was, "growth_mps": 0.5}
    assert first_difference([grows], [{**grows, "growth_mps": 0.25}]) == (
        "SB",
        "queued at station 512.0 m ± 1.0 m: recorded growth_mps 0.5, now 0.25",
    )
    assert first_difference([was], []) == ("SB", "this approach is missing now")
    assert first_difference([], [was]) == ("SB", "this approach was not recorded")

    def change(topic: str, record: Record) -> None:
        if topic == "/answer" and record["t_s"] > 2.0:
            record["states"] = [was]

    folder = rewritten(recorded[0], tmp_path / "changed", change)
    result = replay(folder)
    assert not result.is_same
    assert result.comparison.first is not None
    assert 2.0 < result.comparison.first.t_s < 2.0 + ROAD_LONGEST_S
    assert result.comparison.differing == sum(o.t_s > 2.0 for o in recorded[1])


def test_telemetry_that_was_changed_changes_the_answers(recorded: Recorded, tmp_path: Path) -> None:
    """The replay takes the recorded telemetry and no other."""

    def change(topic: str, record: Record) -> None:
        if topic == "/frame":
            record["telemetry"]["height_agl_m"] = None

    result = replay(rewritten(recorded[0], tmp_path / "changed", change))
    assert result.comparison.differing > 0


def test_what_the_run_did_not_believe_is_not_believed_again(
    recorded: Recorded, tmp_path: Path
) -> None:
    """Doubts come from clocks, which a replay does not have: they are part of the recording."""
    doubt = "telemetry is 6 s old (position)"

    def change(topic: str, record: Record) -> None:
        if topic == "/answer" and record["t_s"] > 2.0:
            record["doubts"] = [doubt]
            for state in record["states"]:
                state["reasons"] = [doubt, *state["reasons"]]
                state["status"], state["eoq"] = "unknown", None

    assert replay(rewritten(recorded[0], tmp_path / "doubted", change)).is_same


def test_before_the_place_is_known_the_run_waits(recorded: Recorded, tmp_path: Path) -> None:
    """As the live run: nothing is looked at, so that nothing is learnt."""
    site_origin_gone: Record = {"approach": [], "control_point": []}

    def change(topic: str, record: Record) -> None:
        if topic == "/run":
            record["site"] |= site_origin_gone
        elif topic == "/frame" and record["t_s"] < 2.0:
            record["telemetry"]["lat_deg"] = None
        elif topic == "/answer" and record["t_s"] < 2.0:
            unknown = {"approach": "", "status": "unknown", "reasons": [NO_PLACE], "eoq": None}
            record["states"] = [unknown]

    result = replay(rewritten(recorded[0], tmp_path / "late", change))
    assert result.comparison.first is not None
    assert result.comparison.first.t_s == pytest.approx(2.0, abs=0.05)  # the site was taken away


def test_a_cut_recording_is_replayed_up_to_the_cut(recorded: Recorded, tmp_path: Path) -> None:
    folder = tmp_path / "cut"
    shutil.copytree(recorded[0], folder)
    last = segment_paths(folder)[1][-1]
    last.write_bytes(last.read_bytes()[: last.stat().st_size // 2 + 13])
    data = max(folder.glob("data-*.mcap"))
    data.write_bytes(data.read_bytes()[:-100])
    result = replay(folder)
    assert 0.5 * len(recorded[1]) < result.frames < len(recorded[1])
    assert result.is_same
    assert "cut off" in result.notes[0]
    assert "are not in the recorded video" in result.notes[1]


def test_pictures_missing_amid_the_recording_are_a_difference(
    recorded: Recorded, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "gap"
    shutil.copytree(recorded[0], folder)
    first = segment_paths(folder)[0][0]
    first.write_bytes(first.read_bytes()[: first.stat().st_size // 2])
    assert main(["replay", str(folder)]) == 1
    assert "processed frames are not in the recorded video" in capsys.readouterr().out


def test_which_recording_is_meant_is_said(recorded: Recorded, tmp_path: Path) -> None:
    assert find_recording(recorded[0]) == recorded[0]
    with pytest.raises(InputError, match="holds no recording"):
        find_recording(tmp_path)
    with pytest.raises(InputError, match="there is no such folder"):
        find_recording(tmp_path / "nothing")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data-00001.mcap").write_bytes(b"")
    with pytest.raises(InputError, match=r"holds 2 recordings; name one of them: … a, b"):
        find_recording(tmp_path)


def test_what_cannot_be_replayed_is_said(recorded: Recorded, tmp_path: Path) -> None:
    (tmp_path / "data-00001.mcap").write_bytes(b"\x89MCAP0\r\n")
    with pytest.raises(InputError, match="nothing of the recording was written"):
        read_recording(tmp_path)

    def later(topic: str, record: Record) -> None:
        if topic == "/run":
            record["format"] = FORMAT + 1

    with pytest.raises(InputError, match="update queuetail"):
        replay(rewritten(recorded[0], tmp_path / "later", later))


def test_a_closed_recording_is_finished(recorded: Recorded) -> None:
    assert is_finished(recorded[0] / "data-00001.mcap")
