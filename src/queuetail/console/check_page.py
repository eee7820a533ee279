"""The Accuracy check screen: known points, their errors, offsets that mend them, speeds."""

from __future__ import annotations

import json
from html import escape

from nicegui import ui
from starlette.requests import Request

from queuetail.console.auth import Role
from queuetail.console.layout import CHECK, page
from queuetail.console.source import About, ConsoleSource

STYLE = '<link rel="stylesheet" href="/static/setup.css">'
NEW_FILE = "site.toml"


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(CHECK.path)
    def check(request: Request) -> None:
        with page(source, CHECK, request) as role:
            ui.add_head_html(STYLE)
            ui.html(content(source.about, role), sanitize=False).classes("qt-main")
            ui.add_body_html('<script type="module" src="/static/check.js"></script>')


def content(about: About, role: Role) -> str:
    """Return the screen's elements, which the page's own script fills."""
    file = about.site_file.name if about.site_file else NEW_FILE
    facts = {"live": about.is_live, "role": role.value, "file": file}
    return f"""
<h1>Accuracy check</h1>
<p class="qt-lead">Click a point in the picture whose true place you know: a sign, a barrier's
  end, a mark.
Then type its place, paste it from a map, or click it on the map.</p>
<div class="qt-work" id="qt-check" data-about="{escape(json.dumps(facts))}">
  <section class="qt-card qt-stillcard" aria-label="Picture">
    <div id="qt-still"></div>
    <div class="qt-row">{hold_row(about)}</div>
    <form id="qt-entry" class="qt-row" hidden>
      <label for="qt-where" id="qt-asked">True place</label>
      <input id="qt-where" placeholder="36.11306, -97.05883" autocomplete="off" size="26">
      <button class="qt-button">Add point</button>
      <button type="button" class="qt-button qt-quiet" id="qt-cancel">Leave out</button>
    </form>
    <p id="qt-said" class="qt-said" role="status"></p>
  </section>
  <section class="qt-card qt-mapcard" aria-label="Map"><h2>Map</h2>
    <div id="qt-map"></div><p class="qt-note" id="qt-mapnote"></p></section>
  <section class="qt-card qt-wide"><h2>Errors</h2>
    <div class="qt-figures"><p>Mean <strong id="qt-mean">–</strong></p>
      <p>Worst <strong id="qt-worst">–</strong></p></div>
    <p id="qt-nopoints" class="qt-note">No points yet.</p>
    <div class="qt-scroll" tabindex="0" role="region" aria-label="Errors of the points">
    <table class="qt-table"><thead><tr><th scope="col">Point</th><th scope="col">At, s</th>
      <th scope="col">True place</th><th scope="col">Measured</th><th scope="col">Error</th>
      <th scope="col">Beyond</th><th scope="col">To the right</th><td></td></tr></thead>
      <tbody id="qt-points"></tbody></table></div>
    <div class="qt-row"><button type="button" class="qt-button" id="qt-improve"
      disabled>Improve</button>
      <button type="button" class="qt-button qt-quiet" id="qt-csv" disabled>Download
        points.csv</button></div>
    <div id="qt-found"></div>
  </section>
  <details class="qt-card qt-wide" id="qt-speed"><summary><h2>Speed check</h2></summary>
    <p class="qt-note">Choose a vehicle that was driven at a known speed; its number stands in the
      picture.</p>
    <div class="qt-row"><label>Vehicle <select id="qt-vehicle"></select></label>
      <label>driven at <input id="qt-mph" type="number" min="1" max="150" step="any" value="45">
        mph</label>
      <button type="button" class="qt-button" id="qt-compare-speed">Compare</button></div>
    <p id="qt-speeds" role="status"></p>
  </details>
</div>
"""


def hold_row(about: About) -> str:
    """Return what chooses the picture: now for a live run, any moment of a finished one."""
    hold = '<button type="button" class="qt-button" id="qt-hold">Hold a new picture</button>'
    if about.is_live:
        return hold
    return (
        f'<label class="qt-grow">Moment <input type="range" id="qt-moment" min="{about.start_s}" '
        f'max="{about.end_s}" step="any" value="{(about.start_s + about.end_s) / 2}"></label>'
        f'<output id="qt-clock"></output>{hold}'
    )
