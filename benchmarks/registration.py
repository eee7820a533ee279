"""Time the registration stage alone, on frames held in memory: `registration.py [VIDEO]`.

Prints the milliseconds of processor time per frame at 1280×720 and 3840×2160 on one core; the 4K
frames are the 720p ones enlarged.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from queuetail.types import Image
from queuetail.video import VideoFile
from queuetail.vision.register import GroundRegistration

FLAGGER = Path(__file__).resolve().parent.parent / "examples" / "flagger" / "flight.mp4"
FRAMES = 240
SIZES = ((1280, 720), (3840, 2160))


def frames_of(path: Path) -> list[tuple[float, Image]]:
    """Decode the first frames of a video."""
    video = VideoFile(path)
    kept = []
    for frame in video.frames():
        kept.append((frame.t_s, frame.luma.copy()))
        if len(kept) == FRAMES:
            break
    video.close()
    return kept


def times_ms(frames: list[tuple[float, Image]], size: tuple[int, int]) -> list[float]:
    """Register all frames, scaled to a size, and return how long each took."""
    registration = GroundRegistration(*size)
    taken = []
    for t_s, luma in frames:
        scaled = cv2.resize(luma, size, interpolation=cv2.INTER_LINEAR)
        begin = time.thread_time()
        registration.register(scaled, t_s)
        taken.append(1e3 * (time.thread_time() - begin))
    return taken[1:]


def main() -> None:
    """Print a row per size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path, nargs="?", default=FLAGGER)
    cv2.setNumThreads(1)
    frames = frames_of(parser.parse_args().video)
    print(f"{len(frames)} frames: ms per frame, the first (which picks features) left out")
    for size in SIZES:
        p50, p95, p100 = np.percentile(times_ms(frames, size), [50, 95, 100])
        print(f"{size[0]}×{size[1]}  median {p50:.2f}  p95 {p95:.2f}  most {p100:.2f}")


if __name__ == "__main__":
    main()
