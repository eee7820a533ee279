"""A recording of the bundled flight's first seconds, made once."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from live_run import START_UTC, play

from broadcast import write_live_flight
from queuetail.config import read_site
from queuetail.live.mcap_records import RunAbout
from queuetail.live.recorder import Limits, Recorder
from queuetail.types import Observation
from short_flight import cut_flight

SECONDS = 4.2


@pytest.fixture(scope="session")
def short_folder(flagger: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundled flight's first seconds as a camera sends them, with a key picture each second."""
    folder = tmp_path_factory.mktemp("flight")
    cut = cut_flight(flagger / "flight.mp4", folder / "cut.mp4", SECONDS + 0.3)
    write_live_flight(cut, folder / "flight.mp4")
    for name in ("telemetry.csv", "site.toml"):
        shutil.copy(flagger / name, folder)
    return folder


@pytest.fixture(scope="session")
def about(flagger: Path) -> RunAbout:
    """What the recorded runs were started with."""
    return RunAbout("road", read_site(flagger / "site.toml"), "the bundled flight", START_UTC)


@pytest.fixture(scope="session")
def recorded(
    short_folder: Path, about: RunAbout, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[Observation]]:
    """A recording in three video segments and two sessions, and what was answered."""
    recorder = Recorder(tmp_path_factory.mktemp("recordings"), about, Limits(segment_s=1.5))
    answers = play(short_folder, recorder, SECONDS, session_at_s=[3.0])
    recorder.close()
    assert recorder.health().last_error == ""
    assert recorder.health().delivered == len(answers)
    return recorder.folder, answers
