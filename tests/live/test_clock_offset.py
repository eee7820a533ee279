"""The offset between video and telemetry: known ones are found, and doubt is said."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from queuetail.config import Site, parse_settings
from queuetail.geo.ground import mapping_from_pose
from queuetail.live.clock_offset import (
    STEP_S,
    ClockOffset,
    OffsetEstimator,
    best_shift,
    offset_note,
)
from queuetail.live.clock_watch import ClockWatch
from queuetail.live.records import Health, OutletState, Published
from queuetail.pipeline import NO_TRACKS
from queuetail.run import run
from queuetail.sim.flight import TruePath
from queuetail.sim.scenario import Scenario
from queuetail.telemetry.flightlog import FlightLog
from queuetail.traffic.road import assign
from queuetail.types import (
    CameraPose,
    Floats,
    Frame,
    Observation,
    Origin,
    Registration,
    TelemetrySample,
    Unknown,
)
from short_flight import cut_flight

SIZE = 1280, 720
ORIGIN = Origin(36.11, -97.057)
SECONDS = 75.0
FRAMES_HZ = 15.0


def flown(gust_m: float, gust_deg: float) -> Callable[[float], CameraPose]:
    """Return where a simulated drone is at any time."""
    settings = {
        "scenario": {"duration_s": SECONDS, "origin": [ORIGIN.lat_deg, ORIGIN.lon_deg]},
        "flight": {"gust_m": gust_m, "gust_deg": gust_deg, "jitter_m": 0.2, "jitter_deg": 0.05},
    }
    path = TruePath(parse_settings(Scenario, settings, "here"), 5)
    return lambda t_s: path.view(t_s).pose


def told(pose_at: Callable[[float], CameraPose], rate_hz: float, round_deg: float) -> FlightLog:
    """Return the log of that flight, rounded as drones do."""
    samples = []
    for t_s in np.arange(-10.0, SECONDS + 10.0, 1 / rate_hz).tolist():
        pose = pose_at(t_s)
        yaw, pitch, roll = (
            round(v / round_deg) * round_deg for v in (pose.yaw_deg, pose.pitch_deg, pose.roll_deg)
        )
        samples.append(
            TelemetrySample(
                t_s, pose.lat_deg, pose.lon_deg, pose.height_agl_m, yaw, max(pitch, -90), roll, 84.0
            )
        )
    return FlightLog(samples, "here")


def estimator(pose_at: Callable[[float], CameraPose], noise_px: float = 0.1) -> OffsetEstimator:
    """Return what has seen the flight: exact homographies, shaken by noise."""
    rng = np.random.default_rng(7)
    found = OffsetEstimator(*SIZE)
    lens = dataclasses.replace(pose_at(0.0).intrinsics, width_px=SIZE[0], height_px=SIZE[1])
    reference = mapping_from_pose(dataclasses.replace(pose_at(0.0), intrinsics=lens), ORIGIN)
    for k in range(int(SECONDS * FRAMES_HZ)):
        t_s = k / FRAMES_HZ
        mapping = mapping_from_pose(dataclasses.replace(pose_at(t_s), intrinsics=lens), ORIGIN)
        H: Floats = reference.H_px_enu @ mapping.H_enu_px
        H = H / H[2, 2]
        H[:2, 2] += rng.normal(0, noise_px, 2)
        lost = 300 <= k < 330
        registration = Registration(H, 0.0 if lost else 1.0, "blurred" if lost else "")
        found.add(t_s, registration)
    return found


@pytest.mark.parametrize("offset_s", [-3.3, -0.25, 0.0, 0.5, 4.0])
def test_known_offsets_are_found(offset_s: float) -> None:
    pose_at = flown(1.5, 1.6)
    found = estimator(pose_at).estimate(told(pose_at, 10.0, 0.1).shifted(-offset_s).at)
    assert found.offset_s is not None
    assert found.sigma_s is not None
    assert found.offset_s == pytest.approx(offset_s, abs=0.03)
    assert abs(found.offset_s - offset_s) < 3 * found.sigma_s
    assert found.sigma_s < 0.06
    assert found.is_significant == (offset_s != 0.0)


def test_slow_telemetry_costs_certainty_not_truth() -> None:
    pose_at = flown(1.5, 1.6)
    fast = estimator(pose_at).estimate(told(pose_at, 10.0, 0.1).shifted(-1.0).at)
    slow = estimator(pose_at).estimate(told(pose_at, 1.0, 0.1).shifted(-1.0).at)
    assert fast.sigma_s is not None
    assert slow.sigma_s is not None
    assert slow.sigma_s > fast.sigma_s
    assert slow.offset_s == pytest.approx(1.0, abs=3 * slow.sigma_s)


def test_a_drone_that_stands_still_tells_nothing() -> None:
    pose_at = flown(0.0, 0.0)
    still = pose_at(3.0)
    found = estimator(lambda t_s: still).estimate(told(lambda t_s: still, 10.0, 0.1).at)
    assert found.offset_s is None
    assert found.reason == "the drone does not move enough to tell"


def test_telemetry_of_another_flight_agrees_nowhere() -> None:
    settings = {"flight": {"gust_m": 1.5, "gust_deg": 1.6}}
    other = TruePath(parse_settings(Scenario, settings, "here"), 99)
    log = told(lambda t_s: other.view(t_s).pose, 10.0, 0.1)
    found = estimator(flown(1.5, 1.6)).estimate(log.at)
    assert found.offset_s is None
    assert found.reason


def test_motion_that_repeats_itself_fits_more_than_one_offset() -> None:
    times = np.arange(0.0, 80.0, STEP_S)
    seen = 5 * np.sin(2 * np.pi * times / 2.5)[:, None] * [1.0, 0.5]
    found = best_shift(seen, seen)
    assert (found.offset_s, found.reason) == (None, "the motion fits more than one offset")


def test_noise_has_no_offset() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        found = best_shift(rng.normal(0, 3, (1600, 4)), rng.normal(0, 3, (1600, 4)))
        assert found.offset_s is None


def test_what_was_too_short_or_says_nothing_is_unknown() -> None:
    found = OffsetEstimator(*SIZE)
    assert found.estimate(TelemetrySample).reason == "less than 20 s were seen"
    for k in range(400):
        found.add(k / 10, Registration(np.eye(3), 1.0))
    assert found.estimate(TelemetrySample).reason == "telemetry does not tell the camera's pose"


def test_only_what_is_sure_is_told() -> None:
    assert offset_note(ClockOffset(0.19, 0.01), 0.0) == ""
    assert offset_note(ClockOffset(0.5, 0.2), 0.0) == ""
    assert offset_note(ClockOffset(None, None), 0.0) == ""
    assert "0.50 ± 0.02 s too late" in offset_note(ClockOffset(-0.5, 0.02), 1.25)
    assert "set offset_s = 0.75 under [telemetry]" in offset_note(ClockOffset(-0.5, 0.02), 1.25)


def test_a_run_says_that_its_log_is_off(flagger: Path, tmp_path: Path) -> None:
    video = cut_flight(flagger / "flight.mp4", tmp_path / "short.mp4", 25.0)
    site = tmp_path / "site.toml"
    text = (flagger / "site.toml").read_text("utf-8")
    site.write_text(f"{text}\n[telemetry]\noffset_s = 1.5\n", "utf-8")
    result = run(video, flagger / "telemetry.csv", site, out=tmp_path / "out", with_video=False)
    (note,) = [n for n in result.notes if "offset_s" in n]
    assert "too late for the video" in note
    advised_s = float(note.split("offset_s = ")[1].split()[0])
    assert advised_s == pytest.approx(0.0, abs=0.25)


def publish(watch: ClockWatch, seen: OffsetEstimator, log: FlightLog, later_s: float) -> None:
    """Offer what was seen as a live run does, whose pictures were taken `later_s` after t_s."""
    luma = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    start = datetime(2026, 5, 14, tzinfo=UTC)
    for number, one in enumerate(seen._seen):
        lost = one.H_ref_frame is None
        H = np.eye(3) if one.H_ref_frame is None else one.H_ref_frame
        answer = Observation(
            frame_index=number,
            t_s=one.t_s,
            mapping=Unknown(()),
            registration=Registration(H, 1.0, "blurred" if lost else ""),
            detections_px=np.empty((0, 4)),
            approaches=(),
            vehicles=assign(NO_TRACKS, ()),
            states=(),
        )
        watch.offer(
            Published(
                number=number,
                utc=start + timedelta(seconds=one.t_s),
                frame=Frame(number, one.t_s, luma, lambda w, h: np.zeros((h, w, 3), np.uint8)),
                observation=answer,
                health=Health(),
                telemetry=log.at(one.t_s),
                captured_s=one.t_s + later_s,
            )
        )


def test_a_live_run_is_warned() -> None:
    """Of a recording that is played, whose log is not heard but used."""
    pose_at = flown(1.5, 1.6)
    warnings: dict[str, str] = {}
    watch = ClockWatch(Site())
    watch.warn_by(lambda name, sentence: warnings.update({name: sentence}))
    publish(watch, estimator(pose_at), told(pose_at, 10.0, 0.1).shifted(-1.0), 0.0)
    watch.close()
    assert watch.health().state is OutletState.OK
    assert watch.health().delivered >= 1
    assert "1.00 ± 0.0" in warnings["clock"]
    assert watch.newest.offset_s == pytest.approx(1.0, abs=0.05)


def test_telemetry_that_is_heard_counts_as_it_was_heard() -> None:
    """What a run uses of it holds until something newer comes, which is no offset."""
    pose_at = flown(1.5, 1.6)
    site = parse_settings(Site, {"telemetry": {"offset_s": 0.4}}, "here")
    warnings: dict[str, str] = {}
    watch = ClockWatch(site)
    watch.warn_by(lambda name, sentence: warnings.update({name: sentence}))
    log = told(pose_at, 10.0, 0.1).shifted(1000.0 - 1.0)
    for sample in log.samples:
        watch.hear(sample, datetime.now(UTC), "radio")
    stale = told(lambda t_s: pose_at(t_s - 0.5), 10.0, 0.1)
    publish(watch, estimator(pose_at), stale, 1000.0)
    watch.close()
    assert watch.newest.offset_s == pytest.approx(0.6, abs=0.05)
    assert "set offset_s = 1.0" in warnings["clock"]
