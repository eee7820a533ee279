"""A vehicle driven at a known speed: what was measured of it, and the correction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from queuetail.types import Floats

LEAST_SAMPLES = 5


@dataclass(frozen=True, slots=True)
class SpeedCheck:
    """The measured speed of one vehicle against the true one."""

    track_id: int
    samples: int
    duration_s: float
    measured_mps: float  # the median
    spread_mps: float  # one standard deviation, by the median of absolute deviations
    true_mps: float

    @property
    def error_mps(self) -> float:
        """Measured less true."""
        return self.measured_mps - self.true_mps

    @property
    def factor(self) -> float:
        """What the measured speed is to be multiplied by."""
        return self.true_mps / self.measured_mps


def check_speed(
    track_id: int,
    t_s: Floats,
    speed_mps: Floats,
    true_mps: float,
    span_s: tuple[float, float] | None = None,
) -> SpeedCheck:
    """Compare one track's speeds, (n,) each, within a span of time.

    Raises ValueError where there are too few of them, or the vehicle stands.
    """
    keep = np.isfinite(speed_mps)
    if span_s is not None:
        keep &= (t_s >= span_s[0]) & (t_s <= span_s[1])
    t_s, speeds = t_s[keep], np.abs(speed_mps[keep])
    if len(speeds) < LEAST_SAMPLES:
        raise ValueError(
            f"vehicle {track_id} has {len(speeds)} measured speeds then; "
            f"{LEAST_SAMPLES} or more are needed"
        )
    measured = float(np.median(speeds))
    if measured < 0.5:
        raise ValueError(f"vehicle {track_id} stands still then: that tells nothing of speeds")
    spread = 1.4826 * float(np.median(np.abs(speeds - measured)))
    return SpeedCheck(track_id, len(speeds), float(t_s[-1] - t_s[0]), measured, spread, true_mps)
