"""Kill a recording run again and again, and read what is left: `kill_recording.py [--count N]`.

The run gets the bundled flight, paced in real time, and is killed with SIGKILL after a random time.
Printed is how much the recording lacks of what the run had processed when it was killed, and
whether the replay of what is left gives the recorded answers again.
"""

from __future__ import annotations

import argparse
import random
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import numpy as np

from queuetail.live.recording import find_recording
from queuetail.live.replay import replay

ROOT = Path(__file__).resolve().parent.parent
RUN = ROOT / "tests" / "live" / "live_run.py"
START_WITHIN_S = 60.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One kill and what was left."""

    ran_s: float  # from the first answer to the kill
    answered_s: float  # the time of the newest answer that the run reported before the kill
    frames: int  # that could be replayed
    lost_s: float  # of answered frames, at the end
    is_same: bool


def trials(
    folder: Path, count: int, seed: int, least_s: float = 2.0, most_s: float = 14.0
) -> Iterator[Trial]:
    """Yield one trial after the other; each kills a run of its own."""
    rng = random.Random(seed)
    for k in range(count):
        yield _trial(folder / f"{k:02d}", rng.uniform(least_s, most_s))


def _trial(parent: Path, run_s: float) -> Trial:
    """Run, kill after `run_s` of answers, and replay."""
    child = subprocess.Popen(
        [sys.executable, str(RUN), str(parent)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None
    begun_s, answered_s = monotonic(), 0.0
    end_s = begun_s + START_WITHIN_S
    for line in child.stdout:
        if answered_s == 0.0:
            end_s = monotonic() + run_s
        answered_s = float(line)
        if monotonic() >= end_s:
            break
    child.send_signal(signal.SIGKILL)
    rest = [float(line) for line in child.stdout.read().split()]  # said before it was killed
    child.wait()
    child.stdout.close()
    answered_s = max([answered_s, *rest])
    result = replay(find_recording(parent))
    return Trial(run_s, answered_s, result.frames, answered_s - result.duration_s, result.is_same)


def main() -> None:
    """Print a row per kill, and the worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    lost = []
    with tempfile.TemporaryDirectory() as folder:
        print("kill   ran s   frames back   s lost   replay")
        for k, trial in enumerate(trials(Path(folder), arguments.count, arguments.seed), 1):
            lost.append(trial.lost_s)
            same = "the same" if trial.is_same else "DIFFERS"
            print(
                f"{k:4d}  {trial.ran_s:6.2f}  {trial.frames:12d}  {trial.lost_s:7.3f}   {same}",
                flush=True,
            )
    print(f"lost: median {np.median(lost):.3f} s, most {max(lost):.3f} s of {len(lost)} kills")


if __name__ == "__main__":
    main()
