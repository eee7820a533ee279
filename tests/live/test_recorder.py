"""The recorder: nothing waits for it, a full disk ends only it, a kill costs a second."""

from __future__ import annotations

import errno
import os
import resource
import shutil
import sys
from collections import namedtuple
from datetime import timedelta
from itertools import islice, pairwise
from pathlib import Path
from time import monotonic, sleep

import av
import pytest
from live_run import START_UTC, play, stream_info, without_frame

import kill_recording
from queuetail.errors import InputError
from queuetail.live import recorder as recorder_module
from queuetail.live.mcap_file import McapFile, is_finished, read_mcap
from queuetail.live.mcap_records import Message, RunAbout
from queuetail.live.recorder import Limits, Recorder, finish_cut_recordings, new_folder
from queuetail.live.records import OutletState, Published

WAIT_S = 20.0
Usage = namedtuple("Usage", "total used free")


def failed(recorder: Recorder) -> str:
    """Wait until the recording has stopped by itself; return why."""
    end_s = monotonic() + WAIT_S
    while recorder.health().state is not OutletState.FAILED:
        assert monotonic() < end_s
        sleep(0.01)
    return recorder.health().last_error


def test_a_recording_is_a_folder_that_never_was_there(tmp_path: Path) -> None:
    names = [new_folder(tmp_path / "new", START_UTC).name for _ in range(3)]
    assert names == ["20260514T153000Z", "20260514T153000Z-2", "20260514T153000Z-3"]


def test_where_nothing_can_be_written_the_run_does_not_start(
    tmp_path: Path, about: RunAbout
) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="choose another --record folder"):
        Recorder(tmp_path / "file", about)


def test_the_run_is_described_in_every_file(tmp_path: Path, about: RunAbout, flagger: Path) -> None:
    recorder = Recorder(tmp_path, about, Limits(segment_s=0.5))
    play(flagger, recorder, 2.0, is_paced=True)
    recorder.close()
    files = sorted(recorder.folder.glob("data-*.mcap"))
    assert len(files) >= 2
    for path in files:
        first = next(read_mcap(path))
        assert first.topic == "/run"
        assert first.record["preset"] == "road"
        assert first.record["site"]["site"]["posted_speed_mph"] == 65
        assert is_finished(path)


def test_too_little_space_stops_the_recording_with_one_sentence(
    tmp_path: Path, about: RunAbout, flagger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = [10e9]
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(1e12, 0, free[0]))
    recorder = Recorder(tmp_path, about)
    shown: list[Published] = []
    play(flagger, recorder, 1.0, seen=shown.append)
    free[0] = 499e6
    why = failed(recorder)
    assert "499 MB left, and 500 MB are kept free" in why
    assert "detection goes on" in why
    dropped = recorder.health().dropped
    recorder.offer(without_frame(shown[-1], 99))
    assert recorder.health().dropped > dropped
    recorder.close()
    (data,) = recorder.folder.glob("data-*.mcap")
    assert is_finished(data)
    assert sum(m.topic == "/answer" for m in read_mcap(data)) == len(shown)


def test_a_disk_that_is_full_at_the_start_does_not_stop_the_run(
    tmp_path: Path, about: RunAbout, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(1e12, 1e12, 0))
    recorder = Recorder(tmp_path, about)
    assert "0 MB left" in failed(recorder)
    recorder.close()


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files there")
def test_a_write_that_the_system_refuses_leaves_files_that_can_be_read(
    tmp_path: Path, about: RunAbout, flagger: Path
) -> None:
    """The kernel itself refuses: no file may grow beyond 60 kB."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, limits[1]))
    try:
        recorder = Recorder(tmp_path, about)
        answers = play(flagger, recorder, 6.0)
        why = failed(recorder)
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert len(answers) == 46  # every fourth picture of 6 s
    assert "its disk is full (File too large)" in why
    assert sum(m.topic == "/run" for m in read_mcap(next(recorder.folder.glob("data-*.mcap")))) == 1


def test_a_disk_without_space_is_named_so(
    tmp_path: Path, about: RunAbout, flagger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(self: McapFile) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    recorder = Recorder(tmp_path, about)
    play(flagger, recorder, 0.5)
    monkeypatch.setattr(McapFile, "flush", refuse)
    assert "its disk is full (No space left on device)" in failed(recorder)
    recorder.close()


def test_a_fault_of_ours_stops_only_the_recording(
    tmp_path: Path, about: RunAbout, monkeypatch: pytest.MonkeyPatch
) -> None:
    def break_(self: McapFile, message: Message) -> None:
        raise RuntimeError("a fault")

    monkeypatch.setattr(McapFile, "write", break_)
    recorder = Recorder(tmp_path, about)
    assert "RuntimeError: a fault" in failed(recorder)
    recorder.close()


def test_a_slow_disk_costs_pictures_up_to_the_next_key_picture(
    tmp_path: Path, about: RunAbout, flagger: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recorder, "_work", lambda self: None)
    recorder = Recorder(tmp_path, about, Limits(waiting_mb=0.05))
    with av.open(str(flagger / "flight.mp4")) as container:
        stream = container.streams.video[0]
        info = stream_info(stream, 0)
        for packet in islice(container.demux(stream), 600):
            recorder.packet(packet, info, START_UTC)
    items = recorder._intake.take(0.0)
    kept = [i.packet for i in items if not isinstance(i, Message)]
    assert sum(p.size for p in kept) <= 50_000
    assert recorder.health().dropped > 100
    gaps = [b for a, b in pairwise(kept) if b.dts - a.dts > 3000]
    assert all(p.is_keyframe for p in gaps)
    recorder.close()


def test_cut_recordings_are_finished_at_the_next_start(tmp_path: Path) -> None:
    folder = tmp_path / "old"
    folder.mkdir()
    writer = McapFile(folder / "data-00001.mcap")
    writer.write(Message("/log", 1, {"message": "kept", "level": 2}))
    writer.flush()
    assert finish_cut_recordings(tmp_path) == []  # it may be another run's, and still growing
    old_s = recorder_module.time() - 60
    os.utime(writer.path, (old_s, old_s))
    assert finish_cut_recordings(tmp_path, but=folder) == []
    assert finish_cut_recordings(tmp_path) == [writer.path]
    assert is_finished(writer.path)


def test_answers_without_a_picture_are_kept(tmp_path: Path, about: RunAbout, flagger: Path) -> None:
    recorder = Recorder(tmp_path, about)
    shown: list[Published] = []
    play(flagger, recorder, 0.3, seen=shown.append)
    recorder.offer(without_frame(shown[-1], 99))
    recorder.close()
    (data,) = recorder.folder.glob("data-*.mcap")
    last = [m.record for m in read_mcap(data) if m.topic == "/answer"][-1]
    assert (last["number"], last["of_frame"]) == (99, False)
    assert shown[-1].utc - START_UTC <= timedelta(seconds=0.3)


def test_a_kill_costs_a_second_at_most(tmp_path: Path) -> None:
    """`benchmarks/kill_recording.py` does it twenty times."""
    for trial in kill_recording.trials(tmp_path, count=2, seed=3, least_s=1.0, most_s=2.0):
        assert trial.is_same
        assert trial.frames > 0
        assert trial.lost_s < 2.0  # a second on a machine that does nothing else
