"""Moments that are held still: a picture to click in, and where its pixels lie on the ground."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from dataclasses import dataclass
from threading import Lock
from typing import Annotated, Any

import numpy as np
from fastapi import FastAPI, HTTPException, Query, Response
from fastapi import Path as InPath
from pydantic import BaseModel, Field

from queuetail.console.overlay import drawing
from queuetail.console.picture import JPEG, encoded
from queuetail.console.source import ConsoleSource
from queuetail.geo.earth import geodetic_from_enu
from queuetail.geo.ground import covariance, px_to_enu
from queuetail.live.records import Published
from queuetail.types import Approach, GroundMapping, Unknown

KEPT = 200  # about 20 MB of pictures
MOST_POINTS = 200
Number = Annotated[int, InPath(ge=0, le=10**9)]
Moment = Annotated[float | None, Query(ge=0, le=864_000, allow_inf_nan=False)]


@dataclass(frozen=True, slots=True)
class Held:
    """One moment: what is needed of it to place pixels and to show it."""

    number: int
    t_s: float
    size: tuple[int, int]
    mapping: GroundMapping | Unknown
    approaches: tuple[Approach, ...]
    jpeg: bytes
    drawn: dict[str, Any]

    @property
    def placed(self) -> GroundMapping | None:
        """The mapping where it tells latitude and longitude."""
        mapping = self.mapping
        return mapping if isinstance(mapping, GroundMapping) and mapping.origin else None


class Moments:
    """The moments held last; safe from any thread."""

    def __init__(self) -> None:
        self._held: OrderedDict[int, Held] = OrderedDict()
        self._lock = Lock()

    def hold(self, published: Published) -> Held | None:
        """Keep an answer's picture and mapping; None where it has no picture."""
        with self._lock:
            if published.number in self._held:
                self._held.move_to_end(published.number)
                return self._held[published.number]
        if published.frame is None:
            return None
        held = Held(
            published.number,
            published.observation.t_s,
            published.frame.size,
            published.observation.mapping,
            published.observation.approaches,
            encoded(published),
            drawing(published),
        )
        with self._lock:
            self._held[held.number] = held
            while len(self._held) > KEPT:
                self._held.popitem(last=False)
        return held

    def get(self, number: int) -> Held:
        """Return a moment; raises HTTPException where it is no longer kept."""
        with self._lock:
            held = self._held.get(number)
        if held is None:
            raise HTTPException(404, f"picture {number} is no longer kept: hold a new one")
        return held

    def forget(self) -> None:
        """Forget all, as after a change of settings."""
        with self._lock:
            self._held.clear()


class Still(BaseModel):
    """A picture that was held still."""

    number: int
    t_s: float
    width: int
    height: int
    is_placed: bool = Field(description="whether its pixels have latitudes")
    has_pose: bool = Field(description="whether telemetry places it, so that offsets can mend it")
    reasons: list[str]
    drawing: dict[str, Any]


class Spot(BaseModel):
    """The ground under one pixel; None at and above the horizon."""

    u_px: float
    v_px: float
    lat_deg: float | None
    lon_deg: float | None
    sigma_m: float | None


def moments_of(app: FastAPI) -> Moments:
    """Return the application's moments."""
    if not hasattr(app.state, "moments"):
        app.state.moments = Moments()
    found: Moments = app.state.moments
    return found


def still_of(held: Held) -> Still:
    """Return what a page needs to know of a moment."""
    mapping, placed = held.mapping, held.placed
    reasons = list(mapping.reasons) if isinstance(mapping, Unknown) else []
    if placed is None and not reasons:
        reasons = ["the site's control points are in local metres: pixels have no latitude"]
    return Still(
        number=held.number,
        t_s=held.t_s,
        width=held.size[0],
        height=held.size[1],
        is_placed=placed is not None,
        has_pose=placed is not None and placed.pose is not None,
        reasons=reasons,
        drawing=held.drawn,
    )


def spots(held: Held, px: list[tuple[float, float]]) -> list[Spot]:
    """Return the ground under some pixels of a moment."""
    mapping = held.placed
    if mapping is None or mapping.origin is None or not px:
        return [Spot(u_px=u, v_px=v, lat_deg=None, lon_deg=None, sigma_m=None) for u, v in px]
    points = np.array(px, float)
    enu = px_to_enu(mapping, points)
    lat, lon = geodetic_from_enu(enu, mapping.origin)
    spread = covariance(mapping, points)
    found = []
    for i, (u, v) in enumerate(px):
        if not np.isfinite([*enu[i], *spread[i].ravel()]).all():
            found.append(Spot(u_px=u, v_px=v, lat_deg=None, lon_deg=None, sigma_m=None))
            continue
        sigma = float(np.sqrt(np.linalg.eigvalsh(spread[i])[-1]))
        found.append(
            Spot(
                u_px=u,
                v_px=v,
                lat_deg=round(float(lat[i]), 8),
                lon_deg=round(float(lon[i]), 8),
                sigma_m=round(sigma, 2),
            )
        )
    return found


def number_rows(text: str, width: int) -> list[list[float]]:
    """Parse "1,2;3,4" into rows of `width` numbers; raises HTTPException."""
    rows = [part for part in text.split(";") if part]
    if len(rows) > MOST_POINTS:
        raise HTTPException(422, f"{len(rows)} points are more than {MOST_POINTS}")
    try:
        found = [[float(cell) for cell in row.split(",")] for row in rows]
    except ValueError:
        raise HTTPException(422, "points are numbers: write them as 1,2;3,4") from None
    if (
        any(len(row) != width for row in found)
        or not np.isfinite(np.concatenate(found or [[0]])).all()
    ):
        raise HTTPException(422, f"each point has {width} finite numbers")
    return found


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the routes that hold pictures still."""
    moments = moments_of(app)

    @app.get("/api/v1/still", tags=["setup"], responses={404: {"description": "no picture now"}})
    async def still(t_s: Moment = None) -> Still:
        """Hold the newest picture (of a finished run: that of a moment) to click in."""

        def made() -> Held | None:
            published = source.newest() if t_s is None else source.at(t_s)
            return moments.hold(published) if published is not None else None

        held = await asyncio.to_thread(made)
        if held is None:
            is_live = source.about.is_live
            mend = "there is no picture now" if is_live else "open the run with --video to see it"
            raise HTTPException(404, mend)
        return still_of(held)

    @app.get(
        "/api/v1/still/{number}/picture",
        tags=["setup"],
        response_class=Response,
        responses={200: {"content": {JPEG: {}}}, 404: {"description": "no longer kept"}},
    )
    def picture(number: Number) -> Response:
        """Return a held picture."""
        return Response(moments.get(number).jpeg, media_type=JPEG)

    @app.get(
        "/api/v1/still/{number}/places",
        tags=["setup"],
        responses={404: {"description": "no longer kept"}},
    )
    def places(
        number: Number,
        px: Annotated[str, Query(max_length=8000, description="u,v;u,v;…")],
    ) -> list[Spot]:
        """Return the ground under pixels of a held picture."""
        pairs = [(u, v) for u, v in number_rows(px, 2)]
        return spots(moments.get(number), pairs)
