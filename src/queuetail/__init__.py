"""queuetail: where is the end of the traffic queue?

The shortest program prints it once a second:

    from pathlib import Path
    from queuetail import Observation, run_flight

    def show(seen: Observation) -> None:
        for state in seen.states:
            if state.eoq is not None and seen.frame_index % 30 == 0:
                print(f"{seen.t_s:.0f} s: {state.eoq.lat_deg:.6f}, {state.eoq.lon_deg:.6f}")

    flight = Path("examples/flagger")
    run_flight(flight / "flight.mp4", flight / "telemetry.csv", flight / "site.toml",
               out=Path("out/first"), with_video=False, progress=show)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from queuetail.config import Site, read_site
    from queuetail.errors import InputError
    from queuetail.evaluate import evaluate as evaluate_run
    from queuetail.locate import locate as locate_pixel
    from queuetail.run import run as run_flight
    from queuetail.telemetry import read_telemetry
    from queuetail.types import Observation

__version__ = "0.1.0"
__all__ = [
    "InputError",
    "Observation",
    "Site",
    "evaluate_run",
    "locate_pixel",
    "read_site",
    "read_telemetry",
    "run_flight",
]

# Looked up on first use, so that `import queuetail` does not load the video libraries.
_HOMES = {
    "InputError": ("queuetail.errors", "InputError"),
    "Observation": ("queuetail.types", "Observation"),
    "Site": ("queuetail.config", "Site"),
    "evaluate_run": ("queuetail.evaluate", "evaluate"),
    "locate_pixel": ("queuetail.locate", "locate"),
    "read_site": ("queuetail.config", "read_site"),
    "read_telemetry": ("queuetail.telemetry", "read_telemetry"),
    "run_flight": ("queuetail.run", "run"),
}


def __getattr__(name: str) -> object:
    """Return a public name from the module where it lives (PEP 562)."""
    if name not in _HOMES:
        raise AttributeError(f"module 'queuetail' has no attribute '{name}'")
    module, attribute = _HOMES[name]
    return getattr(import_module(module), attribute)
