"""What SUMO is given: a straight network (so that x is station and y offset), and departures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from queuetail.config import MPS_PER_MPH
from queuetail.sim.axis import ROAD_LENGTH_M, VIEW_STATION_M
from queuetail.sim.bodies import BODIES, BODY_INDEX
from queuetail.sim.scenario import Queue, Scenario

CRAWL_ZONE_M = 130.0  # the stretch after the queue's place where the speed is held down
SLOW_LEAD_S = 15.0  # a slow vehicle starts this long before frame 0
FREE_VEHICLE_FACTOR, FREE_TRUCK_FACTOR, FACTOR_SPREAD = 1.02, 0.97, 0.06
LEAST_HEADWAY_S = 1.4


@dataclass(frozen=True, slots=True)
class Side:
    """One carriageway in SUMO: "e" is the approach under watch, "o" the opposite one."""

    name: str
    lanes: int
    demand_vph: float
    truck_share: float
    queue: Queue
    left_edge_m: float  # y of its left edge
    back: bool  # whether it runs against the station

    @property
    def edges(self) -> tuple[str, str, str]:
        """Edges before the queue's place, in the crawl zone, and after it."""
        return f"{self.name}0", f"{self.name}1", f"{self.name}2"

    @property
    def lanes_after(self) -> int:
        """Lanes beyond the queue's place: one fewer where a lane drops."""
        return self.lanes - 1 if self.queue.cause == "lane_drop" else self.lanes


@dataclass(frozen=True, slots=True)
class Departure:
    """One vehicle's entry; `place_m` along its own direction."""

    name: str
    body: int
    time_s: float
    lane: int
    speed_factor: float
    place_m: float = 0.0
    standing: bool = False


def sides(scenario: Scenario) -> list[Side]:
    """Return the carriageways of a scenario."""
    own, other = scenario.traffic, scenario.opposite
    found = [Side("e", scenario.road.lanes, own.demand_vph, own.truck_share, own.queue, 0.0, False)]
    if other.lanes:
        found.append(
            Side(
                "o",
                other.lanes,
                other.demand_vph,
                other.truck_share,
                other.queue,
                other.median_m,
                True,
            )
        )
    return found


def warmup_s(scenario: Scenario) -> float:
    """Return how long traffic runs before frame 0: enough to fill the road, and the early queue."""
    free_mps = scenario.traffic.posted_speed_mph * MPS_PER_MPH
    fill_s = 1.25 * ROAD_LENGTH_M / free_mps
    starts = [side.queue.start_s for side in sides(scenario) if side.queue.cause != "none"]
    return float(np.ceil(fill_s + max(0.0, -min(starts, default=0.0))))


def write_network(scenario: Scenario, folder: Path) -> list[str]:
    """Write nodes, edges and connections; return netconvert's arguments."""
    nodes: list[str] = []
    edges: list[str] = []
    joins: list[str] = []
    for side in sides(scenario):
        _add_side(scenario, side, nodes, edges, joins)
    arguments = ["--no-turnarounds", "true", "--offset.disable-normalization", "true"]
    for kind, lines in (("node", nodes), ("edge", edges), ("connection", joins)):
        path = folder / f"road.{kind}.xml"
        path.write_text(f"<{kind}s>{''.join(lines)}</{kind}s>", encoding="utf-8")
        arguments += [f"--{kind}-files", str(path)]
    return arguments


def _add_side(
    scenario: Scenario, side: Side, nodes: list[str], edges: list[str], joins: list[str]
) -> None:
    ahead = -1.0 if side.back else 1.0
    width = scenario.road.lane_width_m
    speed = scenario.traffic.posted_speed_mph * MPS_PER_MPH
    at_m = VIEW_STATION_M + ahead * side.queue.at_m
    first, last = (ROAD_LENGTH_M, 0.0) if side.back else (0.0, ROAD_LENGTH_M)
    places = (first, at_m, at_m + ahead * CRAWL_ZONE_M, last)
    held = side.queue.cause in ("flagger", "signal")
    for i, x in enumerate(places):
        kind = "traffic_light" if held and i == 1 else "priority"
        nodes.append(f'<node id="{side.name}n{i}" x="{x}" y="{side.left_edge_m}" type="{kind}"/>')
    for i, name in enumerate(side.edges):
        lanes = side.lanes if i == 0 else side.lanes_after
        y = side.left_edge_m - ahead * width * (side.lanes - lanes)  # a dropped lane is the left
        edges.append(
            f'<edge id="{name}" from="{side.name}n{i}" to="{side.name}n{i + 1}" '
            f'numLanes="{lanes}" speed="{speed}" width="{width}" '
            f'shape="{places[i]},{y} {places[i + 1]},{y}"/>'
        )
    joins += [
        f'<connection from="{a}" to="{b}" fromLane="{lane}" toLane="{lane}"/>'
        for a, b in zip(side.edges, side.edges[1:], strict=False)
        for lane in range(side.lanes_after)
    ]


def departures(scenario: Scenario, seed: int) -> list[Departure]:
    """Return who enters when, in order of time."""
    rng = np.random.default_rng([seed, 3])
    warm_s = warmup_s(scenario)
    entries = []
    for side in sides(scenario):
        times = _entries(rng, side, warm_s + scenario.scenario.duration_s)
        entries += [(time_s, side.name, lane, side.truck_share) for time_s, lane in times]
    found = []
    for number, (time_s, name, lane, truck_share) in enumerate(sorted(entries)):
        body = draw_body(rng, truck_share)
        mean = FREE_TRUCK_FACTOR if BODIES[body].truck else FREE_VEHICLE_FACTOR
        factor = float(np.clip(rng.normal(mean, FACTOR_SPREAD), 0.85, 1.2))
        found.append(Departure(f"{name}.{number}", body, time_s, lane, factor))
    if scenario.traffic.slow_vehicle_mph:
        found.append(_slow_vehicle(scenario, scenario.traffic.slow_vehicle_mph, warm_s))
    return sorted(found, key=lambda d: d.time_s)


def write_routes(scenario: Scenario, entries: list[Departure], path: Path) -> None:
    """Write vehicle types, routes and departures."""
    lines = []
    for body in BODIES:
        brake, gap = (2.6, 2.6) if body.truck else (3.2, 2.1)
        lines.append(
            f'<vType id="{body.name}" length="{body.length_m}" width="{body.width_m}" '
            f'minGap="{gap}" accel="{body.accel_mps2}" decel="{brake}" emergencyDecel="7" '
            f'sigma="0.25" tau="1.2" maxSpeed="{28 if body.truck else 45}" '
            f'vClass="{"truck" if body.truck else "passenger"}"/>'
        )
    lines += [f'<route id="{s.name}" edges="{" ".join(s.edges)}"/>' for s in sides(scenario)]
    for entry in entries:
        speed = "0" if entry.standing else "desired"
        lines.append(
            f'<vehicle id="{entry.name}" type="{BODIES[entry.body].name}" '
            f'route="{entry.name[0]}" depart="{entry.time_s:.1f}" departLane="{entry.lane}" '
            f'departPos="{entry.place_m:.1f}" departSpeed="{speed}" '
            f'speedFactor="{entry.speed_factor:.3f}"/>'
        )
    path.write_text(f"<routes>{''.join(lines)}</routes>", encoding="utf-8")


def draw_body(rng: np.random.Generator, truck_share: float) -> int:
    """Draw a kind of vehicle, an index into BODIES."""
    truck = rng.random() < truck_share
    kinds = [i for i, body in enumerate(BODIES) if body.truck == truck and body.share > 0]
    shares = np.array([BODIES[i].share for i in kinds])
    return int(rng.choice(kinds, p=shares / shares.sum()))


def _entries(rng: np.random.Generator, side: Side, until_s: float) -> list[tuple[float, int]]:
    """Return times and lanes of entry: shifted exponential headways, as on a real road."""
    if side.demand_vph <= 0:
        return []
    found = []
    mean_s = 3600.0 * side.lanes / side.demand_vph
    least_s = min(LEAST_HEADWAY_S, 0.85 * mean_s)
    for lane in range(side.lanes):
        time_s = float(rng.uniform(0, mean_s))
        while time_s < until_s:
            found.append((round(time_s, 1), lane))
            time_s += least_s + float(rng.exponential(mean_s - least_s))
    return found


def _slow_vehicle(scenario: Scenario, mph: float, warm_s: float) -> Departure:
    """Return a tractor that passes the middle of the view in the middle of the flight."""
    lead_m = mph * MPS_PER_MPH * (0.5 * scenario.scenario.duration_s + SLOW_LEAD_S)
    return Departure(
        name="e.slow",
        body=BODY_INDEX["tractor"],
        time_s=round(warm_s - SLOW_LEAD_S, 1),
        lane=0,
        speed_factor=mph / scenario.traffic.posted_speed_mph,
        place_m=max(VIEW_STATION_M - lead_m, 10.0),
        standing=True,
    )
