"""`/health` and `/metrics` over HTTP, for monitoring."""

from __future__ import annotations

import json
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

from queuetail.errors import InputError
from queuetail.live.health import METRICS_TYPE, health_record, metrics
from queuetail.live.records import Health, Published

LOOPBACK = "127.0.0.1"
Reading = Callable[[], tuple[Published | None, Health]]


class HealthServer:
    """Answers on the loopback until it is closed."""

    def __init__(self, port: int, read: Reading) -> None:
        """Start to answer; raises InputError where the port is taken."""

        class Handler(BaseHTTPRequestHandler):
            timeout = 10.0

            def do_GET(self) -> None:
                """Answer one request."""
                status, kind, body = answer(self.path.split("?")[0], read)
                self.send_response(status)
                self.send_header("Content-Type", kind)
                self.send_header("Content-Length", str(len(body)))
                self.send_header("Cache-Control", "no-store")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, format: str, *arguments: object) -> None:
                """Keep requests out of the terminal."""

        try:
            self._server = ThreadingHTTPServer((LOOPBACK, port), Handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"port {port} cannot be used ({getattr(error, 'strerror', None) or error}); "
                "choose another with --port"
            ) from None
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        self._thread = Thread(target=self._server.serve_forever, name="health", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def answer(path: str, read: Reading) -> tuple[HTTPStatus, str, bytes]:
    """Return the status, the content's type and the content for a path."""
    newest, health = read()
    if path == "/health":
        record = health_record(newest, health)
        status = HTTPStatus.OK if record["ok"] else HTTPStatus.SERVICE_UNAVAILABLE
        return status, "application/json", (json.dumps(record, indent=2) + "\n").encode()
    if path == "/metrics":
        return HTTPStatus.OK, METRICS_TYPE, metrics(newest, health)
    text = b"queuetail live: see /health and /metrics\n"
    status = HTTPStatus.OK if path == "/" else HTTPStatus.NOT_FOUND
    return status, "text/plain; charset=utf-8", text
