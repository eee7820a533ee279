"""An evaluation for people and for machines: a table on screen, and JSON."""

from __future__ import annotations

import dataclasses
from typing import Any

from rich.console import Console
from rich.table import Table

from queuetail.evaluate.records import AnswerShares, Evaluation

Row = tuple[str, str, str]
NOTHING = "–"


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """Return the figures as plain values for JSON (null where there was nothing to measure)."""
    figures = dataclasses.replace(evaluation, timeline=None)  # type: ignore[arg-type]
    record: dict[str, Any] = _rounded(dataclasses.asdict(figures))
    del record["timeline"]
    return record


def print_table(evaluation: Evaluation, console: Console) -> None:
    """Print the figures, strict beside tolerant where there are both."""
    choice, span = evaluation.approach, evaluation.span
    name = "no approach" if choice.name is None else f"approach '{choice.name}'"
    console.print(
        f"{evaluation.run} against {evaluation.truth}: {name} ({choice.why})", markup=False
    )
    if span.truth_covered < 0.999:
        console.print(
            f"Only {span.start_s:g}–{span.end_s:g} s are compared: "
            f"{percent(span.truth_covered)} of the truth.",
            markup=False,
        )
    for title, rows in figure_rows(evaluation):
        table = Table(title=title, title_justify="left", box=None, pad_edge=False)
        table.add_column("", min_width=34)
        table.add_column("strict", justify="right", min_width=9)
        table.add_column("tolerant", justify="right", min_width=9)
        if not any(right for _, _, right in rows):
            table.columns[1].header = table.columns[2].header = ""
        for row in rows:
            table.add_row(*row)
        console.print(table)


def figure_rows(evaluation: Evaluation) -> list[tuple[str, list[Row]]]:
    """Return every figure as text: title of the group, then label, value, tolerant value."""
    return [
        ("End of queue", _eoq_rows(evaluation)),
        ("Answers", _answer_rows(evaluation)),
        ("Queues forming and dissolving", _episode_rows(evaluation)),
        ("Vehicles", _vehicle_rows(evaluation)),
    ]


def percent(value: float | None) -> str:
    """Return a share as a percentage."""
    return NOTHING if value is None else f"{100 * value:.1f} %"


def quantity(value: float | None, unit: str, signed: bool = False) -> str:
    """Return a number with its unit."""
    if value is None:
        return NOTHING
    value = round(value, 2) + 0.0  # -0.0 becomes 0.0
    return f"{value:+.2f} {unit}" if signed else f"{value:.2f} {unit}"


def _eoq_rows(evaluation: Evaluation) -> list[Row]:
    both = (evaluation.strict, evaluation.tolerant)

    def metres(label: str, name: str, signed: bool = False) -> Row:
        strict, tolerant = (quantity(getattr(e, name), "m", signed) for e in both)
        return label, strict, tolerant

    def shares(label: str, name: str) -> Row:
        strict, tolerant = (percent(getattr(e, name)) for e in both)
        return label, strict, tolerant

    return [
        ("samples", str(both[0].samples), str(both[1].samples)),
        metres("error, median", "median_m"),
        metres("error, 95th percentile", "p95_m"),
        metres("error, maximum", "max_m"),
        metres("bias (+ is downstream), median", "bias_m", signed=True),
        shares("truth inside 1 sigma", "inside_1_sigma"),
        shares("truth inside 2 sigma", "inside_2_sigma"),
        ("left of the axis, median", quantity(evaluation.eoq_left_bias_m, "m", signed=True), ""),
    ]


def _answer_rows(evaluation: Evaluation) -> list[Row]:
    answers = evaluation.answers
    return [
        ("missed, of the queue in view", *_two(answers.missed_strict, answers.missed_tolerant)),
        *_share_rows(answers.queue_in_view, ("clear", "unknown", "no_answer", "beyond_view")),
        ("false, of the time without queue", *_two(answers.false_strict, answers.false_tolerant)),
        *_share_rows(answers.no_queue, ("unknown", "no_answer")),
        (f"queue beyond view ({answers.queue_beyond_view.samples} samples)", "", ""),
        *_share_rows(
            answers.queue_beyond_view, ("beyond_view", "queued", "clear", "unknown", "no_answer")
        ),
        ("unknown, of all", percent(answers.unknown), ""),
        ("no answer, of all", percent(answers.no_answer), ""),
    ]


def _share_rows(shares: AnswerShares, names: tuple[str, ...]) -> list[Row]:
    said = ((name.replace("_", " "), percent(getattr(shares, name))) for name in names)
    return [(f"  said {name}", share, "") for name, share in said] if shares.samples else []


def _episode_rows(evaluation: Evaluation) -> list[Row]:
    queues = evaluation.episodes
    return [
        ("queues in the truth", str(len(queues.episodes)), ""),
        ("never found", str(queues.missed), ""),
        ("found where there is none", str(queues.false), ""),
        ("onset delay, median", quantity(queues.onset_median_s, "s", signed=True), ""),
        ("onset delay, worst", quantity(queues.onset_worst_s, "s", signed=True), ""),
        ("dissolve delay, median", quantity(queues.dissolve_median_s, "s", signed=True), ""),
        ("dissolve delay, worst", quantity(queues.dissolve_worst_s, "s", signed=True), ""),
    ]


def _vehicle_rows(evaluation: Evaluation) -> list[Row]:
    v = evaluation.vehicles
    return [
        (
            f"vehicles true / tracks, within {v.gate_m:g} m",
            f"{v.truth_vehicles} / {v.run_tracks}",
            "",
        ),
        ("recall", percent(v.recall), ""),
        ("precision", percent(v.precision), ""),
        ("HOTA", percent(v.hota), ""),
        ("  detection (DetA)", percent(v.det_a), ""),
        ("  association (AssA)", percent(v.ass_a), ""),
        ("IDF1", percent(v.idf1), ""),
        ("MOTA", percent(v.mota), ""),
        ("identity switches", str(v.id_switches), ""),
        ("geolocation error, median", quantity(v.geolocation_median_m, "m"), ""),
        ("geolocation error, 95th percentile", quantity(v.geolocation_p95_m, "m"), ""),
        ("  along the road, median", quantity(v.along_bias_m, "m", signed=True), ""),
        ("  to the left, median", quantity(v.left_bias_m, "m", signed=True), ""),
        ("speed RMSE", quantity(v.speed_rmse_mps, "m/s"), ""),
        ("speed bias", quantity(v.speed_bias_mps, "m/s", signed=True), ""),
    ]


def _two(strict: float | None, tolerant: float | None) -> tuple[str, str]:
    return percent(strict), percent(tolerant)


def _rounded(value: Any) -> Any:
    """Round floats to 1e-4 (a tenth of a millimetre), through all containers."""
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return round(value, 4) + 0.0 if isinstance(value, float) else value
