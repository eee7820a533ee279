"""Fixtures of the evaluation's tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from fabricated import Bench


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """Writes truths and runs into a temporary folder."""
    return Bench(tmp_path)
