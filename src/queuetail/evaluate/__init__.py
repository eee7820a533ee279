"""Evaluation: a run measured against ground truth; docs/evaluation.md defines every figure."""

from __future__ import annotations

from importlib.util import find_spec

from queuetail.errors import InputError

if find_spec("motmetrics") is None or find_spec("scipy") is None:
    raise InputError(
        "evaluation needs motmetrics and scipy; in the project's folder run `make setup-dev`, "
        "or pip install '.[evaluate]'"
    )

from queuetail.evaluate.compare import evaluate
from queuetail.evaluate.records import Evaluation
from queuetail.evaluate.report import evaluation_figures, write_report
from queuetail.evaluate.table import print_table, to_json

__all__ = [
    "Evaluation",
    "evaluate",
    "evaluation_figures",
    "print_table",
    "to_json",
    "write_report",
]
