"""Fixtures shared by all tests."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).resolve().parent.parent
SHARED_DATA = ROOT.parent / "shared" / "data"

# How long an example takes depends on who else uses the machine.
settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")


@pytest.fixture(scope="session")
def root() -> Path:
    """The project's root folder."""
    return ROOT


@pytest.fixture(scope="session")
def shared() -> Path:
    """The folder of real clips and telemetry that lies beside the project; skips without it."""
    if not SHARED_DATA.is_dir():
        pytest.skip("the folder ../shared/data with real clips and telemetry is not here")
    return SHARED_DATA


@pytest.fixture(scope="session")
def flagger(root: Path) -> Path:
    """The bundled flight: video, telemetry and exact truth."""
    return root / "examples" / "flagger"
