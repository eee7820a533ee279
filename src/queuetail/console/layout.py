"""What every screen of the console has: navigation, the day or night look, the reader's units."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape

from nicegui import ui
from starlette.requests import Request

from queuetail.console.auth import Role, role_of
from queuetail.console.source import ConsoleSource


@dataclass(frozen=True, slots=True)
class Screen:
    """One page of the console, as the navigation shows it."""

    path: str
    name: str
    for_operators: bool = False


WATCH = Screen("/", "Watch")
SETUP = Screen("/setup", "Set up", for_operators=True)
CHECK = Screen("/check", "Accuracy check")
HISTORY = Screen("/history", "History")
SIGNS = Screen("/signs", "Signs")
HEALTH = Screen("/health-screen", "Health")
SCREENS: tuple[Screen, ...] = (WATCH, SETUP, CHECK, HISTORY, SIGNS, HEALTH)
HEAD = """
<link rel="stylesheet" href="/static/console.css">
<script src="/static/theme.js"></script>
"""


@contextmanager
def page(source: ConsoleSource, screen: Screen, request: Request) -> Iterator[Role]:
    """Lay out a screen's page around what the caller adds, and tell the visitor's role."""
    role = role_of(request)
    about = source.about
    ui.page_title(f"{screen.name} · {about.title}")
    ui.add_head_html(f'<meta name="qt-units" content="{about.site.signs.units}">{HEAD}')
    ui.query(".nicegui-content").classes("qt-page").props("id=main")
    links = "".join(
        f'<a href="{s.path}"{" aria-current=page" if s is screen else ""}>{escape(s.name)}</a>'
        for s in SCREENS
        if role is Role.OPERATOR or not s.for_operators
    )
    with ui.element("header").classes("qt-header"):
        ui.html(
            f'<a class="qt-skip" href="#main">Skip to content</a>'
            f'<span class="qt-site" title="{escape(about.video)}">{escape(about.title)}</span>',
            sanitize=False,
        ).classes("qt-name")
        ui.html(links, sanitize=False, tag="nav").classes("qt-nav").props('aria-label="Screens"')
        ui.html(
            f'<span class="qt-role">{role.value}</span>'
            '<button type="button" class="qt-theme" id="qt-theme" aria-label="Day or night look"'
            ' title="Day or night look">◐</button>',
            sanitize=False,
        ).classes("qt-tools")
    ui.html(f'<h1 class="qt-hidden">{escape(screen.name)}</h1>', sanitize=False)
    yield role
