"""Set up, sliders and the accuracy check as people use them: a real browser, a real live run."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from time import monotonic
from typing import Any

import numpy as np
import pytest
from axe_playwright_python.sync_playwright import Axe
from served import FROM_S, SIZE, Served, visit, write_scene

from queuetail.config import Site, read_site
from queuetail.flight import open_flight
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.earth import enu_from_geodetic, geodetic_from_enu
from queuetail.geo.ground import enu_to_px, mapping_from_pose, px_to_enu
from queuetail.types import CameraPose, GroundMapping, Origin, TelemetrySample

LIMIT_S = 60.0
RIGHT_M = 5.0
EARTH_RADIUS_M = 6_371_008.8
HEADING_OFF_DEG, PITCH_OFF_DEG, HEIGHT_OFF_M = 3.0, -1.5, 6.0


@pytest.fixture(scope="module")
def scene(flagger: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The bundled flight's queue, small, and its log."""
    return write_scene(flagger, tmp_path_factory.mktemp("scene"))


@pytest.fixture
def page(browser: Any) -> Iterator[Any]:
    """A page of a laptop; an error in it fails the test."""
    context = browser.new_context(viewport={"width": 1366, "height": 768})
    context.add_init_script("localStorage.setItem('qt-units', 'metric')")
    made, errors = context.new_page(), []
    made.on("pageerror", lambda error: errors.append(str(error)))
    made.on("dialog", lambda dialog: dialog.accept())
    yield made
    context.close()
    assert errors == []


def serve(scene: tuple[Path, Path], *words: str) -> Served:
    """A live run of the scene, in a loop."""
    files = str(scene[0]), "--telemetry", str(scene[1])
    return Served("live", *files, "--realtime", "--loop", "--no-store", *words)


def pose_mapping(sample: TelemetrySample) -> GroundMapping:
    """The exact mapping of the scene's picture by a log's sample."""
    lens = intrinsics_from_hfov(*SIZE, sample.hfov_deg or 0.0)
    height, heading = sample.height_agl_m or 0.0, sample.heading_deg or 0.0
    pitch, roll = sample.gimbal_pitch_deg or 0.0, sample.gimbal_roll_deg or 0.0
    lat, lon = sample.lat_deg or 0.0, sample.lon_deg or 0.0
    pose = CameraPose(lat, lon, height, heading, pitch, roll, lens)
    return mapping_from_pose(pose, Origin(lat, lon))


def truth_at(scene: tuple[Path, Path]) -> Callable[[float], GroundMapping]:
    """The true mapping at a time of the scene."""
    with open_flight(*scene, Site()) as flight:
        return lambda t_s: pose_mapping(flight.telemetry_at(t_s))


def click(page: Any, px: tuple[float, float]) -> None:
    """Click a pixel of the held picture."""
    box = page.locator(".qt-sheet svg").bounding_box()
    x, y = px[0] / SIZE[0] * box["width"], px[1] / SIZE[1] * box["height"]
    page.locator(".qt-sheet svg").click(position={"x": x, "y": y})


def wait_for(page: Any, what: Callable[[], Any]) -> Any:
    """Ask until there is an answer; the page goes on meanwhile, and its dialogs are answered."""
    end_s = monotonic() + LIMIT_S
    while monotonic() < end_s:
        if (found := what()) is not None:
            return found
        page.wait_for_timeout(200)
    raise AssertionError("it did not happen")


def haversine_by_hand_m(lat1: float, lon1: float, lat2: float, lon2: float) -> float:
    a1, a2, d = math.radians(lat1), math.radians(lat2), math.radians(lon2 - lon1)
    h = math.sin((a2 - a1) / 2) ** 2 + math.cos(a1) * math.cos(a2) * math.sin(d / 2) ** 2
    return 2 * EARTH_RADIUS_M * math.asin(math.sqrt(h))


def ends(flagger: Path) -> list[tuple[float, float, float]]:
    """When, latitude, longitude of the true end of the queue."""
    with (flagger / "truth.csv").open() as file:
        rows = [r for r in csv.DictReader(file) if r["eoq_lat"]]
    return [(float(r["t_s"]), float(r["eoq_lat"]), float(r["eoq_lon"])) for r in rows]


def test_set_up_from_nothing_to_a_right_end_of_queue(
    flagger: Path, scene: tuple[Path, Path], page: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    axis = read_site(flagger / "site.toml").approach[0].axis
    assert axis is not None
    truth = truth_at(scene)(1.0)
    assert truth.origin is not None
    enu = enu_from_geodetic(*np.array(axis).T, truth.origin)
    along = enu[0] + np.linspace(0, 1, 400)[:, None] * (enu[1] - enu[0])
    px = enu_to_px(truth, along)
    seen = px[(px[:, 0] > 4) & (px[:, 0] < SIZE[0] - 4)]  # in the direction of travel
    true_ends = ends(flagger)
    with serve(scene) as served:
        visit(page, f"{served.address}setup")
        page.wait_for_selector(".qt-sheet img[src]")
        page.wait_for_selector("#qt-checks .qt-good >> nth=1")
        assert "gimbal pitch" in page.inner_text("#qt-quantities")
        page.click("#qt-draw")
        for point in (seen[0], seen[len(seen) // 2], seen[-1]):
            click(page, (float(point[0]), float(point[1])))
        page.fill("#qt-road", "SB")
        page.fill("#qt-posted", "65")
        page.fill("#qt-name", "From nothing")
        page.fill("#qt-file", "new.toml")
        page.click("#qt-sign")
        click(page, (SIZE[0] / 4, SIZE[1] * 0.55))
        page.wait_for_selector("#qt-signs li")
        report = Axe().run(page)
        assert report.violations_count == 0, report.generate_report()
        page.click("#qt-save")
        page.wait_for_function("document.getElementById('qt-said').textContent.includes('kept in')")
        site = read_site(tmp_path / "sites" / "new.toml")
        assert (site.site.name, site.approach[0].name, site.sign[0].name) == (
            ("From nothing", "SB", "sign 1")
        )

        def right() -> float | None:
            state = page.request.get(f"{served.address}api/v1/state").json()
            for answer in state["approaches"]:
                eoq = answer["eoq"]
                if answer["approach"] != "SB" or answer["status"] != "queued" or eoq is None:
                    continue
                media_s = state["t_s"] % 14.0 + FROM_S
                gaps = [
                    haversine_by_hand_m(lat, lon, eoq["lat_deg"], eoq["lon_deg"])
                    for t_s, lat, lon in true_ends
                    if abs(t_s - media_s) < 1.0
                ]
                if gaps and min(gaps) < RIGHT_M:
                    return min(gaps)
            return None

        assert wait_for(page, right) < RIGHT_M
        # The same name again: nothing is overwritten but after a question, which is answered yes.
        page.fill("#qt-name", "Once more")
        page.click("#qt-save")
        wait_for(
            page, lambda: read_site(tmp_path / "sites/new.toml").site.name == "Once more" or None
        )


def test_sliders_show_their_mask_and_change_the_run(scene: tuple[Path, Path], page: Any) -> None:
    with serve(scene, "--preset", "paper") as served:
        visit(page, f"{served.address}setup")
        page.wait_for_function("document.getElementById('qt-mask')?.naturalWidth > 0")
        for slider, value in (("qt-blur", 9), ("qt-dilate", 7), ("qt-blob", 100), ("qt-slow", 15)):
            page.locator(f"#{slider}").fill(str(value))
        page.wait_for_function(
            "document.getElementById('qt-mask').dataset.query"
            " === 'blur_px=9&dilate_px=7&min_blob_px2=100'"
        )

        def white() -> float | None:
            share = page.evaluate(WHITE)
            return share if share > 1e-4 else None

        assert wait_for(page, white) < 0.5
        page.click("#qt-useslid")
        page.wait_for_function(
            "document.getElementById('qt-slidsaid').textContent.includes('goes on')"
        )
        now = page.request.get(f"{served.address}api/v1/sliders").json()["sliders"]
        assert now == {
            "blur_px": 9,
            "dilate_px": 7,
            "min_blob_px2": 100,
            "queue_speed_mph": pytest.approx(15),
        }
        number = page.request.get(f"{served.address}api/v1/state").json()["number"]
        wait_for(
            page,
            lambda: (
                page.request.get(f"{served.address}api/v1/state").json()["number"] > number + 5
                or None
            ),
        )


WHITE = """() => {
  const image = document.getElementById('qt-mask'), canvas = document.createElement('canvas');
  canvas.width = image.naturalWidth; canvas.height = image.naturalHeight;
  const c = canvas.getContext('2d');
  c.drawImage(image, 0, 0);
  const data = c.getImageData(0, 0, canvas.width, canvas.height).data;
  let white = 0;
  for (let i = 2; i < data.length; i += 4) white += data[i] > 200;
  return white / (data.length / 4);
}"""


def biased(log: Path, out: Path) -> Path:
    """The log with heading, pitch and height off."""
    with log.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["heading_deg"] = f"{float(row['heading_deg']) + HEADING_OFF_DEG:.3f}"
        row["gimbal_pitch_deg"] = f"{float(row['gimbal_pitch_deg']) + PITCH_OFF_DEG:.3f}"
        row["height_agl_m"] = f"{float(row['height_agl_m']) + HEIGHT_OFF_M:.3f}"
    with out.open("w") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return out


def test_the_check_measures_as_by_hand_and_mends_telemetry(
    scene: tuple[Path, Path], page: Any, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    truth = truth_at(scene)
    spread = [(0.1, 0.2), (0.9, 0.25), (0.85, 0.9), (0.1, 0.85)]
    with serve((scene[0], biased(scene[1], tmp_path / "biased.csv"))) as served:
        visit(page, f"{served.address}check")
        add_points(page, truth, spread)
        rows = page.locator("#qt-points tr").all_inner_texts()
        errors = []
        for row in rows:
            cells = row.split("\t")
            lat, lon = (float(v) for v in cells[2].replace("−", "-").split(","))
            there = [float(v) for v in cells[3].replace("−", "-").split(",")]
            by_hand = haversine_by_hand_m(lat, lon, *there)
            assert float(cells[4].split()[0]) == pytest.approx(by_hand, abs=0.02)
            errors.append(by_hand)
        mean = float(page.inner_text("#qt-mean").split()[0])
        assert mean == pytest.approx(sum(errors) / len(errors), abs=0.02)
        assert mean > 4.0
        page.click("#qt-improve")
        page.wait_for_selector("#qt-consent")
        assert page.is_disabled("#qt-apply")  # nothing happens without consent
        report = Axe().run(page)
        assert report.violations_count == 0, report.generate_report()
        page.check("#qt-consent")
        page.check("#qt-keep")
        page.fill("#qt-file", "mended.toml")
        page.click("#qt-apply")
        page.wait_for_function("document.getElementById('qt-said').textContent.includes('goes on')")
        fill = read_site(tmp_path / "sites" / "mended.toml").telemetry
        assert fill.heading_offset_deg == pytest.approx(-HEADING_OFF_DEG, abs=0.5)
        assert fill.height_offset_m == pytest.approx(-HEIGHT_OFF_M, abs=2.0)
        page.wait_for_timeout(2000)  # the page holds a new picture once the run has begun anew
        add_points(page, truth, spread[1:3])
        assert float(page.inner_text("#qt-mean").split()[0]) < 1.0


def add_points(
    page: Any, truth: Callable[[float], GroundMapping], spread: list[tuple[float, float]]
) -> None:
    """Click points in the held picture and type where they truly are."""
    page.wait_for_selector(".qt-sheet img[src]")
    page.wait_for_function("document.querySelector('.qt-sheet svg').hasAttribute('viewBox')")
    for count, (across, down) in enumerate(spread, 1):
        px = across * SIZE[0], down * SIZE[1]
        click(page, px)
        page.wait_for_selector("#qt-entry:visible")
        t_s = page.evaluate("() => Number(document.getElementById('qt-asked').dataset.time)")
        mapping = truth(t_s % 14.0)
        assert mapping.origin is not None
        lat, lon = geodetic_from_enu(px_to_enu(mapping, np.array([px])), mapping.origin)
        page.fill("#qt-where", f"{lat[0]:.7f}, {lon[0]:.7f}")
        page.press("#qt-where", "Enter")
        page.wait_for_function(
            f"document.querySelectorAll('#qt-points tr').length === {count}"
            " && document.querySelector('#qt-points tr:last-child td:nth-child(5)')"
            ".textContent.endsWith('m')"
        )
