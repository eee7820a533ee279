"""A short version of benchmarks/end_to_end.py: camera, radio and live run, all real processes."""

from __future__ import annotations

from pathlib import Path

from broadcast import write_live_flight
from end_to_end import run_live
from short_flight import cut_flight


def test_rtsp_and_the_radio_give_the_flights_own_place_and_time(
    flagger: Path, tmp_path: Path
) -> None:
    short = cut_flight(flagger / "flight.mp4", tmp_path / "flight.mp4", 4.0)
    clip = write_live_flight(short, tmp_path / "flight.ts", group=10)
    flown = run_live(tmp_path, clip, 3.5, lead_s=2.0)
    assert len(flown.rows) > 5
    assert flown.rows[-1].t_s < 3.5
    assert flown.place_off_m < 0.2
    assert flown.heading_off_deg < 0.1
