"""Live telemetry by its words on the command line: radio, MAVLink, JSON, a growing table, KLV."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

import pytest
from stanag4609.st0601 import encode_uas_local_set

from link_doubles import Line, Vehicle, free_port, running, wait_for
from queuetail.errors import InputError
from queuetail.link.frames import encode
from queuetail.link.messages import (
    Attitude,
    ClockSource,
    ClockTime,
    Gimbal,
    Heading,
    Height,
    HeightSource,
    Lidar,
    Position,
    Rate,
    Sensors,
    Status,
)
from queuetail.telemetry.live_log import LiveLog
from queuetail.telemetry.live_sample import SampleBuilder, klv_reading
from queuetail.telemetry.live_sources import open_source
from queuetail.types import TelemetrySample

UTC_S = 1_780_322_400.0


class Samples:
    """Keeps what a live source says."""

    def __init__(self) -> None:
        self.all: list[tuple[TelemetrySample, datetime | None, float]] = []
        self.log = LiveLog()

    def __call__(self, sample: TelemetrySample, utc: datetime | None, arrived_s: float) -> None:
        self.all.append((sample, utc, arrived_s))
        self.log.add(sample, arrived_s)

    def values(self, field: str) -> list[float]:
        found = [getattr(sample, field) for sample, _, _ in self.all]
        return [value for value in found if value is not None]


@pytest.fixture
def line(tmp_path: Path) -> Iterator[Line]:
    line = Line(tmp_path / "ttyRADIO")
    yield line
    line.unplug()


def test_the_radio_with_garbage_and_unplugged(line: Line) -> None:
    heard = Samples()
    source = open_source(f"radio:{line.name}:9600")
    source.start(heard)
    numbers = iter(range(10_000))
    started_s = time.monotonic()

    def say(*quantities: object) -> None:
        for quantity in quantities:
            sent_s = time.monotonic() - started_s + 500
            line.write(encode(quantity, sent_s, next(numbers)))  # type: ignore[arg-type]

    def positions(count: int) -> bool:
        say(ClockTime(UTC_S + time.monotonic() - started_s, ClockSource.GPS))
        say(Position(36.0, -97.0), Gimbal(75.0, -55.0, 0.0), Height(110.0, HeightSource.LIDAR))
        line.write(b"POS\x08garbage\xff GMB")
        return len(heard.values("lat_deg")) >= count

    wait_for(lambda: positions(5), "positions")
    assert source.state.is_heard
    say(Status(85, Sensors.LIDAR, (Rate("POS", 10.0, 4.0),)))
    wait_for(lambda: source.link_status, "the status")
    line.unplug()
    wait_for(lambda: source.state.error, "the loss to be seen")
    before = len(heard.values("lat_deg"))
    line.plug_in()
    wait_for(lambda: positions(before + 5), "positions after it came back")
    source.stop()
    assert source.link_status is not None
    assert source.link_status.rates[0].is_reduced
    assert source.link_losses["messages"] > 10
    assert source.link_losses["skipped_bytes"] > 0
    sample, utc, arrived_s = heard.all[-1]
    assert arrived_s - 2.0 < sample.t_s <= arrived_s
    assert utc is not None
    assert abs(utc.timestamp() - UTC_S - (sample.t_s - started_s)) < 1.0
    whole = heard.log.at(sample.t_s)
    assert (whole.lat_deg, whole.heading_deg, whole.height_agl_m) == (36.0, 75.0, 110.0)


def test_mavlink_on_the_ground() -> None:
    port = free_port()
    heard, vehicle = Samples(), Vehicle(port)
    source = open_source(f"mavlink:udpin:127.0.0.1:{port}")
    source.start(heard)
    with running(vehicle.run):
        wait_for(lambda: len(heard.values("height_agl_m")) > 10, "the vehicle")
        source.stop()
    newest = heard.all[-1][0].t_s
    seen = heard.log.at(newest)
    assert seen.lat_deg == pytest.approx(36.1101897)
    assert seen.heading_deg == pytest.approx(75, abs=0.01)
    assert seen.gimbal_pitch_deg == pytest.approx(-55, abs=0.01)
    assert seen.hfov_deg == 84.0
    assert seen.height_agl_m == pytest.approx(95.0 * 0.998, abs=0.2)  # the tilted rangefinder's


def test_json_on_the_ground() -> None:
    port = free_port()
    heard = Samples()
    source = open_source(f"json-udp:127.0.0.1:{port}")
    source.start(heard)
    text = json.dumps({"lat": 36.0, "lon": -97.0, "heading_deg": 75.0, "utc": "2026-06-01T14:00Z"})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as bridge:

        def say() -> bool:
            bridge.sendto(text.encode(), ("127.0.0.1", port))
            return len(heard.all) >= 2

        wait_for(say, "a sample")
    source.stop()
    assert heard.values("heading_deg")[0] == 75.0


def test_a_table_is_played_in_real_time_and_followed(tmp_path: Path) -> None:
    table = tmp_path / "telemetry.csv"
    table.write_text("utc,lat,lon,heading_deg\n2026-06-01T14:00:00Z,36.0,-97.0,75\n")
    heard = Samples()
    source = open_source(f"csv:{table}")
    source.start(heard)
    wait_for(lambda: heard.values("heading_deg"), "the first line")
    with table.open("a") as file:
        file.write("2026-06-01T14:00:00.4Z,36.1,-97.0,76\n2026-06-01T14:00:")
        file.flush()
        wait_for(lambda: len(heard.values("heading_deg")) == 2, "the line that was added")
        file.write("00.5Z,36.2,-97.0,77\n")
    wait_for(lambda: len(heard.values("heading_deg")) == 3, "the line in two pieces")
    source.stop()
    assert heard.values("heading_deg") == [75.0, 76.0, 77.0]
    headed = [(s.t_s, a) for s, _, a in heard.all if s.heading_deg is not None]
    assert headed[1][1] - headed[0][1] >= 0.39
    utc = heard.all[-1][1]
    assert utc == datetime(2026, 6, 1, 14, 0, 0, 500_000, tzinfo=UTC)


def test_the_bundled_flight_as_a_table(flagger: Path) -> None:
    heard = Samples()
    source = open_source(f"csv:{flagger / 'telemetry.csv'}")
    source.start(heard)
    wait_for(lambda: len(heard.values("height_agl_m")) >= 5, "half a second of the flight")
    source.stop()
    times = [sample.t_s for sample, _, _ in heard.all if sample.height_agl_m is not None]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx((len(times) - 1) / 10, abs=0.5)


def test_a_gimbals_heading_counts_before_the_drones() -> None:
    builder = SampleBuilder()
    assert builder.sample(Heading(10.0), 0.0) is None  # the gimbal may still tell
    lent = builder.sample(Heading(11.0), 6.0)
    assert lent is not None
    assert lent.heading_deg == 11.0
    builder.sample(Gimbal(75.0, -55.0, 0.0), 7.0)
    assert builder.sample(Heading(12.0), 60.0) is None


def test_a_height_from_the_drones_end_counts_before_ours() -> None:
    builder = SampleBuilder()
    assert builder.sample(Height(100.0, HeightSource.LIDAR), 0.0) is not None
    assert builder.sample(Lidar(50.0), 0.5) is None
    assert builder.sample(Attitude(0.0, 0.0), 0.6) is None
    ours = builder.sample(Lidar(50.0), 9.0)
    assert ours is not None
    assert ours.height_agl_m == 50.0


def test_klv_of_the_video_stream() -> None:
    when = datetime(2026, 6, 1, 14, 0, tzinfo=UTC)
    values = {2: when, 13: 36.11, 14: -97.05, 16: 84.0, 5: 80.0, 6: 0.0, 7: 0.0}
    values |= {18: 355.0, 19: -55.0, 20: 0.0, 65: 19}
    packet = encode_uas_local_set(values)
    reading = klv_reading(packet, 12.5)
    assert reading is not None
    sample, utc_s = reading
    assert sample.t_s == 12.5
    assert sample.lat_deg == pytest.approx(36.11)
    assert sample.heading_deg == pytest.approx(75, abs=0.01)
    assert utc_s == when.timestamp()
    assert klv_reading(packet[:-1] + b"\0") is None
    assert klv_reading(b"") is None


@pytest.mark.parametrize(
    "spec",
    ["", "radio", "radio:", "carrier-pigeon:7", "mavlink:udpin:x", "json-udp:many",
     "dji-mqtt://host", "csv:nothing.csv"],
)  # fmt: skip
def test_words_that_name_no_source_are_refused(spec: str) -> None:
    with pytest.raises(InputError):
        open_source(spec)


def test_a_table_of_something_else_is_refused(tmp_path: Path) -> None:
    table = tmp_path / "prices.csv"
    table.write_text("item,price\nbread,3\n")
    with pytest.raises(InputError, match="not queuetail's telemetry table"):
        open_source(f"csv:{table}")


def test_stopping_is_quick_whatever_it_waits_for(tmp_path: Path) -> None:
    port = free_port()
    before = threading.active_count()
    for spec in (f"radio:{tmp_path / 'nothing'}", f"mavlink:udpin:127.0.0.1:{port}",
                 f"dji-mqtt://127.0.0.1:{free_port(socket.SOCK_STREAM)}/SN"):  # fmt: skip
        source = open_source(spec)
        source.start(Samples())
        source.stop()
    assert threading.active_count() <= before
