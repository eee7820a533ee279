"""Draw one picture of every scenario into one sheet.

python benchmarks/contact_sheet.py benchmarks/scenarios docs/images/scenarios.jpg
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from queuetail.sim.flight import TruePath
from queuetail.sim.render import Renderer
from queuetail.sim.scenario import Scenario, read_scenario
from queuetail.sim.traffic import simulate_traffic
from queuetail.types import Image

MOMENT = 0.62  # of the flight's duration
TILE = 480, 270
COLUMNS = 4
QUALITY = 72


def picture_of(scenario: Scenario, moment: float = MOMENT) -> Image:
    """Return one frame of a scenario in full resolution, BGR."""
    seed, t_s = scenario.scenario.seed, moment * scenario.scenario.duration_s
    renderer = Renderer(scenario, simulate_traffic(scenario, seed), TruePath(scenario, seed), seed)
    return np.asarray(cv2.cvtColor(renderer.frame_yuv(0, t_s), cv2.COLOR_YUV2BGR_I420))


def tile_of(scenario: Scenario) -> Image:
    """Return a small labelled picture of a scenario."""
    tile = cv2.resize(picture_of(scenario), TILE, interpolation=cv2.INTER_AREA)
    cv2.rectangle(tile, (0, 0), (10 + 10 * len(scenario.scenario.name), 26), (40, 40, 40), -1)
    font, white = cv2.FONT_HERSHEY_SIMPLEX, (255, 255, 255)
    cv2.putText(tile, scenario.scenario.name, (6, 19), font, 0.5, white, 1, cv2.LINE_AA)
    return np.asarray(tile)


def main() -> None:
    """Read the scenarios, draw the sheet."""
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    tiles = [tile_of(read_scenario(path)) for path in sorted(folder.glob("*.toml"))]
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[i : i + COLUMNS]) for i in range(0, len(tiles), COLUMNS)]
    out.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, QUALITY])


if __name__ == "__main__":
    main()
