"""Real video, with site files measured by hand: there is traffic on it, and no queue."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from statistics import median

import pytest

from queuetail.run import run

MPS_PER_MPH = 0.44704
# Of each approach: vehicles at least, and between which speeds (mph) half of them are faster.
CLIPS = {
    "04_opencv4nodejs_overhead": {"far": (10, 25, 40), "near": (10, 8, 22)},
    "05_cvtrafficcam_parked_cars": {},  # hardly anybody drives by: parked cars are what it is for
    "06_dvrscan_motorway": {"oncoming": (15, 45, 75), "away": (20, 18, 35)},
}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("name", CLIPS)
def test_a_clip_without_a_queue_has_none(
    name: str, shared: Path, root: Path, tmp_path: Path
) -> None:
    site = root / "examples" / "clips" / f"{name}.toml"
    video = shared / "clips" / f"{name}.mp4"
    run(video, site_file=site, out=tmp_path, with_video=False)
    said = [r["status"] for r in rows(tmp_path / "queue.csv")]
    assert set(said) <= {"clear", "unknown"}
    # The first second, and another one where the recording itself has a gap.
    assert said.count("unknown") < 0.06 * len(said)
    tracks = rows(tmp_path / "tracks.csv")
    for approach, (least, slow, fast) in CLIPS[name].items():
        speeds: dict[str, list[float]] = {}
        for r in tracks:
            if r["approach"] == approach:
                speeds.setdefault(r["track_id"], []).append(float(r["speed_mps"]) / MPS_PER_MPH)
        assert len(speeds) >= least
        assert slow < median(median(of_one) for of_one in speeds.values()) < fast


def without_approaches(site: Path) -> str:
    """Return a site file's text that says where things are, but of no road."""
    parts = re.split(r"(?m)^(?=\[)", site.read_text(encoding="utf-8"))
    return "".join(p for p in parts if not p.startswith("[[approach]]"))


@pytest.mark.parametrize(
    ("name", "found"), [("05_cvtrafficcam_parked_cars", "WB"), ("06_dvrscan_motorway", "SB")]
)
def test_a_real_road_is_found_from_few_vehicles_and_its_lines(
    name: str, found: str, shared: Path, root: Path, tmp_path: Path
) -> None:
    site = tmp_path / "measured.toml"
    site.write_text(without_approaches(root / "examples" / "clips" / f"{name}.toml"), "utf-8")
    run(shared / "clips" / f"{name}.mp4", site_file=site, out=tmp_path / "run", with_video=False)
    told = rows(tmp_path / "run" / "queue.csv")
    assert {r["status"] for r in told} == {"clear", "unknown"}
    assert found in {r["approach"] for r in told}
