"""A written site file is read back as the road that it was written from."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from queuetail.config import Site as SiteFile
from queuetail.config import parse_settings, read_site
from queuetail.mapping import site_approaches
from queuetail.site_writer import site_toml
from queuetail.types import Approach, Origin

AXIS = np.array([[0.0, 0.0], [3.0, 20.0], [8.0, 41.0], [8.0, 41.0000001]])
ROAD = (Approach("NB", AXIS, 120.0, 2, 3.25), Approach("SB", AXIS[::-1] + 8.0, 0.0, 1, 3.5))


ORIGIN = Origin(36.11306, -97.05883)


def test_round_trip(tmp_path: Path) -> None:
    path = tmp_path / "site.toml"
    path.write_text(site_toml(ROAD, ORIGIN, "I-35 NB", 65.0), encoding="utf-8")
    site = read_site(path)
    assert site.site.name == "I-35 NB"
    assert site.site.posted_speed_mph == 65.0
    back = site_approaches(site, ORIGIN)
    assert [(a.name, a.lanes, a.start_station_m) for a in back] == [
        ("NB", 2, 120.0),
        ("SB", 1, 0.0),
    ]
    for written, read in zip(ROAD, back, strict=True):
        assert read.lane_width_m == pytest.approx(written.lane_width_m)
        assert read.axis_enu[0] == pytest.approx(written.axis_enu[0], abs=0.003)
        assert read.axis_enu[-1] == pytest.approx(written.axis_enu[-1], abs=0.003)


def test_an_unposted_speed_is_left_out() -> None:
    assert "posted_speed_mph" not in site_toml(ROAD, ORIGIN, "x", None)


@settings(max_examples=40, deadline=None)
@given(name=st.text(st.characters(exclude_categories=["Cs"]), max_size=30))
def test_any_name_is_kept(name: str) -> None:
    raw = tomllib.loads(site_toml(ROAD, ORIGIN, name, None))
    assert parse_settings(SiteFile, raw, "written").site.name == name
