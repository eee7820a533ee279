"""A recording of the bundled flight's first seconds, made once."""

from __future__ import annotations

from pathlib import Path

import pytest
from live_run import START_UTC, play

from queuetail.config import read_site
from queuetail.live.mcap_records import RunAbout
from queuetail.live.recorder import Limits, Recorder
from queuetail.types import Observation

SECONDS = 9.0


@pytest.fixture(scope="session")
def about(flagger: Path) -> RunAbout:
    """What the recorded runs were started with."""
    return RunAbout("road", read_site(flagger / "site.toml"), "the bundled flight", START_UTC)


@pytest.fixture(scope="session")
def recorded(
    flagger: Path, about: RunAbout, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, list[Observation]]:
    """A recording in three video segments and two sessions, and what was answered."""
    recorder = Recorder(tmp_path_factory.mktemp("recordings"), about, Limits(segment_s=5.0))
    answers = play(flagger, recorder, SECONDS, session_at_s=[4.0])
    recorder.close()
    assert recorder.health().last_error == ""
    assert recorder.health().delivered == len(answers)
    return recorder.folder, answers
