"""Real aerial pictures of queues, as a hovering drone films them: all stands from the first."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from queuetail.config import read_site
from queuetail.geo.ground import px_to_enu
from queuetail.mapping import control_point_mapping, site_approaches
from queuetail.run import run
from queuetail.traffic.road import length_m, locate
from queuetail.types import Approach, Floats, Image
from still_film import read, write

STILLS = {
    "munich_street04": ("kit_ais_munich_street04/MOS179", ".webp", None),
    "minsk_junction": ("minsk_dji0005/DJI_0005-0018", ".jpg", 1280),
}
SECONDS, FOUND_S = 8.0, 5.0
PARKED_M = 0.8  # from the edge of the lanes: the middles of cars that are parked at the kerb
# Of each approach: how near its end is told, and which share of its vehicles is followed at least.
# Minsk's other approach goes on beyond the picture, and its last car has no label.
EXPECTED = [
    ("munich_street04", "west", 12.0, 0.5),  # its last car, a dark one, is not always believed
    ("minsk_junction", "east", 1.0, 0.6),
]


def boxes_px(labels: Path, picture: Image) -> Floats:
    """Return the labelled vehicles' (left, top, right, bottom) in pixels (n, 4)."""
    rows = np.loadtxt(labels).reshape(-1, 5)[:, 1:]
    half = rows[:, 2:] / 2
    corners = np.hstack([rows[:, :2] - half, rows[:, :2] + half])
    return np.asarray(corners * np.tile(picture.shape[1::-1], 2))


def on_lanes(approach: Approach, corners_enu: Floats) -> Floats:
    """Return rear stations and middles (n, 2) of boxes (n, 4, 2) in an approach's lanes."""
    station = np.stack([locate(approach, c)[0] for c in corners_enu])
    middle, offset, _ = locate(approach, corners_enu.mean(axis=1))
    inside = (offset < 0) & (offset > PARKED_M - approach.lanes * approach.lane_width_m)
    inside &= (middle > 0) & (middle < length_m(approach))
    return np.column_stack([station.min(axis=1), middle])[inside]


@pytest.fixture(scope="module")
def films(shared: Path, root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the run of each still."""
    outs = {}
    for name, (still, suffix, width) in STILLS.items():
        picture = read(shared / "aerial" / f"{still}{suffix}", width)
        out = tmp_path_factory.mktemp(name)
        write(picture, out / "film.mp4", SECONDS)
        site = root / "examples" / "stills" / f"{name}.toml"
        run(out / "film.mp4", site_file=site, out=out / "run", with_video=False)
        outs[name] = out / "run"
    return outs


@pytest.mark.parametrize(("name", "approach", "within_m", "least"), EXPECTED)
def test_a_queue_that_stands_in_a_real_picture_is_found_where_it_ends(
    name: str,
    approach: str,
    within_m: float,
    least: float,
    films: dict[str, Path],
    shared: Path,
    root: Path,
) -> None:
    still, suffix, width = STILLS[name]
    picture = read(shared / "aerial" / f"{still}{suffix}", width)
    site = read_site(root / "examples" / "stills" / f"{name}.toml")
    mapping = control_point_mapping(site, None, picture.shape[1], picture.shape[0])
    left, top, right, bottom = boxes_px(shared / "aerial" / f"{still}.txt", picture).T
    corners = np.stack([left, top, right, top, right, bottom, left, bottom], axis=1)
    enu = px_to_enu(mapping, corners.reshape(-1, 2)).reshape(-1, 4, 2)
    axis = next(a for a in site_approaches(site, None) if a.name == approach)
    rear_m, middle_m = on_lanes(axis, enu).T
    said = [r for r in rows(films[name] / "queue.csv") if r["approach"] == approach]
    late = [r for r in said if float(r["t_s"]) > FOUND_S]
    assert {r["status"] for r in late} <= {"queued", "beyond_view"}
    ends = np.array([float(r["eoq_station_m"]) for r in late])
    assert np.abs(ends - rear_m.min()).max() < within_m
    tracks = rows(films[name] / "tracks.csv")
    last = [r for r in tracks if r["t_s"] == tracks[-1]["t_s"] and r["approach"] == approach]
    seen = np.array([float(r["station_m"]) for r in last])
    followed = np.abs(middle_m[:, None] - seen[None]).min(axis=1) < 2.0
    told = f"{name} {approach}: {ends[-1]:.1f} m for {rear_m.min():.1f} m"
    print(f"{told}, {followed.sum()} of {len(followed)} vehicles")
    assert followed.mean() >= least


def test_the_free_way_beside_the_queue_is_not_queued(films: dict[str, Path]) -> None:
    said = [r for r in rows(films["munich_street04"] / "queue.csv") if r["approach"] == "east"]
    assert {r["status"] for r in said} <= {"clear", "unknown"}


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))
