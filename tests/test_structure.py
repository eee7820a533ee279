"""The house keeps its shape: a pure core, a pipeline on one screen, folders two deep."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parent.parent / "src" / "queuetail"
CORE = ("geo", "vision", "tracking", "traffic")
# The core may know itself, the records and the error; everything else of ours is an edge.
CORE_MAY_KNOW = {f"queuetail.{name}" for name in (*CORE, "types", "errors")}
EDGE_MODULES = {
    *("pathlib", "io", "os", "sys", "shutil", "tempfile", "glob", "subprocess", "socket"),
    *("time", "datetime", "threading", "multiprocessing", "concurrent", "asyncio", "queue"),
    *("logging", "print", "av", "rich", "argparse", "tomllib", "json", "csv", "urllib"),
    *("matplotlib", "jinja2", "PIL", "pydantic", "random"),
}
EDGE_CALLS = {"print", "open", "input", "exec", "eval", "breakpoint"}
EDGE_OF_LIBRARIES = {
    *("imread", "imwrite", "VideoCapture", "VideoWriter", "imshow", "waitKey", "FileStorage"),
    *("loadtxt", "savetxt", "fromfile", "tofile", "memmap", "genfromtxt"),
}
SCREEN_LINES = 60
MODULE_LINES = 400  # "a few hundred"
core_modules = sorted(p for name in CORE for p in (SOURCE / name).glob("*.py"))


def imported(tree: ast.AST) -> Iterator[tuple[str, int]]:
    """Yield the absolute name and line of everything that a module imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            module = node.module or ""
            whole = module in ("", "queuetail")
            for alias in node.names:
                yield (f"{module}.{alias.name}" if whole else module), node.lineno


def faults(path: Path) -> list[str]:
    """Say where a core module reaches for an edge."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for name, line in imported(tree):
        ours = name.split(".")[0] == "queuetail"
        known = ours and any(name == k or name.startswith(f"{k}.") for k in CORE_MAY_KNOW)
        if (ours and not known) or name.split(".")[0] in EDGE_MODULES:
            found.append(f"{path.name}:{line} imports {name}")
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in EDGE_CALLS:
                found.append(f"{path.name}:{node.lineno} calls {node.func.id}()")
        elif isinstance(node, ast.Attribute) and node.attr in EDGE_OF_LIBRARIES:
            found.append(f"{path.name}:{node.lineno} uses {node.attr}")
    return found


@pytest.mark.parametrize("path", core_modules, ids=lambda p: f"{p.parent.name}/{p.name}")
def test_the_core_reaches_for_no_edge(path: Path) -> None:
    assert faults(path) == []


@pytest.mark.parametrize(
    ("code", "fault"),
    [
        ("import time", "imports time"),
        ("from pathlib import Path", "imports pathlib"),
        ("import os.path", "imports os.path"),
        ("from queuetail.video import VideoFile", "imports queuetail.video"),
        ("from queuetail import cli", "imports queuetail.cli"),
        ("import queuetail.config", "imports queuetail.config"),
        ("def f():\n    from queuetail.run import run", "imports queuetail.run"),
        ("print('x')", "calls print()"),
        ("open('x')", "calls open()"),
        ("import cv2\ncv2.imwrite('x', y)", "uses imwrite"),
    ],
)
def test_the_guard_sees_every_kind_of_fault(tmp_path: Path, code: str, fault: str) -> None:
    path = tmp_path / "core.py"
    path.write_text(code, encoding="utf-8")
    assert len(faults(path)) == 1
    assert fault in faults(path)[0]


def test_the_guard_lets_the_core_know_itself(tmp_path: Path) -> None:
    path = tmp_path / "core.py"
    path.write_text("from queuetail.types import Frame\nimport numpy\n", encoding="utf-8")
    assert faults(path) == []


def test_the_records_and_the_error_know_nothing_of_ours() -> None:
    for name in ("types.py", "errors.py"):
        tree = ast.parse((SOURCE / name).read_text(encoding="utf-8"))
        assert [n for n, _ in imported(tree) if n.startswith("queuetail")] == []


def test_the_pipelines_step_fits_a_screen() -> None:
    tree = ast.parse((SOURCE / "pipeline.py").read_text(encoding="utf-8"))
    steps = [n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef) and n.name == "step"]
    assert len(steps) == 1
    assert (steps[0].end_lineno or 0) - steps[0].lineno < SCREEN_LINES


def test_functions_fit_a_screen_and_modules_stay_small() -> None:
    long_ones = []
    for path in SOURCE.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if len(text.splitlines()) > MODULE_LINES:
            long_ones.append(f"{path.name} has {len(text.splitlines())} lines")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or 0) - node.lineno + 1
                if lines > SCREEN_LINES:
                    long_ones.append(f"{path.name}: {node.name} has {lines} lines")
    assert long_ones == []


def test_folders_are_two_deep_at_most() -> None:
    deep = [p for p in SOURCE.rglob("*.py") if len(p.relative_to(SOURCE).parts) > 2]
    assert deep == []


def test_no_module_is_imported_in_a_circle_at_the_top() -> None:
    """geo knows no other part of the core; vision, tracking and traffic know geo."""
    for path in (SOURCE / "geo").glob("*.py"):
        names = {n for n, _ in imported(ast.parse(path.read_text(encoding="utf-8")))}
        assert not {n for n in names if n.startswith(("queuetail.vision", "queuetail.tr"))}
