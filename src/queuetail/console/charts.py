"""What the charts plot: vehicles' paths, column by column, so that minutes of them stay light."""

from __future__ import annotations

from typing import Annotated

from fastapi import FastAPI, Query
from pydantic import BaseModel, Field

from queuetail.console.source import ConsoleSource

DAY_S = 86_400.0
MOST_POINTS = 20_000
Seconds = Annotated[float, Query(ge=0, le=10 * DAY_S, allow_inf_nan=False)]


class Paths(BaseModel):
    """Where the vehicles were, one row of each list per vehicle and time."""

    t_s: list[float] = Field(default_factory=list)
    approach: list[str] = Field(default_factory=list)
    track_id: list[int] = Field(default_factory=list)
    station_m: list[float] = Field(default_factory=list)
    speed_mps: list[float] = Field(default_factory=list)


def paths_record(source: ConsoleSource, since_s: float, until_s: float) -> Paths:
    """Return the vehicles' paths, thinned in time where there are many."""
    samples = source.paths(since_s, until_s)
    points = sum(len(s.ids) for s in samples)
    found = Paths()
    for sample in samples[:: points // MOST_POINTS + 1]:
        count = len(sample.ids)
        found.t_s += [round(sample.t_s, 2)] * count
        found.approach += [sample.approach] * count
        found.track_id += [int(i) for i in sample.ids]
        found.station_m += sample.station_m.round(1).tolist()
        found.speed_mps += sample.speed_mps.round(2).tolist()
    return found


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the charts' route."""

    @app.get("/api/v1/paths", tags=["answers"])
    def paths(since_s: Seconds = 0.0, until_s: Seconds = 10 * DAY_S) -> Paths:
        """Return where the vehicles were between two times of the run."""
        return paths_record(source, since_s, until_s)
