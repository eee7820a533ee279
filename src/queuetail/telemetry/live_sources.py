"""Telemetry as it comes: one interface for the radio, MAVLink, DJI, JSON and a growing table."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

from queuetail.errors import InputError
from queuetail.link.messages import Quantity, Status
from queuetail.onboard import sources
from queuetail.onboard.mavlink import LISTENER
from queuetail.onboard.source import Source, SourceState, Stamp
from queuetail.telemetry.live_csv import CsvSource
from queuetail.telemetry.live_radio import RadioSource
from queuetail.telemetry.live_sample import SampleBuilder
from queuetail.types import TelemetrySample

# (what was said, its UTC where the sender knows it, when it arrived on the monotonic clock); the
# sample's t_s is the best estimate of when it was measured, on the same monotonic clock.
OnSample = Callable[[TelemetrySample, datetime | None, float], None]

SPECS = (
    "radio:/dev/ttyUSB0[:9600]",
    "mavlink:udpin:HOST:PORT",
    "mavlink:/dev/ttyACM0[:115200]",
    "dji-mqtt://HOST:PORT/SN",
    "json-udp:PORT",
    "csv:FILE",
)


class LiveSource:
    """A source of telemetry in its own thread, which reconnects by itself."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._builder = SampleBuilder()
        self._on_sample: OnSample = lambda sample, utc, arrived_s: None
        self._link_status: Status | None = None
        self.name = source.name

    def start(self, on_sample: OnSample) -> None:
        """Start hearing; `on_sample` is called from the source's thread."""
        self._on_sample = on_sample
        self._source.start(self._take)

    def stop(self) -> None:
        """Stop hearing and wait for the thread."""
        self._source.stop()

    @property
    def state(self) -> SourceState:
        """Whether it is heard, how often it came back, and the last error."""
        return self._source.state

    @property
    def link_status(self) -> Status | None:
        """What the drone's end of our radio link said last of its rates and sensors."""
        return self._link_status

    @property
    def link_losses(self) -> dict[str, int]:
        """Counts of our radio link: messages, bad frames, lost ones, bytes skipped; else empty."""
        return self._source.losses if isinstance(self._source, RadioSource) else {}

    def _take(self, quantity: Quantity, stamp: Stamp) -> None:
        if isinstance(quantity, Status):
            self._link_status = quantity
            return
        sample = self._builder.sample(quantity, stamp.measured_s)
        if sample is not None:
            utc = None if stamp.utc_s is None else datetime.fromtimestamp(stamp.utc_s, UTC)
            self._on_sample(sample, utc, stamp.arrived_s)


def open_source(spec: str) -> LiveSource:
    """Return the source that `spec` names, not yet started; raises InputError where it names none.

    What is not there yet (a radio that is not plugged in, a broker that is down) is no error: the
    source waits for it.
    """
    if spec.startswith("dji-mqtt://") or spec.startswith("dji-mqtts://"):
        return LiveSource(sources.mqtt(spec.removeprefix("dji-")))
    kind, colon, rest = spec.partition(":")
    makers: dict[str, Callable[[str], Source]] = {
        "radio": RadioSource,
        "mavlink": lambda text: sources.mavlink(text, LISTENER),
        "json-udp": sources.json_udp,
        "csv": CsvSource,
    }
    if not colon or not rest or kind not in makers:
        raise InputError(
            f"'{spec}' is no source of live telemetry; write one of {', '.join(SPECS)}"
        )
    if kind == "radio":
        sources.needs("serial", "the radio")
    return LiveSource(makers[kind](rest))
