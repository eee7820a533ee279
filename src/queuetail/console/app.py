"""The console as one web application, and the server that gives it to browsers.

NiceGUI keeps its pages in one global application, so a process can serve one console.
"""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Sequence
from pathlib import Path
from threading import Event, Thread

import nicegui
import uvicorn
from fastapi import APIRouter, FastAPI
from fastapi.exceptions import RequestValidationError
from nicegui import ui
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse
from starlette.staticfiles import StaticFiles

from queuetail import __version__
from queuetail.console import (
    api,
    charts,
    health_page,
    map_view,
    picture,
    setup_screens,
    signs_api,
    signs_page,
    watch,
)
from queuetail.console.auth import Access, Guard, access_for, is_loopback
from queuetail.console.source import ConsoleSource
from queuetail.errors import InputError

STATIC = Path(__file__).parent / "static"
LEAFLET = Path(nicegui.__file__).parent / "elements" / "leaflet" / "dist"
CLOSE_S = 3.0
LOOPBACK = "127.0.0.1"
# Each adds one screen's page.
PAGES = (watch.add, *setup_screens.PAGES, signs_page.add, health_page.add)


def create_api(
    source: ConsoleSource,
    access: Access,
    cookie: str = "queuetail",
    routers: Sequence[APIRouter] = (),
) -> FastAPI:
    """Return the API alone, behind its guard; any number of them can live in a process.

    `routers` are what else is served beside it, such as feeds.
    """
    app = FastAPI(
        title="queuetail",
        version=__version__,
        summary="Where the end of the queue is",
        docs_url=None,
        redoc_url=None,
    )
    for routes in (api, picture, map_view, charts, signs_api, *setup_screens.ROUTES):
        routes.add(app, source)
    for router in routers:
        app.include_router(router)

    @app.get("/docs", include_in_schema=False)
    def docs() -> FileResponse:
        """Return the API's description for people."""
        return FileResponse(STATIC / "docs.html")

    @app.exception_handler(RequestValidationError)
    async def invalid(_request: Request, error: RequestValidationError) -> JSONResponse:
        """Say what is wrong with a request, but not what it was: JSON cannot carry its NaN."""
        told = [{name: e[name] for name in ("type", "loc", "msg")} for e in error.errors()]
        return JSONResponse({"detail": told}, 422)

    app.mount("/static/leaflet", StaticFiles(directory=LEAFLET), name="leaflet")
    app.mount("/static", StaticFiles(directory=STATIC), name="static")
    app.add_middleware(Guard, access=access, cookie=cookie)
    return app


def create_app(
    source: ConsoleSource,
    access: Access,
    cookie: str = "queuetail",
    routers: Sequence[APIRouter] = (),
) -> FastAPI:
    """Return the API with all screens; once per process."""
    app = create_api(source, access, cookie, routers)
    for add in PAGES:
        add(source)
    ui.run_with(
        app,
        title="queuetail",
        dark=None,
        tailwind=False,
        show_welcome_message=False,
        language="en-US",
    )
    return app


class ConsoleServer:
    """Serves a console from a thread of its own until it is closed."""

    def __init__(
        self,
        source: ConsoleSource,
        port: int,
        host: str = LOOPBACK,
        routers: Sequence[APIRouter] = (),
    ) -> None:
        """Start to serve; raises InputError where the address or the port cannot be used."""
        self.host, self.access = host, access_for(host)
        listening = _listening(host, port)
        self.port = int(listening.getsockname()[1])
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        logging.getLogger("nicegui").setLevel(logging.ERROR)  # else strangers' paths are printed
        app = create_app(source, self.access, f"queuetail-{self.port}", routers)
        self._server = uvicorn.Server(
            uvicorn.Config(
                app,
                log_level="critical",
                access_log=False,
                server_header=False,
                ws_per_message_deflate=False,
                timeout_graceful_shutdown=1,
            )
        )
        self._began = Event()
        self._thread = Thread(target=self._serve, args=(listening,), name="console", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """The console's address without a token, as a browser takes it."""
        host = self.host if not _is_any(self.host) else _own_address()
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    def invitation(self, token: str) -> str:
        """Return the address that lets a browser in; without a token where none is needed."""
        return f"{self.address}?token={token}" if token else self.address

    @property
    def is_local(self) -> bool:
        """Whether only this machine can reach it."""
        return is_loopback(self.host)

    def close(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._server.force_exit = True
            self._thread.join(CLOSE_S)

    def _serve(self, listening: socket.socket) -> None:
        with asyncio.Runner() as runner:
            runner.run(self._server.serve(sockets=[listening]))


def _listening(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            host.strip("[]"), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listening = socket.socket(family, kind, protocol)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(place)
        listening.listen(128)
    except (OSError, OverflowError) as error:
        raise InputError(
            f"{host}, port {port} cannot be used ({getattr(error, 'strerror', None) or error}); "
            "choose another with --port or --host"
        ) from None
    return listening


def _is_any(host: str) -> bool:
    return host.strip("[]") in ("0.0.0.0", "::", "")


def _own_address() -> str:
    """Return this machine's address towards its network; nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # RFC 5737: an address for documents
        except OSError:
            return LOOPBACK
        return str(probe.getsockname()[0])
