"""The drone's true pose over time, and the ground plane that its camera sees."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from queuetail.geo.camera import camera_matrix, intrinsics_from_hfov, project, rotation_enu_camera
from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.sim.axis import VIEW_STATION_M, Axis
from queuetail.sim.scenario import Flight, Road, Scenario
from queuetail.types import CameraPose, Floats, Intrinsics, Origin

GUST_EVERY_S = 11.0
GUST_WIDTH_S = 1.1
CHANNELS = 6  # east, north, up, yaw, pitch, roll


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """Height of the ground over ENU (0, 0): a plane that rises along the road by its grade."""

    rise_east: float
    rise_north: float

    @classmethod
    def of(cls, road: Road) -> GroundPlane:
        """Return the plane of a scenario's road."""
        course = math.radians(road.course_deg)
        grade = road.grade_percent / 100
        return cls(grade * math.sin(course), grade * math.cos(course))

    def height_m(self, enu: Floats) -> Floats:
        """Return the ground's height, (..., 2) -> (...)."""
        return np.asarray(self.rise_east * enu[..., 0] + self.rise_north * enu[..., 1])


@dataclass(frozen=True, slots=True)
class View:
    """One instant's camera over one ground plane: exact projection by queuetail.geo."""

    pose: CameraPose
    origin: Origin
    plane: GroundPlane

    @property
    def camera_enu(self) -> Floats:
        """East, north and height of the camera in metres, (3,)."""
        pose = self.pose
        place = enu_from_geodetic(np.array(pose.lat_deg), np.array(pose.lon_deg), self.origin)
        return np.array([place[0], place[1], pose.height_agl_m])

    def px_of(self, enu_up: Floats) -> Floats:
        """Project ENU points with height above ENU (0, 0)'s ground, (n, 3) -> (n, 2)."""
        camera = self.camera_enu
        return project(enu_up - [camera[0], camera[1], 0.0], self.pose)

    def ground_px(self, enu: Floats) -> Floats:
        """Project ground points, (n, 2) -> (n, 2)."""
        return self.px_of(np.column_stack([enu, self.plane.height_m(enu)]))

    def ground_homography(self) -> Floats:
        """Return the homography from ENU on the ground plane to pixels (w > 0 in front)."""
        pose = self.pose
        R = rotation_enu_camera(pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
        camera = self.camera_enu
        lift = np.array(
            [
                [1.0, 0.0, -camera[0]],
                [0.0, 1.0, -camera[1]],
                [self.plane.rise_east, self.plane.rise_north, -camera[2]],
            ]
        )
        return np.asarray(camera_matrix(pose.intrinsics) @ R.T @ lift)


def true_lens(scenario: Scenario) -> Intrinsics:
    """Return the lens that draws the flight."""
    picture = scenario.picture
    return intrinsics_from_hfov(picture.width_px, picture.height_px, scenario.flight.hfov_deg)


class TruePath:
    """The true pose at any time: hover jitter (sums of sinusoids), drift, gusts, correction."""

    def __init__(self, scenario: Scenario, seed: int) -> None:
        rng = np.random.default_rng([seed, 11])
        self._flight = scenario.flight
        self._lens = true_lens(scenario)
        self._origin = Origin(*scenario.scenario.origin)
        self._plane = GroundPlane.of(scenario.road)
        self._base, self._yaw_deg = _hover(scenario)
        rates_hz = np.array([0.03, 0.07, 0.16, 0.31, 0.62, 1.3])
        self._omega = 2 * np.pi * rates_hz * rng.uniform(0.8, 1.25, (CHANNELS, len(rates_hz)))
        self._phase = rng.uniform(0, 2 * np.pi, self._omega.shape)
        weight = np.array([1.0, 0.8, 0.6, 0.4, 0.2, 0.1])
        self._weight = weight / np.sqrt(0.5 * (weight**2).sum())
        count = int(scenario.scenario.duration_s / GUST_EVERY_S) + 2
        self._gust_at_s = GUST_EVERY_S * (np.arange(count) + rng.uniform(0.2, 0.8, count))
        self._gust_sway = rng.normal(0, 1, (count, CHANNELS))
        self._gust_phase = rng.uniform(0, 2 * np.pi, count)

    def view(self, t_s: float) -> View:
        """Return the exact view at a time."""
        flight = self._flight
        sway = np.sin(self._omega * t_s + self._phase) @ self._weight
        move_m, turn_deg = sway[:3] * flight.jitter_m, sway[3:] * flight.jitter_deg
        gust = self._gust(t_s)
        move_m = move_m * [1, 1, 0.5] + gust[:3] * flight.gust_m * [1, 1, 0.3]
        turn_deg = turn_deg + gust[3:] * flight.gust_deg * [0.6, 1, 0.5]
        course = math.radians(flight.drift_course_deg)
        drift_m = flight.drift_mps * t_s
        east = self._base[0] + move_m[0] + drift_m * math.sin(course)
        north = self._base[1] + move_m[1] + drift_m * math.cos(course)
        lat, lon = geodetic_from_enu(np.array([east, north]), self._origin)
        yaw_deg = self._yaw_deg + float(turn_deg[0]) + self._correction_deg(t_s)
        pose = CameraPose(
            lat_deg=float(lat),
            lon_deg=float(lon),
            height_agl_m=flight.height_m + float(move_m[2]),
            yaw_deg=yaw_deg % 360.0,
            pitch_deg=max(flight.pitch_deg + float(turn_deg[1]), -90.0),
            roll_deg=float(turn_deg[2]),
            intrinsics=self._lens,
        )
        return View(pose, self._origin, self._plane)

    def _gust(self, t_s: float) -> Floats:
        envelope = np.exp(-0.5 * ((t_s - self._gust_at_s) / GUST_WIDTH_S) ** 2)
        swing = np.cos(1.7 * (t_s - self._gust_at_s) + self._gust_phase)
        return np.asarray((envelope * swing) @ self._gust_sway)

    def _correction_deg(self, t_s: float) -> float:
        flight = self._flight
        done = (t_s - flight.yaw_correction_at_s) / flight.yaw_correction_s
        done = min(max(done, 0.0), 1.0)
        return flight.yaw_correction_deg * done * done * (3 - 2 * done)


def _hover(scenario: Scenario) -> tuple[tuple[float, float], float]:
    """Return where the drone hovers (east, north) and its yaw, so that it looks at the aim."""
    flight, road = scenario.flight, scenario.road
    axis = Axis.of(road)
    middle_m = flight.aim_left_m - 0.5 * road.lanes * road.lane_width_m
    aim = axis.enu(np.array(VIEW_STATION_M + flight.aim_m), np.array(middle_m))
    yaw_deg = road.course_deg + flight.heading_to_road_deg
    away = 0.0
    if flight.pitch_deg > -90:
        away = flight.height_m / math.tan(math.radians(-flight.pitch_deg))
    yaw = math.radians(yaw_deg)
    return (float(aim[0]) - away * math.sin(yaw), float(aim[1]) - away * math.cos(yaw)), yaw_deg


def look(scenario: Scenario, flight: Flight | None = None) -> View:
    """Return the view of a drone that hovers without any motion: what a scenario aims for."""
    still = (flight or scenario.flight).model_copy(
        update={"jitter_m": 0.0, "jitter_deg": 0.0, "gust_m": 0.0, "gust_deg": 0.0}
    )
    return TruePath(scenario.model_copy(update={"flight": still}), 0).view(0.0)
