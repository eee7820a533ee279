"""Sinks: where observations go. Each writes one kind of file and survives an interrupted run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from queuetail.config import Site
from queuetail.types import Frame, Observation


@dataclass(frozen=True, slots=True)
class RunInfo:
    """What a sink needs to know of the run before the first frame."""

    out: Path
    video_name: str
    width_px: int
    height_px: int
    frame_rate_hz: float  # nominal, for the annotated video's encoder only; time is the PTS
    preset: str
    site: Site


class Sink(Protocol):
    """One consumer of observations."""

    def write(self, frame: Frame, observation: Observation) -> None:
        """Take one frame's result; frames come in order of time."""

    def close(self) -> None:
        """Finish the file: called once, also after Ctrl-C or an error in mid-flight."""
