"""The same flight as an MPEG transport stream with MISB ST 0601 metadata (KLV) beside the video."""

from __future__ import annotations

from collections import deque
from datetime import datetime
from fractions import Fraction
from pathlib import Path

import av
from stanag4609 import encode_uas_local_set

from queuetail.sim.log import TAKEOFF_ALTITUDE_M, Known, last_known
from queuetail.sim.scenario import Scenario
from queuetail.types import TelemetrySample

CLOCK = Fraction(1, 90_000)
LOCAL_SET_VERSION = 19  # ST 0601.19
TIME, HEADING, LATITUDE, LONGITUDE, ALTITUDE, HFOV = 2, 5, 13, 14, 15, 16
AZIMUTH, ELEVATION, ROLL, CENTRE_ELEVATION = 18, 19, 20, 25
VERSION, PLATFORM_PITCH, PLATFORM_ROLL = 65, 90, 91


def local_set(known: Known, start_us: int) -> bytes:
    """Return one ST 0601 packet: a level platform that heads north, and the gimbal's angles."""
    items = {
        TIME: start_us + round(known.t_s * 1e6),
        HEADING: 0.0,
        LATITUDE: known.lat_deg,
        LONGITUDE: known.lon_deg,
        ALTITUDE: known.height_agl_m + TAKEOFF_ALTITUDE_M,
        HFOV: known.hfov_deg,
        AZIMUTH: known.heading_deg % 360.0,
        ELEVATION: known.gimbal_pitch_deg,
        ROLL: known.gimbal_roll_deg % 360.0,
        CENTRE_ELEVATION: TAKEOFF_ALTITUDE_M,
        VERSION: LOCAL_SET_VERSION,
        PLATFORM_PITCH: 0.0,
        PLATFORM_ROLL: 0.0,
    }
    return bytes(encode_uas_local_set(items))


def write_transport_stream(
    scenario: Scenario, samples: list[TelemetrySample], video: Path, out: Path
) -> None:
    """Copy the encoded video into a transport stream and interleave the metadata by time."""
    start = datetime.fromisoformat(scenario.scenario.start_utc.replace("Z", "+00:00"))
    told = [known for known in last_known(samples) if known.t_s >= 0]
    with av.open(str(video)) as source, av.open(str(out), "w", format="mpegts") as target:
        pictures = source.streams.video[0]
        copy = target.add_stream_from_template(pictures)
        metadata = target.add_data_stream("klv")
        metadata.time_base = CLOCK
        start_us = round(start.timestamp() * 1e6)
        waiting = deque(told)
        for packet in source.demux(pictures):
            if packet.dts is None:
                continue
            while waiting and waiting[0].t_s <= packet.dts * packet.time_base:
                known = waiting.popleft()
                datum = av.Packet(local_set(known, start_us))
                datum.stream, datum.time_base = metadata, CLOCK
                datum.pts = datum.dts = round(known.t_s / CLOCK)
                target.mux(datum)
            packet.stream = copy
            target.mux(packet)
