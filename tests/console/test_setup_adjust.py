"""A live run goes on with other settings, and keeps its own where they do not fit."""

from __future__ import annotations

from pathlib import Path
from threading import Event

import pytest

from queuetail.config import Site, parse_settings, read_site
from queuetail.errors import InputError
from queuetail.live.feed import RecordedFeed
from queuetail.live.open_feed import open_feed
from queuetail.live.records import OutletHealth, OutletState, Published
from queuetail.live.runtime import LiveRun
from queuetail.video.stream_source import parse_source

WAIT_S = 30.0


class Taker:
    """Keeps the newest answer, and tells when one has what is waited for."""

    def __init__(self) -> None:
        self.newest: Published | None = None
        self.arrived = Event()
        self.wanted: str = ""

    def offer(self, published: Published) -> None:
        self.newest = published
        if any(a.name == self.wanted for a in published.observation.approaches):
            self.arrived.set()

    def health(self) -> OutletHealth:
        return OutletHealth("taker", OutletState.OK)

    def close(self) -> None:
        """Nothing is open."""

    def wait_for(self, approach: str) -> Published:
        self.arrived.clear()
        self.wanted = approach
        assert self.arrived.wait(WAIT_S)
        assert self.newest is not None
        return self.newest


def test_a_run_goes_on_with_another_road_and_offsets(flagger: Path) -> None:
    site = read_site(flagger / "site.toml")
    source = parse_source(str(flagger / "flight.mp4"), realtime=True, loop=True)
    feed = open_feed(str(flagger / "telemetry.csv"), source, site)
    assert isinstance(feed, RecordedFeed)
    run, taker = LiveRun(source, feed, site), Taker()
    run.subscribe(taker)
    run.start()
    try:
        first = taker.wait_for("SB")
        assert first.telemetry is not None
        raw = site.model_dump()
        raw["approach"][0]["name"] = "south"
        raw["telemetry"]["height_offset_m"] = 4.0
        run.adjust(parse_settings(Site, raw, "new"))
        second = taker.wait_for("south")
        assert second.telemetry is not None
        assert (second.telemetry.height_agl_m or 0) - (first.telemetry.height_agl_m or 0) == (
            pytest.approx(4.0, abs=0.5)
        )
        local = [{"px": [u, v], "enu_m": [0.0, 0.0]} for u, v in ((0, 0), (1, 0), (0, 1), (1, 1))]
        with pytest.raises(InputError, match="control_point"):
            run.adjust(parse_settings(Site, {"control_point": local}, "bad"))
        taker.wait_for("south")
    finally:
        run.stop()
    assert run.refused is None
