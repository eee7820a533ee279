"""DJI stills: metadata, and two stills of one place that must agree on the ground."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from queuetail.errors import InputError
from queuetail.geo.camera import intrinsics_from_hfov
from queuetail.geo.ground import mapping_from_pose, px_to_enu
from queuetail.telemetry.stills import Still, read_still
from queuetail.types import CameraPose, Floats, Origin

MATCH_SCALE = 0.35  # of the 4000-pixel pictures: SIFT in two seconds, to about a pixel
XMP = (
    b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    b'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description %s/>'
    b"</rdf:RDF></x:xmpmeta>"
)


def dji_picture(path: Path, attributes: bytes, exif: dict[int, object] | None = None) -> Path:
    tags = Image.Exif()
    if exif:
        tags.get_ifd(0x8769).update(exif)
    Image.new("RGB", (400, 300)).save(path, xmp=XMP % attributes, exif=tags)
    return path


def test_a_real_still(shared: Path) -> None:
    still = read_still(shared / "aerial" / "minsk_exif" / "DJI_0020.JPG")
    sample = still.sample
    assert (still.width_px, still.height_px) == (4000, 2250)
    assert sample.lat_deg == pytest.approx(53 + 55 / 60 + 10.6762 / 3600)
    assert sample.lon_deg == pytest.approx(27 + 34 / 60 + 31.5534 / 3600)
    assert (sample.height_agl_m, sample.heading_deg) == (119.7, 126.2)
    assert (sample.gimbal_pitch_deg, sample.gimbal_roll_deg) == (-49.0, 0.0)
    assert sample.hfov_deg == pytest.approx(67.3, abs=0.1)  # 26 mm by the diagonal of 4:3
    assert still.notes == ("the height is that above the take-off point",)


@pytest.mark.parametrize("longitude", [b"GpsLongitude", b"GpsLongtitude"])
def test_xmp_goes_before_exif(tmp_path: Path, longitude: bytes) -> None:
    attributes = (
        b'drone-dji:GpsLatitude="+36.5" drone-dji:%s="-97.25" drone-dji:RelativeAltitude="+80.10" '
        b'drone-dji:GimbalYawDegree="-170.00" drone-dji:GimbalPitchDegree="-90.10" '
        b'drone-dji:CalibratedFocalLength="200.0"' % longitude
    )
    sample = read_still(dji_picture(tmp_path / "a.jpg", attributes)).sample
    assert (sample.lat_deg, sample.lon_deg, sample.height_agl_m) == (36.5, -97.25, 80.1)
    assert (sample.heading_deg, sample.gimbal_pitch_deg) == (-170, -90)
    assert sample.hfov_deg == pytest.approx(90)


@pytest.mark.parametrize(("zoom", "hfov_deg"), [(1.0, 67.30), (2.0, 36.81)])
def test_lens_from_exif(tmp_path: Path, zoom: float, hfov_deg: float) -> None:
    path = dji_picture(
        tmp_path / "a.jpg", b'drone-dji:RelativeAltitude="1"', {0xA405: 26, 0xA404: zoom}
    )
    assert read_still(path).sample.hfov_deg == pytest.approx(hfov_deg, abs=0.01)


def test_bad_stills_are_one_sentence(tmp_path: Path) -> None:
    text = tmp_path / "notes.jpg"
    text.write_text("not a picture")
    plain = tmp_path / "plain.jpg"
    Image.new("RGB", (8, 8)).save(plain)
    wrong = dji_picture(tmp_path / "wrong.jpg", b'drone-dji:RelativeAltitude="-5000"')
    for path, sentence in (
        (tmp_path / "none.jpg", "no such picture"),
        (tmp_path, "is a folder"),
        (text, "is not a picture"),
        (plain, "says nothing of position"),
        (wrong, "height dropped"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_still(path)


@pytest.mark.parametrize(
    ("first", "second", "median_m", "nearly_all_m"),
    [("DJI_0010.JPG", "DJI_0012.JPG", 3.0, 3.3), ("DJI_0020.JPG", "DJI_0022.JPG", 4.0, 4.8)],
    ids=["nadir", "oblique"],
)
def test_two_stills_agree_on_the_same_ground_points(
    shared: Path, first: str, second: str, median_m: float, nearly_all_m: float
) -> None:
    paths = [shared / "aerial" / "minsk_exif" / name for name in (first, second)]
    stills = [read_still(path) for path in paths]
    points = matched_ground_points(*paths)
    assert len(points[0]) >= 50
    origin = Origin(stills[0].sample.lat_deg or 0.0, stills[0].sample.lon_deg or 0.0)
    enu = [located(still, px, origin) for still, px in zip(stills, points, strict=True)]
    apart = np.linalg.norm(enu[0] - enu[1], axis=1)
    facts = (
        f"{len(apart)} points, apart by median {np.median(apart):.2f} m, "
        f"95th percentile {np.percentile(apart, 95):.2f} m, maximum {apart.max():.2f} m"
    )
    print(facts)
    assert np.median(apart) < median_m, facts
    assert np.percentile(apart, 95) < nearly_all_m, facts


def matched_ground_points(first: Path, second: Path) -> tuple[Floats, Floats]:
    """Pixels of the same points of one plane in both pictures: SIFT matches on one homography."""
    sift = cv2.SIFT_create(2500)
    keys, descriptors = [], []
    for path in (first, second):
        picture = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        small = cv2.resize(
            picture, None, fx=MATCH_SCALE, fy=MATCH_SCALE, interpolation=cv2.INTER_AREA
        )
        found, described = sift.detectAndCompute(small, None)
        keys.append(np.array([key.pt for key in found]))
        descriptors.append(described)
    pairs = cv2.BFMatcher().knnMatch(*descriptors, k=2)
    good = [a for a, b in pairs if a.distance < 0.75 * b.distance]
    px = keys[0][[m.queryIdx for m in good]], keys[1][[m.trainIdx for m in good]]
    _, inlier = cv2.findHomography(*px, cv2.RANSAC, 6.0 * MATCH_SCALE)
    on_plane = inlier.ravel() > 0
    return (px[0][on_plane] + 0.5) / MATCH_SCALE, (px[1][on_plane] + 0.5) / MATCH_SCALE


def located(still: Still, px: Floats, origin: Origin) -> Floats:
    sample = still.sample
    values = (
        sample.lat_deg,
        sample.lon_deg,
        sample.height_agl_m,
        sample.heading_deg,
        sample.gimbal_pitch_deg,
        sample.gimbal_roll_deg,
    )
    assert None not in values
    assert sample.hfov_deg is not None
    lens = intrinsics_from_hfov(still.width_px, still.height_px, sample.hfov_deg)
    pose = CameraPose(*[value or 0.0 for value in values], lens)
    return px_to_enu(mapping_from_pose(pose, origin), px)
