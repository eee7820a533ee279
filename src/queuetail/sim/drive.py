"""Run SUMO in a process of its own: `python -m queuetail.sim.drive JOB.json OUT.npz`.

libsumo keeps its simulation in global state, so each simulation gets a fresh process.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import libsumo
import numpy as np

STEP_S = 0.1
YELLOW_S = 3.0
EASE_S = 8.0  # a speed limit comes down over this time, as drivers take in what is ahead
TAKE_WITHIN_M = 260.0  # a vehicle is made to stop only when it is this close to the queue's place
BRAKE_MPS2 = 2.5
WAVE_LOW_MPS = 0.6


class Carriageway:
    """One side of the road: its edges around the queue's place, and the queue's cause."""

    def __init__(self, side: dict[str, Any]) -> None:
        self._before, self._zone, _ = side["edges"]
        self._light: str = side["light"]
        self._lanes: int = side["lanes"]
        self._free_mps: float = side["free_mps"]
        self._crawl_mps: float = side["crawl_mps"]
        self._queue: dict[str, Any] = side["queue"]
        self._held: dict[int, str] = {}
        self._braked_at_s: dict[str, float] = {}

    def act(self, t_s: float) -> None:
        """Do what the queue's cause does at this time (seconds after frame 0)."""
        since_s = t_s - self._queue["start_s"]
        active = 0 <= since_s < self._queue["duration_s"]
        cause = self._queue["cause"]
        if cause in ("flagger", "signal"):
            state = self._state(since_s) if active else "G"
            libsumo.trafficlight.setRedYellowGreenState(self._light, state * self._lanes)
        elif cause in ("lane_drop", "waves", "incident"):
            limit_mps = self._limit(since_s) if active else self._free_mps
            libsumo.edge.setMaxSpeed(self._zone, limit_mps)
        if cause == "incident":
            self._hold(t_s, active, [0], 0.0)
        elif cause == "moving_bottleneck":
            self._hold(t_s, active, list(range(self._lanes)), self._crawl_mps)

    def _state(self, since_s: float) -> str:
        if self._queue["cause"] == "signal":
            since_s %= self._queue["period_s"]
            if since_s >= self._queue["red_share"] * self._queue["period_s"]:
                return "G"
        return "y" if since_s < YELLOW_S else "r"

    def _limit(self, since_s: float) -> float:
        target_mps = self._crawl_mps
        if self._queue["cause"] == "waves":
            swing = 0.5 - 0.5 * math.cos(2 * math.pi * since_s / self._queue["period_s"])
            target_mps = WAVE_LOW_MPS + (2.2 * self._crawl_mps - WAVE_LOW_MPS) * swing
        eased = min(since_s / EASE_S, 1.0)
        return self._free_mps + (target_mps - self._free_mps) * eased

    def _hold(self, t_s: float, active: bool, lanes: list[int], speed_mps: float) -> None:
        """Keep one vehicle per lane at a speed while active; let all go afterwards."""
        alive = set(libsumo.vehicle.getIDList())
        for lane, vehicle in list(self._held.items()):
            if vehicle not in alive:
                continue
            if not active:
                libsumo.vehicle.setSpeed(vehicle, -1)
                del self._held[lane]
            elif t_s >= self._braked_at_s[vehicle]:
                libsumo.vehicle.setSpeed(vehicle, speed_mps)
        for lane in lanes if active else []:
            if lane not in self._held:
                self._take(t_s, lane, speed_mps)

    def _take(self, t_s: float, lane: int, speed_mps: float) -> None:
        """Slow down the next vehicle that can still stop before the queue's place."""
        name = f"{self._before}_{lane}"
        length_m = libsumo.lane.getLength(name)
        for vehicle in reversed(libsumo.lane.getLastStepVehicleIDs(name)):
            now_mps = libsumo.vehicle.getSpeed(vehicle)
            left_m = length_m - libsumo.vehicle.getLanePosition(vehicle)
            if left_m > TAKE_WITHIN_M:
                return
            if left_m > now_mps**2 / (2 * BRAKE_MPS2):
                libsumo.vehicle.setLaneChangeMode(vehicle, 0)
                brake_s = max(2 * left_m / max(now_mps + speed_mps, 1.0), 1.0)  # down just there
                libsumo.vehicle.slowDown(vehicle, speed_mps, brake_s)
                self._held[lane] = vehicle
                self._braked_at_s[vehicle] = t_s + brake_s - STEP_S
                return


def drive(job: dict[str, Any]) -> dict[str, np.ndarray[Any, Any]]:
    """Simulate a job and return one row per tick and vehicle."""
    sides = [Carriageway(side) for side in job["sides"]]
    rows: list[tuple[int, str, float, float, float]] = []
    ticks = round((job["warmup_s"] + job["duration_s"]) / STEP_S) + 2
    libsumo.start(job["command"])
    try:
        for tick in range(ticks):
            for side in sides:
                side.act(tick * STEP_S - job["warmup_s"])
            libsumo.simulationStep()
            for vehicle in libsumo.vehicle.getIDList():
                x, y = libsumo.vehicle.getPosition(vehicle)
                rows.append((tick, vehicle, x, y, libsumo.vehicle.getSpeed(vehicle)))
    finally:
        libsumo.close()
    return {
        "tick": np.array([row[0] for row in rows], int),
        "vehicle": np.array([row[1] for row in rows], dtype=str),
        "x_m": np.array([row[2] for row in rows], float),
        "y_m": np.array([row[3] for row in rows], float),
        "speed_mps": np.array([row[4] for row in rows], float),
        "tick_s": (np.arange(ticks) + 1) * STEP_S - job["warmup_s"],
    }


if __name__ == "__main__":
    np.savez(sys.argv[2], **drive(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))))  # type: ignore[arg-type]
