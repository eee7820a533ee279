"""The report's diagrams as inline SVG that follows the page's text colour."""

from __future__ import annotations

import base64
import io
import re
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image as Pillow

from queuetail.config import MPS_PER_MPH
from queuetail.geo.earth import geodetic_from_enu
from queuetail.sinks.folder import QueueTable, TrackTable
from queuetail.sinks.report_map import MapScene
from queuetail.types import Bools, Floats, QueueStatus

INK = "#010203"  # stands for the page's text colour until the SVG is written
END = "#d55e00"  # Okabe & Ito (2008): told apart with any colour vision
BLUE = "#0072b2"
GREY = "#8a8a8a"
PANEL = "#f3f1ec"
GAP_S = 1.0  # rows farther apart are not joined by a line
WIDTH_IN, WIDE_IN, MAP_IN = 10.0, 0.9, 8.2  # a diagram, a margin with numbers, and the map between
LEGEND_COLUMNS = 4
MAX_POINTS = 1500  # per drawn line: more than there are pixels
STRIP = {  # status -> (name, face, hatch): told apart without colour
    QueueStatus.CLEAR: ("clear", "#ffffff", ""),
    QueueStatus.QUEUED: ("queued", END, ""),
    QueueStatus.BEYOND_VIEW: ("beyond view", "#f5c9a5", "////"),
    QueueStatus.UNKNOWN: ("unknown", "#d8d8d8", "xxxx"),
}
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "queuetail",
    "font.family": "sans-serif",
    "font.size": 11.0,
    "text.color": INK,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": GREY,
    "grid.alpha": 0.25,
    "hatch.linewidth": 0.7,
    "legend.frameon": False,
}


def eoq_over_time(table: QueueTable) -> str:
    """Return EOQ station over time with bands of one and two sigma, above a strip of the status."""
    with mpl.rc_context(STYLE):
        figure = _figure(4.6, top_in=0.4)
        top, strip = figure.subplots(2, 1, sharex=True, height_ratios=[8, 1])
        top.set_facecolor("none")
        joined = _thinned(table)
        known = np.isfinite(joined.station_m)
        if known.any():
            for width, alpha in ((2, 0.18), (1, 0.32)):
                spread = width * np.nan_to_num(joined.sigma_m)
                low, high = joined.station_m - spread, joined.station_m + spread
                top.fill_between(joined.t_s, low, high, color=END, alpha=alpha, linewidth=0)
            alone = known & ~_beside(known)
            top.plot(joined.t_s, joined.station_m, color=END, linewidth=1.8)
            top.plot(joined.t_s[alone], joined.station_m[alone], ".", color=END, markersize=4)
        else:
            _say(top, "no end of queue in this run")
        top.set_ylabel("station in m (traffic moves up)")
        _status_strip(strip, table)
        strip.set_xlabel("time in s")
        return _svg(figure, f"End of queue over time, {table.approach}")


def time_space(table: QueueTable, tracks: TrackTable | None) -> str:
    """Return stations of the tracks over time coloured by speed, with the end of the queue."""
    with mpl.rc_context(STYLE):
        figure = _figure(5.2, right_in=0.7)
        axes = figure.subplots()
        axes.set_facecolor(PANEL)
        lines, speeds = _segments(tracks)
        if len(lines):
            top_mph = max(float(np.ceil(np.nanpercentile(speeds, 99) / 10) * 10), 10.0)
            drawn = LineCollection(
                list(lines), array=speeds, cmap="viridis", linewidths=1.1, rasterized=True
            )
            drawn.set_clim(0, top_mph)
            axes.add_collection(drawn)
            bar = figure.colorbar(drawn, ax=axes, fraction=0.04, pad=0.01, aspect=30)
            bar.set_label("speed in mph")
            axes.set_ylim(*_span(lines[:, :, 1]))
        else:
            _say(axes, "no tracked vehicles on this approach")
        joined = _thinned(table)
        axes.plot(joined.t_s, joined.station_m, color="white", linewidth=3.6)
        axes.plot(joined.t_s, joined.station_m, color=END, linewidth=1.8, label="end of queue")
        if np.isfinite(joined.station_m).any():
            legend = axes.legend(loc="upper left", frameon=True, framealpha=0.85)
            legend.get_texts()[0].set_color("black")
        if len(table):
            axes.set_xlim(table.t_s[0], max(table.t_s[-1], table.t_s[0] + 1))
        axes.set_xlabel("time in s")
        axes.set_ylabel("station in m (traffic moves up)")
        return _svg(figure, f"Time–space diagram, {table.approach}")


def site_map(scene: MapScene) -> str:
    """Return the map in metres, labelled with east, north and degrees where those are known."""
    left, right, low, high = scene.extent
    shape = (high - low) / (right - left)
    with mpl.rc_context(STYLE | {"axes.spines.top": True, "axes.spines.right": True}):
        legend_in = 0.25 * -(-(2 * len(scene.axes) + 1) // LEGEND_COLUMNS)
        height_in = float(np.clip(MAP_IN * shape, 3.2, 9.0)) + legend_in + 1.2
        figure = _figure(height_in, bottom_in=0.6 + legend_in, top_in=0.6, right_in=WIDE_IN)
        axes = figure.subplots()
        axes.set_facecolor(PANEL)
        if scene.base is not None:
            axes.imshow(scene.base[:, :, ::-1], extent=scene.extent, interpolation="none")
        for name, axis in scene.axes:
            axes.plot(*axis.T, color="white", linewidth=3.0, alpha=0.7)
            axes.plot(*axis.T, color=BLUE, linewidth=1.4, label=f"axis {name}".rstrip())
            _arrow(axes, axis, scene.extent)
        for name, places in scene.ends:
            axes.plot(*places.T, "o", color="white", markersize=6.5, markeredgewidth=0)
            axes.plot(*places.T, "o", color=END, markersize=4.5, markeredgewidth=0,
                      label=f"end of queue {name}".rstrip())  # fmt: skip
        if scene.drone is not None:
            axes.plot(*scene.drone, "P", color="white", markersize=13, markeredgecolor="black",
                      label="drone", clip_on=False)  # fmt: skip
        axes.set_xlim(left, right)
        axes.set_ylim(low, high)
        axes.set_aspect("equal")
        axes.set_xlabel("metres east" if scene.origin else "x, metres of the site file")
        axes.set_ylabel("metres north" if scene.origin else "y, metres of the site file")
        if scene.origin is not None:
            _label_degrees(axes, scene)
        if axes.get_legend_handles_labels()[0]:
            figure.legend(loc="lower center", ncols=LEGEND_COLUMNS)
        return _svg(figure, "Map")


def _figure(
    height_in: float, bottom_in: float = 0.6, top_in: float = 0.15, right_in: float = 0.15
) -> Figure:
    """Return a figure with fixed margins: laying it out by its labels costs as much as drawing."""
    figure = Figure(figsize=(WIDTH_IN, height_in))
    figure.subplots_adjust(
        left=WIDE_IN / WIDTH_IN,
        right=1 - right_in / WIDTH_IN,
        bottom=bottom_in / height_in,
        top=1 - top_in / height_in,
        hspace=0.1,
    )
    return figure


def _status_strip(axes: Axes, table: QueueTable) -> None:
    """Draw each stretch of one status as a block with its own face and hatch."""
    shown: dict[QueueStatus, Patch] = {}
    ends = np.append(table.t_s[1:], table.t_s[-1:] + table.durations_s[-1:])
    changes = [i for i in range(len(table)) if i == 0 or table.status[i] is not table.status[i - 1]]
    for first, after in zip(changes, [*changes[1:], len(table)], strict=True):
        status = table.status[first]
        name, face, hatch = STRIP[status]
        start, stop = table.t_s[first], ends[after - 1]
        axes.axvspan(start, stop, facecolor=face, edgecolor="#444444", hatch=hatch, linewidth=0.4)
        shown[status] = Patch(facecolor=face, edgecolor="#444444", hatch=hatch, label=name)
    axes.set_yticks([])
    axes.grid(False)
    if len(table):
        axes.set_xlim(table.t_s[0], max(ends[-1], table.t_s[0] + 1))
    ordered = [shown[s] for s in QueueStatus if s in shown]
    if ordered and axes.figure is not None:
        axes.figure.legend(handles=ordered, loc="upper right", ncols=LEGEND_COLUMNS)


def _thinned(table: QueueTable) -> QueueTable:
    """Return at most MAX_POINTS rows; gaps in time become a row without a value."""
    step = max(len(table) // MAX_POINTS, 1)
    keep = np.zeros(len(table), bool)
    keep[::step] = True
    known = np.isfinite(table.station_m)
    edge = known & ~(np.roll(known, 1) & np.roll(known, -1))
    keep |= edge if edge.sum() < MAX_POINTS else False
    station = table.station_m.copy()
    gap = np.append(False, np.diff(table.t_s) > GAP_S) if len(table) else keep
    station[gap & ~known] = np.nan
    chosen = np.flatnonzero(keep)
    rows = tuple(table.status[i] for i in chosen)
    return QueueTable(
        table.approach, table.t_s[chosen], rows, table.lat[chosen], table.lon[chosen],
        station[chosen], table.sigma_m[chosen], table.length_m[chosen], table.vehicles[chosen],
        table.growth_mps[chosen],
    )  # fmt: skip


def _beside(known: Bools) -> Bools:
    """Return which rows have a known neighbour, so that a line shows them."""
    out = np.zeros(len(known), bool)
    out[1:] |= known[:-1]
    out[:-1] |= known[1:]
    return out


def _segments(tracks: TrackTable | None) -> tuple[Floats, Floats]:
    """Return pieces of tracks, (n, 2, 2) as time and station, and their speeds in mph, (n,)."""
    if tracks is None or len(tracks.t_s) < 2:
        return np.empty((0, 2, 2)), np.empty(0)
    order = np.lexsort((tracks.t_s, tracks.track_id))
    points = np.column_stack([tracks.t_s, tracks.station_m])[order]
    ids, speed = tracks.track_id[order], tracks.speed_mps[order]
    pieces = np.stack([points[:-1], points[1:]], axis=1)
    same = (ids[1:] == ids[:-1]) & (np.diff(points[:, 0]) <= GAP_S)
    keep = same & np.isfinite(pieces).all(axis=(1, 2)) & np.isfinite(speed[1:])
    return pieces[keep], speed[1:][keep] / MPS_PER_MPH


def _span(values: Floats) -> tuple[float, float]:
    low, high = np.percentile(values, [0.2, 99.8])
    margin = max(0.04 * (high - low), 5.0)
    return float(low - margin), float(high + margin)


def _say(axes: Axes, words: str) -> None:
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color=GREY)


def _arrow(axes: Axes, axis: Floats, extent: tuple[float, float, float, float]) -> None:
    """Point along the direction of travel at the piece of the axis nearest the map's middle."""
    middle = np.array([extent[0] + extent[1], extent[2] + extent[3]]) / 2
    i = int(np.argmin(np.linalg.norm((axis[:-1] + axis[1:]) / 2 - middle, axis=1)))
    start, leg = axis[i], axis[i + 1] - axis[i]
    along = float(np.clip((middle - start) @ leg / (leg @ leg), 0, 1))
    reach = leg / np.linalg.norm(leg) * 0.04 * (extent[1] - extent[0])
    foot = start + along * leg
    side = 0.6 * np.array([-reach[1], reach[0]])  # beside the axis, where no end of queue lies
    for colour, width in (("white", 5.0), (BLUE, 2.2)):
        style = {"arrowstyle": "-|>", "color": colour, "linewidth": width, "mutation_scale": 18}
        tip, tail = foot + side + reach, foot + side - reach
        axes.annotate("", xy=tuple(tip), xytext=tuple(tail), arrowprops=style, zorder=6)


def _label_degrees(axes: Axes, scene: MapScene) -> None:
    """Add longitudes above and latitudes at the right; both are linear at the scale of a site."""
    assert scene.origin is not None
    left, right, low, high = scene.extent
    lat, lon = geodetic_from_enu(np.array([[left, low], [right, high]]), scene.origin)
    slope_x, slope_y = (lon[1] - lon[0]) / (right - left), (lat[1] - lat[0]) / (high - low)
    top = axes.secondary_xaxis("top", functions=_line(left, lon[0], slope_x))
    side = axes.secondary_yaxis("right", functions=_line(low, lat[0], slope_y))
    for scale, name in ((top.xaxis, "longitude"), (side.yaxis, "latitude")):
        scale.set_major_formatter("{x:.4f}°")
        scale.set_major_locator(mpl.ticker.MaxNLocator(4))
        scale.set_label_text(name)


def _line(start: float, value: float, slope: float) -> tuple[Any, Any]:
    """Return the function through (start, value) and its inverse."""
    return (
        lambda x: value + (np.asarray(x, float) - start) * slope,
        lambda y: start + (np.asarray(y, float) - value) / slope,
    )


def _svg(figure: Figure, title: str) -> str:
    """Return the figure as an SVG element: no metadata, page-coloured ink, pictures as JPEG."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", transparent=False, facecolor="none", dpi=110,
                   metadata={"Date": None})  # fmt: skip
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'<g id="[^"]*"', "<g", text)
    text = text.replace(INK, "currentColor")
    text = re.sub(r"data:image/png;base64,([A-Za-z0-9+/=\s]+)", _as_jpeg, text)
    escaped = title.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    return text.replace("<svg", f'<svg role="img" aria-label="{escaped}"', 1)


def _as_jpeg(match: re.Match[str]) -> str:
    """Return an opaque embedded PNG as a JPEG, which is ten times smaller for a photograph."""
    picture = Pillow.open(io.BytesIO(base64.b64decode(match[1])))
    if picture.mode == "RGBA" and picture.getchannel("A").getextrema() != (255, 255):
        return match[0]
    buffer = io.BytesIO()
    picture.convert("RGB").save(buffer, "JPEG", quality=80)
    return "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
