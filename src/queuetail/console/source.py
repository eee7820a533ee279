"""Where the console's data come from: a live run or a finished one, told in the same records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

from queuetail.config import Site
from queuetail.live.records import Health, Published
from queuetail.types import Floats, QueueState


@dataclass(frozen=True, slots=True)
class About:
    """What is watched, and how."""

    title: str  # of the page: the site's name
    video: str  # name of the stream or file, without credentials
    preset: str
    site: Site
    site_file: Path | None  # where the settings were read from, if from a file
    is_live: bool
    start_s: float = 0.0  # of a finished run: the first and the last moment, as t_s
    end_s: float = 0.0
    step_s: float = 0.0  # usual time between two answers of a finished run
    is_drawn: bool = False  # boxes and lines are part of the pictures already


@dataclass(frozen=True, slots=True)
class PastState:
    """One approach's answer at one time, without the vehicles."""

    number: int
    utc: datetime
    t_s: float
    state: QueueState


@dataclass(frozen=True, slots=True)
class PathSample:
    """The vehicles of one approach at one time, for the time–space diagram."""

    t_s: float
    approach: str
    ids: Floats  # (n,)
    station_m: Floats  # (n,)
    speed_mps: Floats  # (n,)


class ConsoleSource(Protocol):
    """One thing that the console shows; every method may be called from any thread."""

    about: About

    def newest(self) -> Published | None:
        """Return the newest answer; of a finished run its last one."""

    def at(self, t_s: float) -> Published | None:
        """Return a finished run's answer at `t_s` or before; of a live run the newest."""

    async def newer(self, number: int, timeout_s: float) -> Published | None:
        """Return the newest answer once its number is above `number`; None after `timeout_s`."""

    def past(self, since_s: float, until_s: float) -> Sequence[PastState]:
        """Return the answers between two times of the run, t_s, in order."""

    def paths(self, since_s: float, until_s: float) -> Sequence[PathSample]:
        """Return where the vehicles were between two times of the run, t_s, in order."""

    def health(self) -> Health:
        """Return how the run is now; a finished run has nothing to tell."""
