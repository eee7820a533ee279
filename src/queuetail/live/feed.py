"""Telemetry as a live run sees it: what was said at the time of a picture, and how old that is."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from time import monotonic
from typing import TYPE_CHECKING, Protocol

from queuetail.config import Site, TelemetryFill
from queuetail.mapping import POSE_FIELDS, corrected
from queuetail.telemetry.klv import Losses, sample_of
from queuetail.telemetry.live_log import LiveLog
from queuetail.types import TelemetrySample
from queuetail.video.stream_session import Captured, Metadata

if TYPE_CHECKING:
    from queuetail.telemetry.live_sources import LiveSource

KLV_NAME = "KLV in the video"
# Registration carries the picture's place on meanwhile; DJI's cloud API tells it every 2 s only.
LIMIT_S = 5.0
# The quantities of LiveLog that a pose needs to be kept fresh, with the fields that each one has.
NEEDED = {
    "position": "lat_deg",
    "height": "height_agl_m",
    "heading": "heading_deg",
    "gimbal_pitch": "gimbal_pitch_deg",
}

Heard = Callable[[TelemetrySample, datetime, str], None]


class TelemetryFeed(Protocol):
    """Where a live run gets its telemetry from; safe from any thread."""

    name: str

    def start(self, heard: Heard) -> None:
        """Begin to listen; `heard` is told every sample as it arrives."""

    def at(self, captured: Captured) -> TelemetrySample:
        """Return what telemetry says of the camera when the picture was taken."""

    def take(self, found: Metadata) -> None:
        """Take metadata that came within the video."""

    def ages_s(self, now_s: float) -> dict[str, float]:
        """Return the age of each quantity, by name; `now_s` is of the monotonic clock."""

    def rates_hz(self, now_s: float) -> dict[str, float]:
        """Return how often each quantity comes."""

    def too_old(self, captured: Captured) -> tuple[str, ...]:
        """Return a sentence for what is too old to be believed; empty where all is well."""

    def warnings(self) -> tuple[str, ...]:
        """Return a sentence for each thing that is wrong with the telemetry's source."""

    def adjust(self, site: Site) -> None:
        """Take the offsets of other settings."""

    def close(self) -> None:
        """Stop listening."""


class NoFeed:
    """For sites that are known by control points: telemetry has nothing to add."""

    name = "none"

    def start(self, heard: Heard) -> None:
        """Do nothing."""

    def at(self, captured: Captured) -> TelemetrySample:
        """Return an empty sample."""
        return TelemetrySample(captured.frame.t_s)

    def take(self, found: Metadata) -> None:
        """Do nothing."""

    def ages_s(self, now_s: float) -> dict[str, float]:
        """Return nothing."""
        return {}

    def rates_hz(self, now_s: float) -> dict[str, float]:
        """Return nothing."""
        return {}

    def too_old(self, captured: Captured) -> tuple[str, ...]:
        """Return nothing: nothing is needed."""
        return ()

    def warnings(self) -> tuple[str, ...]:
        """Return nothing."""
        return ()

    def adjust(self, site: Site) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class RecordedFeed(NoFeed):
    """A flight log beside a recording that is played as if it came live."""

    def __init__(
        self, log: Callable[[float], TelemetrySample], name: str, site: Site | None = None
    ) -> None:
        """Take a log's `at`, in seconds after the first picture, corrected by `site` already."""
        self._at = log
        self.name = name
        self._corrected_by = site.telemetry if site is not None else TelemetryFill()
        self._more = TelemetryFill()

    def at(self, captured: Captured) -> TelemetrySample:
        """Return what the log says at that place of the recording."""
        sample = corrected(self._at(captured.media_s), self._more)
        return replaced_time(sample, captured.frame.t_s)

    def adjust(self, site: Site) -> None:
        """Add what the offsets of other settings differ by."""
        new, old = site.telemetry, self._corrected_by
        self._more = TelemetryFill(
            heading_offset_deg=(new.heading_offset_deg - old.heading_offset_deg + 180) % 360 - 180,
            pitch_offset_deg=new.pitch_offset_deg - old.pitch_offset_deg,
            height_offset_m=new.height_offset_m - old.height_offset_m,
        )


class LiveFeed:
    """A live source (a radio, MAVLink, DJI, JSON), or the KLV inside the video."""

    def __init__(self, source: LiveSource | None, site: Site) -> None:
        """Take a source that is not yet started; None means the video's own KLV."""
        self.name = KLV_NAME if source is None else source.name
        self._source = source
        self._offset_s = site.telemetry.offset_s
        self._correction = site.telemetry
        self._constants = site_constants(site)
        self._log = LiveLog(constants=self._constants)
        self._heard: Heard = lambda sample, utc, name: None
        self._losses = Losses()

    def start(self, heard: Heard) -> None:
        """Begin to listen."""
        self._heard = heard
        if self._source is not None:
            self._source.start(self._take)

    def at(self, captured: Captured) -> TelemetrySample:
        """Return what telemetry says of the moment when the picture was taken."""
        sample = self._log.at(captured.captured_s - self._offset_s)
        return replaced_time(corrected(sample, self._correction), captured.frame.t_s)

    def take(self, found: Metadata) -> None:
        """Take KLV from the video, where that is the source."""
        if self._source is None:
            for packet in found.packets:
                sample, _ = sample_of(packet, found.captured_s)
                self._take(sample, None, found.captured_s)

    def ages_s(self, now_s: float) -> dict[str, float]:
        """Return the age of each quantity that was ever heard."""
        return self._log.ages(now_s - self._offset_s)

    def rates_hz(self, now_s: float) -> dict[str, float]:
        """Return how often each quantity came of late."""
        return self._log.rates(now_s - self._offset_s)

    def too_old(self, captured: Captured) -> tuple[str, ...]:
        """Return a sentence on the quantities that were silent for too long."""
        ages = self.ages_s(captured.captured_s)
        old = [
            name
            for name, field in NEEDED.items()
            if ages.get(name, 0.0) > LIMIT_S and field not in self._constants
        ]
        if not old:
            return ()
        oldest_s = max(ages[name] for name in old)
        words = ", ".join(name.replace("_", " ") for name in old)
        return (f"telemetry is {oldest_s:.0f} s old ({words})",)

    def warnings(self) -> tuple[str, ...]:
        """Say what the source complains about, and which quantities are late."""
        found = []
        if self._source is not None and self._source.state.error:
            found.append(f"{self.name}: {self._source.state.error}")
        now_s = monotonic()
        for name, age_s in self.ages_s(now_s).items():
            if name in NEEDED and age_s > LIMIT_S and NEEDED[name] not in self._constants:
                found.append(f"{name.replace('_', ' ')} has not been heard for {age_s:.0f} s")
        return tuple(found)

    def adjust(self, site: Site) -> None:
        """Add the offsets of other settings from now on."""
        self._correction, self._offset_s = site.telemetry, site.telemetry.offset_s

    def close(self) -> None:
        """Stop listening."""
        if self._source is not None:
            self._source.stop()

    def _take(self, sample: TelemetrySample, utc: datetime | None, arrived_s: float) -> None:
        self._log.add(sample, arrived_s)
        self._heard(sample, utc or datetime.now(UTC), self.name)


def site_constants(site: Site) -> dict[str, float]:
    """Return what the site file says of the pose, for what telemetry never tells."""
    constants = site.telemetry.constants
    if site.camera.hfov_deg is not None:
        constants["hfov_deg"] = site.camera.hfov_deg
    return constants


def needs_telemetry(site: Site) -> bool:
    """Return whether the site file leaves anything of the pose to telemetry."""
    return not site.control_point and not set(POSE_FIELDS) <= site_constants(site).keys()


def replaced_time(sample: TelemetrySample, t_s: float) -> TelemetrySample:
    """Return the sample at another time."""
    return TelemetrySample(
        t_s,
        sample.lat_deg,
        sample.lon_deg,
        sample.height_agl_m,
        sample.heading_deg,
        sample.gimbal_pitch_deg,
        sample.gimbal_roll_deg,
        sample.hfov_deg,
    )
