"""The History screen: what the store remembers, day by day; and this run's moments in replay."""

from __future__ import annotations

import json
from html import escape

from nicegui import ui
from starlette.requests import Request

from queuetail.console.check_page import STYLE
from queuetail.console.layout import HISTORY, page
from queuetail.console.source import About, ConsoleSource


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(HISTORY.path)
    def history(request: Request) -> None:
        with page(source, HISTORY, request):
            ui.add_head_html(STYLE)
            ui.html(content(source.about), sanitize=False).classes("qt-main")
            ui.add_body_html('<script type="module" src="/static/history.js"></script>')


LEGEND = "".join(
    f'<span><i style="background:var(--{colour})"></i>{words}</span>'
    for colour, words in (
        ("clear", "clear"),
        ("queued", "queued"),
        ("beyond", "queue ends beyond view"),
        ("unknown", "unknown (low)"),
    )
)


def content(about: About) -> str:
    """Return the screen's elements, which the page's own script fills."""
    facts = {"live": about.is_live}
    opens = "" if about.is_live else "; click it to open that moment"
    return f"""
<h1>History</h1>
<div id="qt-history" data-about="{escape(json.dumps(facts))}" class="qt-steps">
  <section class="qt-card"><h2 id="qt-daytitle">End of queue over the day</h2>
    <div class="qt-row">
      <button type="button" class="qt-button qt-quiet" id="qt-before"
        aria-label="The day before">‹</button>
      <label>Day <input type="date" id="qt-date"></label>
      <button type="button" class="qt-button qt-quiet" id="qt-after"
        aria-label="The day after">›</button>
      <label>Flight <select id="qt-flight"><option value="">all of the day</option></select></label>
    </div>
    <canvas class="qt-day" id="qt-day" role="img" aria-label="End of queue over the day"></canvas>
    <p class="qt-note" id="qt-dayread">Point at the chart to read it{opens}.</p>
    <p class="qt-legend" aria-label="Colours">{LEGEND}</p>
    <p id="qt-said" class="qt-said" role="status"></p>
    <div class="qt-row">Export
      <a class="qt-button qt-quiet" data-form="csv">CSV</a>
      <a class="qt-button qt-quiet" data-form="json">JSON</a>
      <a class="qt-button qt-quiet" data-form="geojson">GeoJSON</a>
      <label>of <select id="qt-show"><option value="eoq">ends of queue</option>
        <option value="events">events</option></select></label></div>
  </section>
  <section class="qt-card"><h2>Flights</h2>
    <div class="qt-scroll" tabindex="0" role="region" aria-label="Flights">
    <table class="qt-table"><thead><tr><th scope="col">Began</th><th scope="col">Ended</th>
      <th scope="col">Site</th><th scope="col">Video</th><th scope="col">Method</th>
      <th scope="col">Answers</th><th scope="col">Events</th></tr></thead>
      <tbody id="qt-flights"></tbody></table></div></section>
  <section class="qt-card"><h2>Events</h2>
    <div class="qt-scroll" tabindex="0" role="region" aria-label="Events">
    <table class="qt-table"><thead><tr><th scope="col">When</th><th scope="col">Approach</th>
      <th scope="col">What</th><th scope="col">Station</th><th
        scope="col">Length</th><td></td></tr></thead>
      <tbody id="qt-events"></tbody></table></div></section>
</div>
"""
