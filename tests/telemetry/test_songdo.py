"""A real nadir flight: how far plain telemetry misses vehicles whose true places are known."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.telemetry import read_telemetry
from queuetail.types import CameraPose, Floats, Origin

WIDTH_PX, HEIGHT_PX = 3840, 2160
EVERY_NTH_FRAME = 10


def true_places(folder: Path) -> tuple[Floats, Floats]:
    """Box centres in pixels and latitude, longitude of the same vehicles, (n, 2) each."""
    with (folder / "results_U_video_cut.csv").open() as file:
        places = {
            (row["Frame_Number"], row["Vehicle_ID"]): (row["Latitude"], row["Longitude"])
            for row in csv.DictReader(file)
            if int(row["Frame_Number"]) % EVERY_NTH_FRAME == 0
        }
    with (folder / "results_U_video_cut.txt").open() as file:
        boxes = {(row[0], row[1]): (row[2], row[3]) for row in csv.reader(file)}
    both = sorted(places.keys() & boxes.keys())
    return (
        np.array([boxes[key] for key in both], float),
        np.array([places[key] for key in both], float),
    )


def test_scale_and_centre_with_one_fitted_yaw(shared: Path) -> None:
    folder = shared / "songdo"
    sample = read_telemetry(folder / "U_video_cut.csv").at(2.5)
    assert sample.lat_deg is not None
    assert sample.lon_deg is not None
    assert sample.height_agl_m is not None
    assert sample.hfov_deg is not None
    px, lat_lon = true_places(folder)
    origin = Origin(sample.lat_deg, sample.lon_deg)
    true_enu = enu_from_geodetic(lat_lon[:, 0], lat_lon[:, 1], origin)

    def located(points: Floats, yaw_deg: float) -> Floats:
        lens = intrinsics_from_hfov(WIDTH_PX, HEIGHT_PX, sample.hfov_deg or 0.0)
        pose = CameraPose(
            origin.lat_deg, origin.lon_deg, sample.height_agl_m or 0.0, yaw_deg, -90.0, 0.0, lens
        )
        return px_to_enu(mapping_from_pose(pose, origin), points)

    # The only thing fitted is yaw: the angle that turns one centred cloud onto the other.
    a, b = (as_complex(enu) for enu in (located(px, 0.0), true_enu))
    turn = np.vdot(a - a.mean(), b - b.mean())
    yaw_deg = -math.degrees(np.angle(turn)) % 360
    ours = as_complex(located(px, yaw_deg))
    scale = (np.vdot(b - b.mean(), ours - ours.mean()) / np.vdot(b - b.mean(), b - b.mean())).real
    centre = as_complex(located(np.array([[WIDTH_PX / 2, HEIGHT_PX / 2]]), yaw_deg))[0]
    true_centre = b.mean() + (centre - ours.mean()) / scale
    centre_error_m = abs(centre - true_centre)
    error_m = np.abs(ours - b)
    facts = (
        f"{len(px)} places, yaw {yaw_deg:.2f}°: scale error {100 * (scale - 1):+.2f} %, centre "
        f"{centre_error_m:.2f} m off, vehicles {np.median(error_m):.2f} m off in the median, "
        f"{error_m.max():.2f} m at most"
    )
    print(facts)
    assert len(px) > 1000, facts
    assert abs(scale - 1) < 0.04, facts
    assert centre_error_m < 8, facts
    assert scale == pytest.approx(1.019, abs=0.003), facts


def as_complex(enu: Floats) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    return np.asarray(enu[:, 0] + 1j * enu[:, 1])
