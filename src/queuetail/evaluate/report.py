"""evaluation.html: the figures and plots of one evaluation in a single self-contained page."""

from __future__ import annotations

import io
from math import erf, sqrt
from pathlib import Path

import numpy as np
from jinja2 import Environment
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from queuetail.errors import InputError
from queuetail.evaluate.records import Answer, Evaluation, Timeline, Truth
from queuetail.evaluate.table import figure_rows

BLUE, ORANGE, GREY = "#0072b2", "#d55e00", "#999999"
SIGMAS = np.linspace(0.0, 4.0, 81)

PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{{ run }} against {{ truth }}</title>
<style>
body { font: 16px/1.4 system-ui, sans-serif; margin: 1rem auto; max-width: 60rem; padding: 0 1rem }
table { border-collapse: collapse; margin: 0 0 1.5rem }
caption { font-weight: bold; text-align: left; padding: .3rem 0 }
td, th { padding: .15rem 1.5rem .15rem 0; text-align: right }
th { text-align: left; font-weight: normal }
thead th { text-align: right; color: #666 }
svg { width: 100%; height: auto }
</style>
<h1>{{ run }} against {{ truth }}</h1>
<p>{{ approach }}; {{ span }}.</p>
{% for svg in plots %}{{ svg | safe }}
{% endfor %}
{% for title, rows in groups %}
<table><caption>{{ title }}</caption>
{% if rows | selectattr(2) | list -%}
<thead><tr><th></th><th>strict</th><th>tolerant</th></tr></thead>{% endif %}
{% for label, value, tolerant in rows %}
<tr><th>{{ label }}</th><td>{{ value }}</td><td>{{ tolerant }}</td></tr>{% endfor %}
</table>
{% endfor %}
</html>
"""


def write_report(evaluation: Evaluation, path: Path) -> None:
    """Write the page; raises InputError where it cannot be written."""
    choice, span = evaluation.approach, evaluation.span
    name = "No approach" if choice.name is None else f"Approach “{choice.name}”"
    page = (
        Environment(autoescape=True)
        .from_string(PAGE)
        .render(
            run=evaluation.run,
            truth=evaluation.truth,
            approach=f"{name}: {choice.why}",
            span=f"{span.start_s:g}–{span.end_s:g} s, {span.truth_covered:.0%} of the truth",
            plots=[_svg(figure) for figure in evaluation_figures(evaluation)],
            groups=figure_rows(evaluation),
        )
    )
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def evaluation_figures(evaluation: Evaluation) -> list[Figure]:
    """Return the plots: EOQ and its error over time, and the error's distribution and coverage."""
    line = evaluation.timeline
    over_time = Figure(figsize=(10, 7), layout="constrained")
    top, middle, bottom = over_time.subplots(
        3, 1, sharex=True, gridspec_kw={"height_ratios": [4, 2, 1]}
    )
    _plot_stations(top, line)
    _plot_errors(middle, line)
    _plot_answers(bottom, line)
    spread = Figure(figsize=(10, 3.6), layout="constrained")
    left, right = spread.subplots(1, 2)
    _plot_distribution(left, line)
    _plot_coverage(right, line)
    return [over_time, spread]


def _plot_stations(axes: Axes, line: Timeline) -> None:
    visible = np.where(line.truth == Truth.IN_VIEW, line.truth_station_m, np.nan)
    hidden = np.where(line.truth == Truth.IN_VIEW, np.nan, line.truth_station_m)
    axes.plot(line.t_s, visible, color="black", label="truth")
    axes.plot(line.t_s, hidden, color="black", linestyle=":", label="truth, out of view")
    axes.plot(line.t_s, line.run_station_m, color=BLUE, label="run")
    low, high = line.run_station_m - line.run_sigma_m, line.run_station_m + line.run_sigma_m
    axes.fill_between(line.t_s, low, high, color=BLUE, alpha=0.25, linewidth=0, label="± 1 sigma")
    axes.set_ylabel("station, m")
    axes.set_title("End of queue")
    axes.legend(loc="best", fontsize="small")


def _plot_errors(axes: Axes, line: Timeline) -> None:
    axes.axhline(0, color="black", linewidth=0.8)
    axes.plot(line.t_s, line.strict_m, color=BLUE, label="strict")
    axes.plot(line.t_s, line.tolerant_m, color=ORANGE, label="tolerant")
    axes.set_ylabel("error, m")
    axes.legend(loc="best", fontsize="small")


def _plot_answers(axes: Axes, line: Timeline) -> None:
    truth = {Truth.IN_VIEW: BLUE, Truth.BEYOND_VIEW: ORANGE, Truth.HIDDEN: GREY}
    run = {
        Answer.QUEUED: BLUE,
        Answer.BEYOND_VIEW: ORANGE,
        Answer.UNKNOWN: GREY,
        Answer.NONE: "black",
    }
    rows: list[tuple[float, np.ndarray, dict[int, str]]] = [
        (1.0, line.truth, {int(k): v for k, v in truth.items()}),
        (0.0, line.answer, {int(k): v for k, v in run.items()}),
    ]
    for level, codes, colours in rows:
        for code, colour in colours.items():
            held = codes == code
            axes.fill_between(
                line.t_s, level, level + 0.8, where=held, step="post", color=colour, linewidth=0
            )
    axes.set_yticks([0.4, 1.4], ["run", "truth"])
    axes.set_xlabel(
        "time, s (blue: queue, orange: beyond view, grey: unknown or hidden, black: no answer)"
    )


def _plot_distribution(axes: Axes, line: Timeline) -> None:
    for errors, colour, label in (
        (line.strict_m, BLUE, "strict"),
        (line.tolerant_m, ORANGE, "tolerant"),
    ):
        sizes = np.sort(np.abs(errors[np.isfinite(errors)]))
        if len(sizes):
            shares = np.arange(1, len(sizes) + 1) / len(sizes)
            axes.step(sizes, shares, where="post", color=colour, label=label)
    axes.set(title="Share of samples within an error", xlabel="error, m", ylim=(0, 1))
    if axes.has_data():
        axes.legend(loc="lower right", fontsize="small")


def _plot_coverage(axes: Axes, line: Timeline) -> None:
    """Share of truth inside k sigma over k, beside what a normal error would give."""
    known = np.isfinite(line.strict_m) & np.isfinite(line.run_sigma_m)
    if known.any():
        sigma = np.maximum(line.run_sigma_m[known], 1e-9)
        for errors, colour, label in (
            (line.strict_m[known], BLUE, "strict"),
            (line.tolerant_m[known], ORANGE, "tolerant"),
        ):
            ratio = np.abs(errors) / sigma
            axes.plot(SIGMAS, [(ratio <= k).mean() for k in SIGMAS], color=colour, label=label)
    axes.plot(SIGMAS, [erf(k / sqrt(2)) for k in SIGMAS], color=GREY, ls="--", label="normal")
    axes.set(title="Share of truth inside k sigma", xlabel="k", ylim=(0, 1))
    axes.legend(loc="lower right", fontsize="small")


def _svg(figure: Figure) -> str:
    """Return a figure as an SVG element without the XML head."""
    buffer = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "queuetail"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
