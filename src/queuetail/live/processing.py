"""The thread that looks at pictures: the newest one, through the same pipeline as a recording's."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Lock, Thread
from time import monotonic

from queuetail.config import Site
from queuetail.errors import InputError
from queuetail.geo.earth import distance_m
from queuetail.live.blind import blind_observation, disbelieved
from queuetail.live.feed import TelemetryFeed
from queuetail.live.mailbox import Mailbox
from queuetail.mapping import site_origin
from queuetail.pace import Pace
from queuetail.pipeline import Pipeline
from queuetail.presets import Build
from queuetail.types import Approach, Observation, Origin, TelemetrySample
from queuetail.video.stream_session import Captured

LOG = logging.getLogger(__name__)

POLL_S = 0.25
STALE_S = 1.0  # an answer to an older picture is not given
ELSEWHERE_M = 20_000.0  # from the site's road: no drone sees so far
NO_PLACE = "telemetry has not told yet where the drone is"


@dataclass(frozen=True, slots=True)
class Answer:
    """What one picture told."""

    captured: Captured
    telemetry: TelemetrySample
    observation: Observation
    doubts: tuple[str, ...] = ()  # why the pipeline's own states were not believed


class Processor:
    """Takes the newest picture, steps the pipeline, and gives each answer to `publish`."""

    def __init__(
        self,
        frames: Mailbox[Captured],
        feed: TelemetryFeed,
        site: Site,
        build: Build,
        publish: Callable[[Answer], None],
        fault: Callable[[str, str], None],
    ) -> None:
        """`fault` keeps or clears a named warning."""
        self._frames, self._feed, self._site = frames, feed, site
        self._build, self._publish, self._fault = build, publish, fault
        self._origin = site_origin(site)
        self._names = tuple(a.name for a in site.approach)
        self._pipeline: Pipeline | None = None
        self._size = (0, 0)
        self._pace = Pace(0.0)  # all pictures, until there is something that looks at them
        self._lock = Lock()
        self._busy_since_s: float | None = None
        self._approaches: tuple[Approach, ...] = ()
        self._closing = Event()
        self._adjusted: Site | None = None  # settings that the next picture is looked at with
        self.refused: InputError | None = None  # the site file does not fit the pictures
        self._thread = Thread(target=self._work, name="processing", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def close(self, patience_s: float) -> None:
        """Stop after the present picture; a step that hangs is left behind."""
        self._closing.set()
        self._frames.close()
        if self._thread.ident is not None:
            self._thread.join(patience_s)

    def adjust(self, site: Site) -> None:
        """Begin anew with other settings at the next picture; raises InputError and changes nothing
        where they do not fit the pictures.
        """
        origin = self._origin_by(site)
        if self._size != (0, 0) and (origin is not None or site.control_point):
            self._build(site, origin, *self._size, lambda stage: None)
        with self._lock:
            self._adjusted = site

    def busy_s(self) -> float:
        """Return for how long the present picture is being looked at; 0 while waiting for one."""
        with self._lock:
            return 0.0 if self._busy_since_s is None else monotonic() - self._busy_since_s

    def blind(self, t_s: float, reason: str) -> Observation:
        """Return an unknown state for every approach that is known by now."""
        with self._lock:
            approaches = self._approaches
        return blind_observation(approaches, self._names, t_s, reason)

    def _work(self) -> None:
        while not self._closing.is_set():
            captured = self._frames.take(POLL_S)
            if captured is None or not self._pace.takes(captured.frame.t_s):
                continue
            with self._lock:
                self._busy_since_s = monotonic()
            try:
                self._look(captured)
            except InputError as error:
                self.refused = error
                return
            except Exception as error:  # one picture's trouble must not end a day's watch
                LOG.exception("processing")
                self._fault("processing", f"processing failed and began anew: {error!r}")
                self._pipeline = None
            finally:
                with self._lock:
                    self._busy_since_s = None

    def _look(self, captured: Captured) -> None:
        frame = captured.frame
        self._take_settings()
        telemetry = self._feed.at(captured)
        pipeline = self._ready(captured, telemetry)
        if pipeline is None:
            self._publish(Answer(captured, telemetry, self.blind(frame.t_s, NO_PLACE)))
            return
        observation = pipeline.step(frame, telemetry)
        with self._lock:
            self._approaches = observation.approaches
        doubts = (*self._feed.too_old(captured), *_elsewhere(self._site, telemetry))
        age_s = monotonic() - captured.arrived_s
        if age_s > STALE_S:
            doubts = (*doubts, f"the answer took {age_s:.1f} s, too long to be believed")
        self._publish(Answer(captured, telemetry, disbelieved(observation, doubts), doubts))

    def _take_settings(self) -> None:
        with self._lock:
            site, self._adjusted = self._adjusted, None
            if site is None:
                return
            self._names, self._approaches = tuple(a.name for a in site.approach), ()
        self._origin = self._origin_by(site)
        self._site, self._pipeline = site, None

    def _origin_by(self, site: Site) -> Origin | None:
        """Return the settings' own origin, else the one that telemetry gave."""
        origin = site_origin(site)
        return self._origin if origin is None and not site.control_point else origin

    def _ready(self, captured: Captured, telemetry: TelemetrySample) -> Pipeline | None:
        """Return the pipeline; a new one for pictures of another size, none without a place."""
        if self._origin is None and not self._site.control_point:
            if telemetry.lat_deg is None or telemetry.lon_deg is None:
                return None
            self._origin = Origin(telemetry.lat_deg, telemetry.lon_deg)
        if self._pipeline is None or captured.frame.size != self._size:
            self._size = captured.frame.size
            self._pipeline = self._build(self._site, self._origin, *self._size, lambda stage: None)
            self._pace = Pace(self._pipeline.longest_s)
        return self._pipeline


def _elsewhere(site: Site, told: TelemetrySample) -> tuple[str, ...]:
    """Return a sentence where the drone is nowhere near the site's road; else nothing."""
    place = site_origin(site)
    if place is None or told.lat_deg is None or told.lon_deg is None:
        return ()
    away_m = distance_m(place.lat_deg, place.lon_deg, told.lat_deg, told.lon_deg)
    if away_m < ELSEWHERE_M:
        return ()
    return (
        f"the drone is {away_m / 1000:.0f} km from the site file's road: "
        "is it the file of another place?",
    )
