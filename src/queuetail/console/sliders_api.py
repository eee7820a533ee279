"""The paper's sliders: its mask and blobs with other settings, shown while they move, and used."""

from __future__ import annotations

import asyncio
from collections import deque
from threading import Lock
from typing import Annotated

import cv2
import numpy as np
from fastapi import FastAPI, HTTPException, Query, Response
from pydantic import BaseModel, Field

from queuetail.config import MPS_PER_MPH
from queuetail.console.setup_files import Saving, Used, checked, use
from queuetail.console.source import ConsoleSource
from queuetail.live.records import Published
from queuetail.site_editor import whole_text
from queuetail.types import Detections, Image, Raster
from queuetail.vision.background import MODELS, PaperBackground
from queuetail.vision.blobs import SimpleBlobs

PAPER = "paper"
WIDTH_PX = 720
REMEMBERED = 24  # pictures, from which a model with other settings begins: 20 MB
EVERY_S = 0.2  # between them
BACK_S = 5.0  # of a finished run: how long before the moment they begin
QUALITY = 70
BLOB_BGR = (0, 176, 255)
NOTHING = np.empty((0, 0), np.uint8)
Blur = Annotated[int, Query(ge=3, le=31)]
Dilate = Annotated[int, Query(ge=3, le=9)]
Area = Annotated[float, Query(ge=1, le=20_000, allow_inf_nan=False)]


class Sliders(BaseModel):
    """Where the sliders stand."""

    blur_px: int = Field(ge=3, le=31)
    dilate_px: int = Field(ge=3, le=9)
    min_blob_px2: float = Field(ge=1, le=20_000, allow_inf_nan=False)
    queue_speed_mph: float = Field(ge=1, le=120, allow_inf_nan=False)


class SetSliders(Saving):
    """Sliders that are put to use."""

    sliders: Sliders


class SlidersNow(BaseModel):
    """Where the run's sliders stand, and whether it is the paper's method that runs."""

    sliders: Sliders
    is_paper: bool


class Trial:
    """The paper's chain on the newest pictures with settings under trial; safe from any thread.

    A model with another blur learns from the pictures remembered, so that its mask shows at once.
    """

    def __init__(self, source: ConsoleSource) -> None:
        self._source = source
        self._lock = Lock()
        self._pictures: deque[tuple[float, int, Image]] = deque(maxlen=REMEMBERED)
        self._settings: tuple[int, int] | None = None
        self._background: PaperBackground | None = None
        self._mask: Image = NOTHING
        self._done = -1

    def picture(self, blur_px: int, dilate_px: int, area_px2: float, t_s: float | None) -> bytes:
        """Return the mask with its blobs as JPEG; empty where there is no picture."""
        with self._lock:
            if not self._remember(t_s):
                return b""
            if self._settings != (blur_px, dilate_px):
                self._settings = blur_px, dilate_px
                model = MODELS[self._source.about.site.paper.background]()
                self._background = PaperBackground(model, blur_px, dilate_px)
                self._done = -1
            self._learn()
            found = SimpleBlobs(area_px2).find(self._mask, Raster(self._mask, np.eye(3)))
            return drawn(self._mask, found)

    def _remember(self, t_s: float | None) -> bool:
        """Keep the newest picture; of a finished run those before the moment."""
        moments = [t_s]
        if t_s is not None:
            newest_s = self._pictures[-1][0] if self._pictures else np.inf
            if not newest_s <= t_s <= newest_s + 2.0:
                self._pictures.clear()
                self._done, self._settings = -1, None
                moments = [*np.arange(max(t_s - BACK_S, 0.0), t_s, 2 * EVERY_S), t_s]
        for moment in moments:
            published = self._source.newest() if moment is None else self._source.at(moment)
            self._keep(published)
        return bool(self._pictures)

    def _keep(self, published: Published | None) -> None:
        if published is None or published.frame is None:
            return
        last = self._pictures[-1] if self._pictures else None
        now_s = published.observation.t_s
        if last is not None and 0 <= now_s - last[0] < EVERY_S:
            return
        width, height = published.frame.size
        out = min(WIDTH_PX, width)
        image = published.frame.bgr(out, max(round(height * out / width), 1))
        if last is not None and last[2].shape != image.shape:
            self._pictures.clear()
            self._settings, self._done = None, -1
        self._pictures.append((now_s, published.number, image))

    def _learn(self) -> None:
        """Let the model see what it has not seen."""
        assert self._background is not None
        numbers = [number for _, number, _ in self._pictures]
        begin = numbers.index(self._done) + 1 if self._done in numbers else 0
        for now_s, number, image in list(self._pictures)[begin:]:
            self._mask = self._background.apply(Raster(image, np.eye(3)), now_s, NOTHING)
            self._done = number


def drawn(mask: Image, found: Detections) -> bytes:
    """Return a mask with boxes around its blobs, as JPEG."""
    image = cv2.cvtColor(mask, cv2.COLOR_GRAY2BGR)
    for x, y, width, height in found.boxes.astype(int):
        cv2.rectangle(image, (x, y), (x + width, y + height), BLOB_BGR, 2)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the sliders' routes."""
    trial = Trial(source)

    @app.get("/api/v1/sliders", tags=["setup"])
    def now() -> SlidersNow:
        """Return where the run's sliders stand."""
        site = source.about.site
        return SlidersNow(
            sliders=Sliders(
                blur_px=site.paper.blur_px,
                dilate_px=site.paper.dilate_px,
                min_blob_px2=min(max(site.paper.min_blob_px2, 1.0), 20_000.0),
                queue_speed_mph=max(round(site.queue_speed_mps / MPS_PER_MPH, 2), 1.0),
            ),
            is_paper=source.about.preset == PAPER,
        )

    @app.get(
        "/api/v1/sliders/mask",
        tags=["setup"],
        response_class=Response,
        responses={200: {"content": {"image/jpeg": {}}}, 404: {"description": "no picture"}},
    )
    async def mask(
        blur_px: Blur,
        dilate_px: Dilate,
        min_blob_px2: Area,
        t_s: Annotated[float | None, Query(ge=0, le=864_000, allow_inf_nan=False)] = None,
    ) -> Response:
        """Return the paper's mask and blobs of the newest picture with such settings."""
        jpeg = await asyncio.to_thread(trial.picture, blur_px, dilate_px, min_blob_px2, t_s)
        if not jpeg:
            raise HTTPException(404, "there is no picture now")
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    @app.post("/api/v1/sliders", tags=["setup"])
    def put(given: SetSliders) -> Used:
        """Let the run go on with other sliders; for operators."""
        raw = source.about.site.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
        values = given.sliders.model_dump()
        queue_speed_mph = values.pop("queue_speed_mph")
        raw["paper"] = {**raw.get("paper", {}), **values}
        raw["queue"] = {**raw.get("queue", {}), "speed_mph": queue_speed_mph}
        site = checked(raw)
        return use(source, site, whole_text(site), given)
