"""The Health screen: how well the run is, in numbers that stay fresh by themselves."""

from __future__ import annotations

from nicegui import ui
from starlette.requests import Request

from queuetail.console.layout import HEALTH, page
from queuetail.console.source import ConsoleSource


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(HEALTH.path)
    def health_screen(request: Request) -> None:
        with page(source, HEALTH, request):
            ui.element("div").props("id=qt-health").classes("qt-main qt-cards")
            ui.add_body_html('<script type="module" src="/static/health.js"></script>')
