"""How fast a preset is beside decoding alone: python benchmarks/decode_ratio.py VIDEO [...].

Both loops run in one process on the same file, in turns, so that the machine's other work hits
both; the medians' ratio is what counts.  No sink is open: only decoding and the pipeline are timed.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from statistics import median
from time import perf_counter

from queuetail.config import Site, read_site
from queuetail.flight import open_flight
from queuetail.presets import PRESETS
from queuetail.video import VideoFile


def decode_rate_hz(video: Path) -> float:
    """Return frames per second of decoding with the luma plane left where it is."""
    started, frames = perf_counter(), 0
    with VideoFile(video) as file:
        for _ in file.frames():
            frames += 1
    return frames / (perf_counter() - started)


def preset_rate_hz(video: Path, telemetry: Path | None, site: Site, preset: str) -> float:
    """Return frames per second of decoding and the preset's pipeline."""
    started, frames = perf_counter(), 0
    with open_flight(video, telemetry, site) as flight:
        size = flight.video.width_px, flight.video.height_px
        pipeline = PRESETS[preset](site, flight.origin, *size, lambda stage: None)
        for frame in flight.frames():
            pipeline.step(frame, flight.telemetry_at(frame.t_s))
            frames += 1
    return frames / (perf_counter() - started)


def main() -> None:
    """Time both loops in turns and print a Markdown row each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("video", type=Path)
    parser.add_argument("--telemetry", type=Path)
    parser.add_argument("--site", type=Path)
    parser.add_argument("--preset", choices=sorted(PRESETS), default="paper")
    parser.add_argument("--turns", type=int, default=3)
    arguments = parser.parse_args()
    site = read_site(arguments.site) if arguments.site else Site()
    decode: list[float] = []
    preset: list[float] = []
    for _ in range(arguments.turns):
        decode.append(decode_rate_hz(arguments.video))
        preset.append(preset_rate_hz(arguments.video, arguments.telemetry, site, arguments.preset))
    print("| what | frames/s (median) | ratio to decode-only |\n|---|---|---|")
    print(f"| decode only | {median(decode):.0f} | 1 |")
    share = median(preset) / median(decode)
    print(f"| `{arguments.preset}` | {median(preset):.0f} | {share:.3f} (1 : {1 / share:.1f}) |")


if __name__ == "__main__":
    main()
