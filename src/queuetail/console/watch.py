"""The Watch screen: the picture, the answer in one glance, the map and the charts."""

from __future__ import annotations

import json
from html import escape

from nicegui import ui
from starlette.requests import Request

from queuetail.console.layout import WATCH, page
from queuetail.console.source import About, ConsoleSource

LAYERS = (
    ("boxes", "Boxes"),
    ("speeds", "Speeds"),
    ("lanes", "Lanes and stations"),
    ("ends", "End of queue"),
    ("trails", "Trails"),
)


def add(source: ConsoleSource) -> None:
    """Add the screen's page."""

    @ui.page(WATCH.path)
    def watch(request: Request) -> None:
        with page(source, WATCH, request):
            ui.html(content(source.about), sanitize=False).classes("qt-main")
            ui.add_body_html('<script type="module" src="/static/watch.js"></script>')


def content(about: About) -> str:
    """Return the screen's elements, which the page's own script fills."""
    facts = {
        "live": about.is_live,
        "start_s": about.start_s,
        "end_s": about.end_s,
        "step_s": about.step_s,
        "drawn": about.is_drawn,
    }
    boxes = (
        DRAWN
        if about.is_drawn
        else "".join(
            f'<label><input type="checkbox" data-layer="{key}" checked> {name}</label>'
            for key, name in LAYERS
        )
    )
    return f"""
<div class="qt-watch" id="qt-watch" data-about="{escape(json.dumps(facts))}">
 <div class="qt-column">
  <section class="qt-card qt-view" aria-label="Picture">
    <div class="qt-picture" id="qt-picture">
      <canvas id="qt-image" role="img" aria-label="The drone's newest picture"></canvas>
      <canvas id="qt-overlay" aria-hidden="true"></canvas>
      <p class="qt-nopicture" id="qt-nopicture">No picture yet</p>
    </div>
    {"" if about.is_live else PLAYER}
    <div class="qt-layers" role="group" aria-label="Drawn over the picture">{boxes}
      <label class="qt-units">Units <select id="qt-units">
        <option value="us">mph, ft</option><option value="metric">km/h, m</option>
      </select></label>
    </div>
  </section>
  <div class="qt-charts">
    <section class="qt-card qt-chart"><h2>End of queue over time</h2>
      <canvas id="qt-eoq" role="img" aria-label="End of queue over time"></canvas></section>
    <section class="qt-card qt-chart"><h2>Vehicles in time and space</h2>
      <canvas id="qt-paths" role="img" aria-label="Vehicles in time and space"></canvas></section>
  </div>
 </div>
 <div class="qt-column">
  <div class="qt-side">
    <div id="qt-status" aria-label="Where the queue ends" role="region"></div>
    <p class="qt-hidden" id="qt-said" role="status"></p>
  </div>
  <section class="qt-card qt-mapcard" aria-label="Map"><h2>Map</h2>
    <div id="qt-map"></div><p class="qt-note" id="qt-mapnote"></p></section>
 </div>
</div>
"""


DRAWN = "<span>Boxes and lines are part of this video</span>"
PLAYER = """
<div class="qt-player">
  <button type="button" id="qt-play" aria-label="Play">▶</button>
  <input type="range" id="qt-time" aria-label="Moment of the run" step="any">
  <output id="qt-clock">0:00</output>
  <label>Speed <select id="qt-rate"><option value="0.5">½×</option>
    <option value="1" selected>1×</option><option value="4">4×</option>
    <option value="16">16×</option></select></label>
</div>"""
