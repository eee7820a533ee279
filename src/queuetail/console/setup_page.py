"""The Set up screen: from a stream to a site file, step by step."""

from __future__ import annotations

import json
from html import escape

from nicegui import ui
from starlette.requests import Request

from queuetail.console.auth import Role
from queuetail.console.check_page import STYLE, hold_row
from queuetail.console.layout import SETUP, page
from queuetail.console.sliders_api import PAPER
from queuetail.console.source import About, ConsoleSource


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(SETUP.path)
    def setup(request: Request) -> None:
        with page(source, SETUP, request) as role:
            ui.add_head_html(STYLE)
            if role is not Role.OPERATOR:
                ui.html(VIEWERS, sanitize=False).classes("qt-main")
                return
            about = source.about
            ui.html(content(about, role.value), sanitize=False).classes("qt-main")
            ui.add_body_html('<script type="module" src="/static/setup.js"></script>')


def content(about: About, role: str) -> str:
    """Return the screen's elements, which the page's own script fills."""
    facts = {"live": about.is_live, "role": role, "paper": about.preset == PAPER}
    return f"""
<h1>Set up</h1>
<div class="qt-work" id="qt-setup" data-about="{escape(json.dumps(facts))}">
  <section class="qt-card qt-stillcard" aria-label="Picture">
    <div id="qt-still"></div>
    <div class="qt-row">{hold_row(about)}</div>
    <p id="qt-said" class="qt-said" role="status"></p>
  </section>
  <div class="qt-steps">
  <section class="qt-card"><h2><span class="qt-num">1</span> Video and telemetry</h2>
    <ul class="qt-checks" id="qt-checks"></ul>
    <table class="qt-table"><thead><tr><th scope="col">Telemetry</th>
      <th scope="col">Value</th><th scope="col">Age</th>
      <th scope="col">Rate</th></tr></thead><tbody id="qt-quantities"></tbody></table>
  </section>
  {ROAD}
  {SIGNS}
  {KEEP}
  </div>
</div>
{SLIDERS if about.preset == PAPER else ""}
"""


VIEWERS = "<h1>Set up</h1><p>This screen is for operators: it changes settings.</p>"
ROAD = """
<section class="qt-card"><h2><span class="qt-num">2</span> Road</h2>
  <p class="qt-note" id="qt-roadnote"></p>
  <div class="qt-row">
    <button type="button" class="qt-button" id="qt-accept" disabled>Take the road that was
      found</button>
    <button type="button" class="qt-button qt-quiet" id="qt-draw" aria-pressed="false">Draw
      it</button>
    <button type="button" class="qt-button qt-quiet" id="qt-undo" disabled>Undo point</button>
    <button type="button" class="qt-button qt-quiet" id="qt-turn" disabled>Turn around</button>
  </div>
  <div class="qt-row" id="qt-roads"></div>
  <div class="qt-fields">
    <label>Name <input id="qt-road" maxlength="60" value="road"></label>
    <label>Lanes <input id="qt-lanes" type="number" min="1" max="12" value="2"></label>
    <label>Lane width, m <input id="qt-width" type="number" min="1.6" max="9.9" step="0.1"
      value="3.6"></label>
    <label>Posted speed, mph <input id="qt-posted" type="number" min="5" max="120"></label>
    <label>Queued below, mph <input id="qt-queue" type="number" min="1" max="120"
      step="any"></label>
  </div>
</section>"""
SIGNS = """
<section class="qt-card"><h2><span class="qt-num">3</span> Warning signs</h2>
  <div class="qt-row"><label>Name <input id="qt-signname" maxlength="60" value="sign 1"
    size="12"></label>
    <button type="button" class="qt-button qt-quiet" id="qt-sign" aria-pressed="false">Click it in
      the picture</button></div>
  <ul class="qt-checks" id="qt-signs"></ul>
</section>"""
KEEP = """
<section class="qt-card"><h2><span class="qt-num">4</span> Use and keep</h2>
  <div class="qt-fields"><label>Name of the site <input id="qt-name" maxlength="100"></label>
    <label>Site file <input id="qt-file" maxlength="65"></label></div>
  <details><summary>Show the site file</summary><pre class="qt-toml" id="qt-toml"
    tabindex="0"></pre></details>
  <div class="qt-row"><button type="button" class="qt-button" id="qt-save">Use and
    save</button></div>
</section>"""
SLIDERS = """
<section class="qt-card qt-below"><h2>The paper's sliders</h2>
  <div class="qt-work"><div>
  <img class="qt-mask" id="qt-mask" alt="Mask of what moves, with a box around each blob">
  </div><div>
  <label class="qt-slider">Blur <input type="range" id="qt-blur" min="3" max="31"
    step="2"><output></output></label>
  <label class="qt-slider">Dilation <input type="range" id="qt-dilate" min="3" max="9"
    step="1"><output></output></label>
  <label class="qt-slider">Blob size <input type="range" id="qt-blob" min="5" max="1000"
    step="5"><output></output></label>
  <label class="qt-slider">Queue speed <input type="range" id="qt-slow" min="1" max="60"
    step="1"><output></output></label>
  <p class="qt-note">The mask shows what these settings see; the run goes on with its own until
    you use them.</p>
  <div class="qt-row"><button type="button" class="qt-button" id="qt-useslid">Use these
    settings</button>
    <label><input type="checkbox" id="qt-keepslid"> and keep them in the site file</label></div>
  <p id="qt-slidsaid" role="status"></p></div></div>
</section>"""
