"""Kill a recording live run again and again, and read what is left: kill_recording.py [--count N].

`queuetail live --realtime --record` gets the bundled flight and is killed with SIGKILL after a
random time.  Printed is how long before the kill the last frame was taken that can be replayed,
which counts the run's own delay, too; and whether the replay gives the recorded answers again.
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
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic, sleep

import numpy as np

from queuetail.live.replay import replay

FLAGGER = Path(__file__).resolve().parent.parent / "examples" / "flagger"
START_WITHIN_S = 60.0


@dataclass(frozen=True, slots=True)
class Trial:
    """One kill and what was left."""

    ran_s: float  # from the recording's first bytes to the kill
    frames: int  # that could be replayed
    lost_s: float  # from the last of them to the kill
    is_same: bool


def trials(
    folder: Path, count: int, seed: int, least_s: float = 2.0, most_s: float = 14.0
) -> Iterator[Trial]:
    """Yield one trial after the other; each kills a run of its own."""
    rng = random.Random(seed)
    for k in range(count):
        yield _trial(folder / f"{k:02d}", rng.uniform(least_s, most_s))


def _trial(parent: Path, run_s: float) -> Trial:
    """Run, kill `run_s` after the video's first bytes are on the disk, and replay."""
    command = [sys.executable, "-m", "queuetail.cli", "live", str(FLAGGER / "flight.mp4")]
    command += ["--telemetry", str(FLAGGER / "telemetry.csv"), "--realtime", "--loop"]
    command += ["--site", str(FLAGGER / "site.toml"), "--no-store", "--port", "0"]
    child = subprocess.Popen([*command, "--record", str(parent)], stdout=subprocess.DEVNULL)
    end_s = monotonic() + START_WITHIN_S
    while not any(p.stat().st_size for p in parent.glob("*/video-*")):
        if child.poll() is not None or monotonic() > end_s:
            raise RuntimeError("the live run did not begin to record")
        sleep(0.01)
    sleep(run_s)
    killed_utc = datetime.now(UTC)
    child.send_signal(signal.SIGKILL)
    child.wait()
    result = replay(parent)
    last_utc = max(f.utc for f in result.recording.frames if f.t_s <= result.duration_s)
    lost_s = (killed_utc - last_utc).total_seconds()
    return Trial(run_s, result.frames, lost_s, result.is_same)


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
