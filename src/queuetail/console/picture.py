"""The picture that viewers see: encoded once per answer, and only while somebody looks.

A viewer asks for each picture when it has drawn the one before, so that a slow link gets fewer
pictures and never older ones.
"""

from __future__ import annotations

import asyncio
import json
import struct
from concurrent.futures import ThreadPoolExecutor
from typing import Annotated

import cv2
from fastapi import FastAPI, Query, Response, WebSocket, WebSocketDisconnect

from queuetail.console.answers import state_record
from queuetail.console.overlay import drawing
from queuetail.console.source import ConsoleSource
from queuetail.live.records import Published

LONGEST_PX = 1280
QUALITY = 70
WAIT_S = 1.0
ASKED_CHARACTERS = 40
JPEG = "image/jpeg"


class Pictures:
    """Encodes answers for viewers; each once, however many there are."""

    def __init__(self, source: ConsoleSource) -> None:
        self._source = source
        # One thread: the pictures of all viewers together never take more than one core.
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="pictures")
        self._lock = asyncio.Lock()
        self._message: tuple[int, bytes] = (-1, b"")

    async def message(self, published: Published) -> bytes:
        """Return the length of a JSON text (4 bytes, big-endian), the text, and the JPEG."""
        async with self._lock:
            number, message = self._message
            if number == published.number:
                return message
            loop = asyncio.get_running_loop()
            made = await loop.run_in_executor(self._thread, self._made, published)
            self._message = published.number, made
            return made

    async def jpeg(self, published: Published) -> bytes:
        """Return the picture alone; empty where there is none."""
        message = await self.message(published)
        (length,) = struct.unpack_from(">I", message)
        return message[4 + length :]

    def _made(self, published: Published) -> bytes:
        state = state_record(published, self._source)
        content = {"state": state.model_dump(mode="json"), "drawing": drawing(published)}
        text = json.dumps(content, separators=(",", ":"), allow_nan=False).encode()
        return struct.pack(">I", len(text)) + text + encoded(published)


def encoded(published: Published) -> bytes:
    """Return the answer's picture as JPEG, at most LONGEST_PX wide or high; empty without one."""
    if published.frame is None:
        return b""
    width, height = published.frame.size
    scale = min(LONGEST_PX / max(width, height), 1.0)
    image = published.frame.bgr(max(round(width * scale), 1), max(round(height * scale), 1))
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the routes that give pictures."""
    pictures = Pictures(source)

    @app.get(
        "/api/v1/picture",
        tags=["answers"],
        response_class=Response,
        responses={200: {"content": {JPEG: {}}}, 404: {"description": "there is no picture now"}},
    )
    async def picture(
        t_s: Annotated[float | None, Query(ge=0, le=864_000, allow_inf_nan=False)] = None,
    ) -> Response:
        """Return the newest picture, without overlays."""
        published = source.newest() if t_s is None else await asyncio.to_thread(source.at, t_s)
        if published is None or published.frame is None:
            return Response(status_code=404)
        return Response(
            await pictures.jpeg(published),
            media_type=JPEG,
            headers={"Cache-Control": "no-store"},
        )

    @app.websocket("/console/pictures")
    async def stream(socket: WebSocket) -> None:
        """Answer "next" by the newest picture not yet sent, "at SECONDS" by a finished run's."""
        await socket.accept()
        number = 0
        try:
            while True:
                asked = await socket.receive_text()
                t_s = moment_of(asked)
                if t_s is not None:
                    published = await asyncio.to_thread(source.at, t_s)
                else:
                    published = await source.newer(number, WAIT_S)
                if published is None:
                    await socket.send_bytes(b"")  # nothing new: the viewer sees that we live
                    continue
                number = published.number
                await socket.send_bytes(await pictures.message(published))
        except (WebSocketDisconnect, RuntimeError, KeyError):
            return


def moment_of(asked: str) -> float | None:
    """Return the moment in "at SECONDS"; None for "next" and anything else."""
    word, _, number = asked[:ASKED_CHARACTERS].partition(" ")
    if word != "at":
        return None
    try:
        t_s = float(number)
    except ValueError:
        return None
    return min(max(t_s, 0.0), 1e7) if t_s == t_s else None  # noqa: PLR0124 - not NaN
