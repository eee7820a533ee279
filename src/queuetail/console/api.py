"""The API: what the screens show, as JSON; places as GeoJSON; a WebSocket of states."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import FastAPI, Query, Request, Response, WebSocket, WebSocketDisconnect

from queuetail.console.answers import health_of, history_row, state_record, tracks_record
from queuetail.console.auth import role_of
from queuetail.console.records import HealthRecord, History, Me, State, Tracks
from queuetail.console.source import ConsoleSource
from queuetail.live.health import METRICS_TYPE, health_record, metrics

WAIT_S = 1.0
DAY_S = 86_400.0
Seconds = Annotated[float, Query(ge=0, le=10 * DAY_S, allow_inf_nan=False)]
Moment = Annotated[
    float | None,
    Query(ge=0, le=10 * DAY_S, allow_inf_nan=False, description="of a finished run, seconds"),
]


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the API's routes to an application."""
    _add_answers(app, source)
    _add_health(app, source)


def _add_answers(app: FastAPI, source: ConsoleSource) -> None:
    def moment(t_s: float | None) -> Any:
        return source.newest() if t_s is None else source.at(t_s)

    @app.get("/api/v1/state", tags=["answers"])
    def state(t_s: Moment = None) -> State:
        """Return the newest answer for every approach."""
        return state_record(moment(t_s), source)

    @app.get("/api/v1/tracks", tags=["answers"])
    def tracks(t_s: Moment = None) -> Tracks:
        """Return every vehicle in the newest picture."""
        return tracks_record(moment(t_s))

    @app.get("/api/v1/history", tags=["answers"])
    def history(
        since_s: Seconds = 0.0,
        until_s: Seconds = 10 * DAY_S,
        limit: Annotated[int, Query(ge=1, le=20_000)] = 2000,
    ) -> History:
        """Return the answers between two times of the run, every n-th where there are many."""
        past = source.past(since_s, until_s)
        step = -(-len(past) // limit) or 1
        return History(rows=[history_row(p) for p in past[::-1][::step][::-1]])

    @app.websocket("/api/v1/states")
    async def states(socket: WebSocket) -> None:
        """Send the newest answer whenever there is one."""
        await socket.accept()
        number = 0
        try:
            while True:
                published = await source.newer(number, WAIT_S)
                if published is None:
                    continue
                number = published.number
                await socket.send_text(state_record(published, source).model_dump_json())
        except (WebSocketDisconnect, RuntimeError):
            return

    @app.get("/api/v1/me", tags=["access"])
    def me(request: Request) -> Me:
        """Return which role the caller has."""
        return Me(role=role_of(request).value)


def _add_health(app: FastAPI, source: ConsoleSource) -> None:
    @app.get("/api/v1/health", tags=["health"])
    def health() -> HealthRecord:
        """Return how well the run is."""
        return health_of(source)

    @app.get("/health", tags=["health"], responses={503: {"description": "no answers"}})
    def monitored(response: Response) -> dict[str, Any]:
        """Return how well the run is, for monitoring: 503 while answers are not made."""
        record = health_record(source.newest(), source.health())
        response.status_code = 200 if record["ok"] or not source.about.is_live else 503
        response.headers["Cache-Control"] = "no-store"
        return record

    @app.get("/metrics", tags=["health"], response_class=Response)
    def prometheus() -> Response:
        """Return the same for Prometheus."""
        return Response(metrics(source.newest(), source.health()), media_type=METRICS_TYPE)
