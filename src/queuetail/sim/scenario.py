"""Scenario files: what road, traffic, flight, picture and telemetry a simulated flight has.

Every key has a default, so that a named scenario is a few lines; docs/simulator.md lists them all.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from queuetail.config import MPS_PER_MPH, parse_settings, read_toml
from queuetail.settings import Finite, LatLon, Settings

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, le=1)]

Cause = Literal["none", "flagger", "signal", "lane_drop", "incident", "moving_bottleneck", "waves"]

CAPACITY_VPH_PER_LANE = 2200.0  # HCM: the most that a freeway lane carries at the entrance


class Road(Settings):
    """`[road]`: shape and looks of the carriageway under watch."""

    lanes: Annotated[int, Field(ge=1, le=6)] = 2
    lane_width_m: Annotated[float, Field(ge=2.5, le=5)] = 3.6
    shoulder_m: Annotated[float, Field(ge=0, le=6)] = 2.5
    course_deg: Finite = 165.0
    bend_radius_m: Finite = 0.0
    grade_percent: Annotated[float, Field(ge=-10, le=10)] = 0.0
    asphalt: Literal["dark", "light"] = "dark"
    markings: Literal["new", "worn"] = "new"
    concrete_joints: bool = False
    ramp: Literal["none", "on", "off"] = "none"
    ramp_at_m: Finite = -20.0

    @model_validator(mode="after")
    def _bends_gently(self) -> Road:
        if self.bend_radius_m and abs(self.bend_radius_m) < 60:
            raise ValueError(
                f"bend_radius_m = {self.bend_radius_m:g} is tighter than 60 m; 0 means straight"
            )
        if self.ramp != "none" and self.bend_radius_m:
            raise ValueError("a ramp is drawn on straight roads only; drop ramp or bend_radius_m")
        return self


class Queue(Settings):
    """`[traffic.queue]`, `[opposite.queue]`: what makes the queue, where and when."""

    cause: Cause = "none"
    start_s: Finite = 12.0
    duration_s: Positive = 60.0
    at_m: Annotated[float, Field(ge=-400, le=800)] = 90.0
    crawl_mph: Annotated[float, Field(ge=0.5, le=60)] = 8.0
    period_s: Annotated[float, Field(ge=5, le=600)] = 50.0
    red_share: Annotated[float, Field(gt=0, lt=1)] = 0.6


class Traffic(Settings):
    """`[traffic]`: who drives on the approach under watch."""

    demand_vph: NotNegative = 1600.0
    truck_share: Share = 0.12
    posted_speed_mph: Annotated[float, Field(ge=10, le=90)] = 55.0
    queue_speed_mph: Annotated[float, Field(ge=1, le=60)] | None = None
    slow_vehicle_mph: Annotated[float, Field(ge=2, le=60)] | None = None
    parked: Annotated[int, Field(ge=0, le=40)] = 0
    queue: Queue = Queue()

    @property
    def queue_speed_mps(self) -> float:
        """The speed below which a vehicle counts as queued: given, or a third of the limit."""
        mph = self.queue_speed_mph or self.posted_speed_mph / 3
        return mph * MPS_PER_MPH


class Opposite(Settings):
    """`[opposite]`: the other carriageway; 0 lanes for none."""

    lanes: Annotated[int, Field(ge=0, le=6)] = 0
    median_m: Annotated[float, Field(ge=0.3, le=60)] = 6.0
    demand_vph: NotNegative = 1400.0
    truck_share: Share = 0.12
    queue: Queue = Queue()


class Flight(Settings):
    """`[flight]`: where the drone hovers, how it looks and how it is shaken."""

    height_m: Annotated[float, Field(ge=15, le=500)] = 110.0
    hfov_deg: Annotated[float, Field(ge=10, le=120)] = 84.0
    pitch_deg: Annotated[float, Field(ge=-90, le=-25)] = -55.0
    heading_to_road_deg: Finite = -90.0
    aim_m: Annotated[float, Field(ge=-300, le=300)] = 0.0
    aim_left_m: Annotated[float, Field(ge=-200, le=200)] = 0.0
    jitter_m: Annotated[float, Field(ge=0, le=5)] = 0.15
    jitter_deg: Annotated[float, Field(ge=0, le=3)] = 0.06
    drift_mps: Annotated[float, Field(ge=0, le=2)] = 0.0
    drift_course_deg: Finite = 0.0
    gust_m: Annotated[float, Field(ge=0, le=10)] = 0.0
    gust_deg: Annotated[float, Field(ge=0, le=10)] = 0.0
    yaw_correction_deg: Annotated[float, Field(ge=-60, le=60)] = 0.0
    yaw_correction_at_s: Finite = 30.0
    yaw_correction_s: Positive = 3.0


class Picture(Settings):
    """`[picture]`: the camera's sensor, the light and the codec."""

    width_px: Annotated[int, Field(ge=160, le=3840, multiple_of=2)] = 1280
    height_px: Annotated[int, Field(ge=90, le=2160, multiple_of=2)] = 720
    frame_rate_hz: Annotated[float, Field(ge=1, le=60)] = 30.0
    interval_jitter: Annotated[float, Field(ge=0, le=0.4)] = 0.0
    dropped_share: Annotated[float, Field(ge=0, le=0.5)] = 0.0
    codec: Literal["h264", "h265"] = "h264"
    bit_rate_kbps: Annotated[float, Field(ge=50, le=100_000)] | None = None
    noise: Annotated[float, Field(ge=0, le=30)] = 2.0
    brightness: Annotated[float, Field(ge=0.1, le=2)] = 1.0
    brightness_change: Annotated[float, Field(ge=0, le=0.6)] = 0.0
    clouds: Share = 0.0
    cloud_speed_mps: NotNegative = 8.0
    sun_azimuth_deg: Finite = 220.0
    sun_elevation_deg: Annotated[float, Field(ge=3, le=90)] = 48.0
    shadow: Share = 0.6
    tree_shadows: Annotated[int, Field(ge=0, le=60)] = 0
    haze: Share = 0.1
    land: Literal["grass", "dry", "fields"] = "grass"
    occluder: Literal["none", "gantry", "bridge"] = "none"
    occluder_at_m: Annotated[float, Field(ge=-400, le=400)] = 0.0


class Telemetry(Settings):
    """`[telemetry]`: how often the log speaks and how wrong it is."""

    position_rate_hz: Annotated[float, Field(gt=0, le=60)] = 10.0
    attitude_rate_hz: Annotated[float, Field(gt=0, le=60)] = 10.0
    gps_walk_m: Annotated[float, Field(ge=0, le=20)] = 0.0
    height_error_m: Annotated[float, Field(ge=-20, le=20)] = 0.0
    heading_bias_deg: Annotated[float, Field(ge=-20, le=20)] = 0.0
    pitch_bias_deg: Annotated[float, Field(ge=-10, le=10)] = 0.0
    time_offset_s: Annotated[float, Field(ge=-10, le=10)] = 0.0
    gaps: tuple[tuple[Finite, Finite], ...] = ()
    klv: bool = False

    @model_validator(mode="after")
    def _gaps_are_ordered(self) -> Telemetry:
        for start_s, end_s in self.gaps:
            if end_s <= start_s:
                raise ValueError(f"a gap from {start_s:g} s to {end_s:g} s ends before it starts")
        return self


class Info(Settings):
    """`[scenario]`: its name, length and place."""

    name: Annotated[str, Field(min_length=1)] = "unnamed"
    description: str = ""
    duration_s: Annotated[float, Field(gt=0, le=1800)] = 75.0
    origin: LatLon = (36.110190, -97.056800)
    start_utc: str = "2026-06-01T14:00:00Z"
    seed: Annotated[int, Field(ge=0, lt=2**31)] = 1


class Scenario(Settings):
    """A whole scenario file."""

    scenario: Info = Info()
    road: Road = Road()
    traffic: Traffic = Traffic()
    opposite: Opposite = Opposite()
    flight: Flight = Flight()
    picture: Picture = Picture()
    telemetry: Telemetry = Telemetry()

    @model_validator(mode="after")
    def _can_flow(self) -> Scenario:
        sides = [("traffic", self.road.lanes, self.traffic.demand_vph, self.traffic.queue)]
        if self.opposite.lanes:
            sides.append(
                ("opposite", self.opposite.lanes, self.opposite.demand_vph, self.opposite.queue)
            )
        for table, lanes, demand_vph, queue in sides:
            if demand_vph > CAPACITY_VPH_PER_LANE * lanes:
                raise ValueError(
                    f"[{table}] demand_vph = {demand_vph:g} is beyond the capacity at the "
                    f"entrance: {lanes} lane(s) carry at most {CAPACITY_VPH_PER_LANE * lanes:g}"
                )
            if queue.cause in ("lane_drop", "incident") and lanes < 2:
                raise ValueError(
                    f"[{table}.queue] cause = '{queue.cause}' needs two lanes or more, "
                    f"the road has {lanes}"
                )
        if self.traffic.parked and self.road.shoulder_m < 2.0:
            raise ValueError(
                f"[traffic] parked needs a shoulder of 2 m or more, "
                f"[road] shoulder_m is {self.road.shoulder_m:g}"
            )
        return self


def read_scenario(path: Path) -> Scenario:
    """Read a scenario file; raises InputError with the file, the key and the mend."""
    raw = read_toml(path, "scenario file")
    raw.setdefault("scenario", {})
    if isinstance(raw["scenario"], dict):
        raw["scenario"].setdefault("name", path.stem)
    return parse_settings(Scenario, raw, str(path))
