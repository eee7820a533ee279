"""The suite's tables: one row a scenario, one row for all, and a row for each figure to reach."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from queuetail.bench import from_json
from queuetail.bench_table import setting, tables

Record = dict[str, Any]
ByName = dict[str, Record]
BEGIN, END = "<!-- suite:begin -->", "<!-- suite:end -->"
NOTHING = "–"
TITLES = {
    "road": "Preset `road`, with telemetry and site file",
    "road-no-site": "Preset `road`, told the posted limit only: the road is found from the traffic",
    "paper": "Preset `paper`, with telemetry and site file",
}
HEADING = (
    *("scenario", "EOQ median", "p95", "max", "strict median", "inside 2 σ", "missed", "false"),
    *("onset", "dissolve", "unknown", "recall", "precision", "IDF1", "HOTA", "speed RMSE"),
)
LEGEND = """EOQ errors are in metres along the road against the truth within −1.5…+0.5 s; *strict*
is against the truth of the same instant. *Missed* is of the time with a queue in view, *false* of
the time without one; onset and dissolve are seconds late, median. The last row pools all samples;
recall, precision, IDF1 and HOTA are weighted by vehicles there. [Evaluation](evaluation.md)
defines every figure; the flights are [simulated](simulator.md). A row saying *failed* has none."""


def suite_text(figures: dict[str, ByName], speed: ByName) -> str:
    """Return the Markdown between the markers."""
    parts = [LEGEND, _block("make benchmark", "Figures to reach", target_rows(figures, speed))]
    for variant, by_name in figures.items():
        command = f"python benchmarks/suite.py --no-speed --variants {variant}"
        parts.append(_block(command, TITLES[variant], variant_rows(by_name)))
    parts += [part for key in speed for part in _speed_blocks(speed[key])]
    return "\n\n".join(parts)


def _speed_blocks(record: Record) -> list[str]:
    """Return a bench's own tables; its command stands above each."""
    if "methods" not in record:
        return []
    bench = from_json({key: value for key, value in record.items() if key != "command"})
    size = f"{bench.video.width_px}×{bench.video.height_px}"
    shown = [_block(record["command"], f"Speed at {size}: {t}", r) for t, r in tables(bench)]
    return [f"Measured with nothing else running: {setting(bench)}.", *shown]


def rewrite(page: Path, text: str) -> None:
    """Replace what stands between the page's markers, and only that; add them where missing."""
    old = page.read_text(encoding="utf-8") if page.is_file() else "# Benchmarks\n"
    if BEGIN not in old or END not in old:
        old = f"{old.rstrip()}\n\n## The suite\n\n{BEGIN}\n{END}\n"
    before, rest = old.split(BEGIN, 1)
    after = rest.split(END, 1)[1]
    page.write_text(f"{before}{BEGIN}\n{text}\n{END}{after}", encoding="utf-8")


def variant_rows(by_name: ByName) -> list[list[str]]:
    """Return a row for each scenario and one for all together."""
    rows = [list(HEADING)]
    for name, record in sorted(by_name.items()):
        if good(record):
            rows.append([name, *_cells(Pool([record]))])
        else:
            rows.append([name, f"failed: {_safe(record.get('error', 'not run'))}"])
    fine = [r for r in by_name.values() if good(r)]
    return [*rows, [f"**all {len(fine)}**", *_cells(Pool(fine))]] if len(fine) > 1 else rows


def good(record: Record) -> bool:
    """Say whether a record holds figures."""
    return "tolerant_errors_m" in record


class Pool:
    """The figures of one run, or of several taken together."""

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records

    def eoq_m(self, percentile: float, which: str = "tolerant") -> float | None:
        """Return a percentile of the EOQ error over all samples."""
        errors = [e for r in self.records for e in r[f"{which}_errors_m"]]
        return float(np.percentile(errors, percentile)) if errors else None

    def mean(self, value: str, weight: Callable[[Record], float]) -> float | None:
        """Return the mean of a figure, its place written `table.key`, over weighted runs."""
        table, key = value.split(".")
        pairs = [(r[table][key], weight(r)) for r in self.records if r[table][key] is not None]
        total = sum(w for _, w in pairs)
        return sum(v * w for v, w in pairs) / total if total else None

    def delays_s(self, key: str) -> list[float]:
        """Return every queue's delay, where it has one."""
        queues = [e for r in self.records for e in r["episodes"]["episodes"]]
        return [e[key] for e in queues if e[key] is not None]

    @property
    def missed(self) -> float | None:
        return self.mean("answers.missed_tolerant", lambda r: _samples(r, "queue_in_view"))

    @property
    def false(self) -> float | None:
        return self.mean("answers.false_tolerant", lambda r: _samples(r, "no_queue"))

    @property
    def unknown(self) -> float | None:
        return self.mean("answers.unknown", lambda r: r["frames"])

    @property
    def inside_2_sigma(self) -> float | None:
        return self.mean("tolerant.inside_2_sigma", lambda r: r["tolerant"]["samples"])

    @property
    def recall(self) -> float | None:
        return self.mean("vehicles.recall", _true_rows)

    @property
    def precision(self) -> float | None:
        return self.mean("vehicles.precision", lambda r: r["track_rows"])

    @property
    def idf1(self) -> float | None:
        return self.mean("vehicles.idf1", _true_rows)

    @property
    def hota(self) -> float | None:
        return self.mean("vehicles.hota", _true_rows)

    @property
    def speed_rmse_mps(self) -> float | None:
        known = [r["vehicles"] for r in self.records if r["vehicles"]["speed_rmse_mps"] is not None]
        pairs = sum(v["pairs"] for v in known)
        total = sum(v["pairs"] * v["speed_rmse_mps"] ** 2 for v in known)
        return math.sqrt(total / pairs) if pairs else None


def _samples(record: Record, state: str) -> float:
    return float(record["answers"][state]["samples"])


def _true_rows(record: Record) -> float:
    """Return how many true vehicles there were to find, counted at every instant."""
    return float(record["true_rows"])


def _cells(pool: Pool) -> list[str]:
    onset, dissolve = (_median(pool.delays_s(f"{k}_delay_s")) for k in ("onset", "dissolve"))
    return [
        *(_number(pool.eoq_m(p)) for p in (50, 95, 100)),
        _number(pool.eoq_m(50, "strict")),
        _share(pool.inside_2_sigma, 0),
        _share(pool.missed),
        _share(pool.false),
        _number(onset, 1, signed=True),
        _number(dissolve, 1, signed=True),
        _share(pool.unknown),
        *(_share(s) for s in (pool.recall, pool.precision)),
        *(_number(n) for n in (pool.idf1, pool.hota)),
        _number(pool.speed_rmse_mps),
    ]


def target_rows(figures: dict[str, ByName], speed: ByName) -> list[list[str]]:
    """Return a row for each figure to reach, with what each variant reaches."""
    rows = [["figure", "reach", *(f"`{variant}`" for variant in figures)]]
    pools = [[r for r in by_name.values() if good(r)] for by_name in figures.values()]
    for name, reach, measure, shown in TARGETS:
        cells = (_judged(measure(records), reach, shown) for records in pools)
        rows.append([name, _reach(reach, shown), *cells])
    return [*rows, *_speed_rows(speed, len(figures))]


Reach = tuple[str, float]  # "≤" or "≥", and the bound
Measure = Callable[[list[Record]], float | None]
Shown = Callable[[float], str]


def _exact(records: list[Record]) -> Pool:
    return Pool([r for r in records if r["exact_telemetry"]])


def _biased(records: list[Record]) -> Pool:
    return Pool([r for r in records if not r["exact_telemetry"]])


def _aside_m(records: list[Record]) -> float | None:
    aside = [r["vehicles"]["left_bias_m"] for r in _biased(records).records]
    return max((abs(a) for a in aside if a is not None), default=None)


def _false_alarms(records: list[Record]) -> float | None:
    calm = [r["episodes"]["false"] for r in records if not r["episodes"]["episodes"]]
    return float(sum(calm)) if calm else None


def _worst(key: str) -> Measure:
    def worst(records: list[Record]) -> float | None:
        return max((abs(d) for d in Pool(records).delays_s(key)), default=None)

    return worst


def _metres(value: float) -> str:
    return f"{value:.2f} m"


def _percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def _seconds(value: float) -> str:
    return f"{value:.1f} s"


TARGETS: tuple[tuple[str, Reach, Measure, Shown], ...] = (
    ("EOQ error, exact telemetry, median", ("≤", 0.5), lambda r: _exact(r).eoq_m(50), _metres),
    ("EOQ error, exact telemetry, p95", ("≤", 3.0), lambda r: _exact(r).eoq_m(95), _metres),
    ("EOQ error, biased telemetry, median", ("≤", 2.5), lambda r: _biased(r).eoq_m(50), _metres),
    ("sideways error, biased telemetry (vehicles' median, worst)", ("≤", 0.5), _aside_m, _metres),
    ("missed while queued in view", ("≤", 0.01), lambda r: Pool(r).missed, _percent),
    ("false while free", ("≤", 0.002), lambda r: Pool(r).false, _percent),
    ("false alarms in scenarios without queue", ("≤", 0), _false_alarms, lambda v: f"{v:.0f}"),
    (
        "onset delay, median",
        ("≤", 2.0),
        lambda r: _median(Pool(r).delays_s("onset_delay_s")),
        _seconds,
    ),
    ("onset delay, worst", ("≤", 2.0), _worst("onset_delay_s"), _seconds),
    (
        "dissolve delay, median",
        ("≤", 2.0),
        lambda r: _median(Pool(r).delays_s("dissolve_delay_s")),
        _seconds,
    ),
    ("dissolve delay, worst", ("≤", 2.0), _worst("dissolve_delay_s"), _seconds),
    ("truth inside 2 σ", ("≥", 0.95), lambda r: Pool(r).inside_2_sigma, _percent),
    ("vehicle recall", ("≥", 0.97), lambda r: Pool(r).recall, _percent),
    ("vehicle precision", ("≥", 0.97), lambda r: Pool(r).precision, _percent),
    ("IDF1", ("≥", 0.95), lambda r: Pool(r).idf1, lambda v: f"{v:.3f}"),
    ("speed RMSE", ("≤", 0.5), lambda r: Pool(r).speed_rmse_mps, lambda v: f"{v:.2f} m/s"),
)


def _speed_rows(speed: ByName, variants: int) -> list[list[str]]:
    """Return the rows of throughput and memory, which are the `road` preset's."""

    def row(name: str, reach: Reach, value: float | None, shown: Shown) -> list[str]:
        blank = [NOTHING] * (variants - 1)
        return [name, _reach(reach, shown), _judged(value, reach, shown), *blank]

    rows = []
    for key, limit_mb in (("speed", 400.0), ("speed_4k", 1000.0)):
        record = speed.get(key, {})
        if "methods" not in record:
            continue
        road, video = record["methods"]["road"], record["video"]
        size = f"{video['width_px']}×{video['height_px']}"
        if key == "speed":
            for ratio in record["ratios"]:
                full = ratio["slow"].endswith(f" {video['width_px']} px")
                name = f"{size}: speed ÷ {ratio['slow']}, whole run"
                rows.append(row(name, ("≥", 10.0 if full else 4.0), ratio["whole"], _times))
            name = f"{size}: time ÷ decode only"
            for which, words in (("whole_", "whole run"), ("", "without the closing report")):
                times = road[f"{which}times_decode"]
                rows.append(row(f"{name}, {words}", ("≤", 2.5), times, _times))
        else:
            pace = {k: m["rate_hz"] / video["frame_rate_hz"] for k, m in record["methods"].items()}
            name = f"{size}: × real time (decode only: {pace['decode only']:.1f})"
            rows.append(row(name, ("≥", 1.0), pace["road"], _times))
        name = f"{size}: peak memory of the process"
        rows.append(row(name, ("≤", limit_mb), road["peak_mb"], lambda v: f"{v:.0f} MB"))
    return rows


def _times(value: float) -> str:
    return f"{value:.2g} ×" if value < 10 else f"{value:.1f} ×"


def _reach(reach: Reach, shown: Shown) -> str:
    return f"{reach[0]} {shown(reach[1])}"


def _judged(value: float | None, reach: Reach, shown: Shown) -> str:
    if value is None:
        return NOTHING
    met = value <= reach[1] if reach[0] == "≤" else value >= reach[1]
    return f"{shown(value)} {'✓' if met else '✗'}"


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None


def _number(value: float | None, digits: int = 2, signed: bool = False) -> str:
    if value is None:
        return NOTHING
    return f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}"


def _share(value: float | None, digits: int = 1) -> str:
    return NOTHING if value is None else f"{100 * value:.{digits}f} %"


def _safe(text: str) -> str:
    """Return text that cannot break a Markdown table."""
    return text.replace("|", "/").replace("\n", " ")


def _block(command: str, title: str, rows: list[list[str]]) -> str:
    width = len(rows[0])
    lines = [" | ".join(row + [""] * (width - len(row))) for row in rows]
    rule = " | ".join(["---", *["---:"] * (width - 1)])
    table = "\n".join(f"| {line} |" for line in [lines[0], rule, *lines[1:]])
    return f"### {title}\n```console\n{command}\n```\n{table}"
