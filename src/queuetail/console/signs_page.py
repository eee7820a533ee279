"""The Signs screen: every sign's face, why, where it should stand, and the switch of control."""

from __future__ import annotations

from nicegui import ui
from starlette.requests import Request

from queuetail.console.auth import Role
from queuetail.console.layout import SIGNS, page
from queuetail.console.source import ConsoleSource

STYLE = '<link rel="stylesheet" href="/static/signs.css">'
ARMING = """
<button type="button" id="qt-arm" hidden>Arm…</button>
<button type="button" id="qt-disarm" hidden>Disarm now</button>
<dialog id="qt-ask" aria-labelledby="qt-asktitle">
  <form method="dialog" id="qt-askform">
    <h2 id="qt-asktitle">Let queuetail control the signs?</h2>
    <p>From now on it writes to <strong id="qt-which"></strong> by itself.
      Your name goes into the log.</p>
    <label for="qt-who">Your name</label>
    <input id="qt-who" required maxlength="60" autocomplete="name">
    <div class="qt-choices"><button type="submit" id="qt-yes">Arm the signs</button>
      <button type="button" id="qt-no">Cancel</button></div>
  </form>
</dialog>
"""


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(SIGNS.path)
    def signs(request: Request) -> None:
        with page(source, SIGNS, request) as role:
            ui.add_head_html(STYLE)
            ui.html(content(role), sanitize=False).classes("qt-main")
            ui.add_body_html('<script type="module" src="/static/signs.js"></script>')


def content(role: Role) -> str:
    """Return the screen's elements, which the page's own script fills; only operators may arm."""
    arming = ARMING if role is Role.OPERATOR else ""
    return f"""
<div id="qt-signs">
  <section id="qt-control" class="qt-card" aria-label="Control">
    <p id="qt-armed" role="status"><strong>–</strong><span></span></p>{arming}
    <p id="qt-said" class="qt-warning" role="alert" hidden></p>
  </section>
  <div id="qt-list"></div>
</div>"""
