"""Site files: what is good is read, what is bad gets one sentence with the file and the mend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from queuetail.config import (
    MPS_PER_MPH,
    ApproachSite,
    CameraOverride,
    ControlPoint,
    PaperSettings,
    QueueSettings,
    Site,
    SiteInfo,
    TelemetryFill,
    parse_settings,
    read_site,
)
from queuetail.errors import InputError

DESIGN_EXAMPLE = """
[site]
name = "I-35 NB at MP 174"
posted_speed_mph = 65
[camera]
hfov_deg = 84.0
[queue]
speed_mph = 25.0
[[approach]]
name = "NB"
lanes = 2
lane_width_m = 3.2
axis = [[36.11306, -97.05883], [36.11250, -97.05790]]
[[control_point]]
px = [412.0, 388.0]
at = [36.11306, -97.05883]
[[control_point]]
px = [812.0, 388.0]
at = [36.11306, -97.05783]
[[control_point]]
px = [812.0, 588.0]
at = [36.11206, -97.05783]
[[control_point]]
px = [412.0, 588.0]
at = [36.11206, -97.05883]
"""

AXIS = "axis = [[36.1, -97.0], [36.2, -97.0]]"
AXIS_ENU = "axis_enu_m = [[0, 0], [0, 100]]"
POINT = "[[control_point]]\npx = [1, 2]\nenu_m = [3, 4]\n"


def site_of(folder: Path, text: str | bytes) -> Site:
    path = folder / "site.toml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_site(path)


def test_the_example_of_the_design_is_read(tmp_path: Path) -> None:
    site = site_of(tmp_path, DESIGN_EXAMPLE)
    assert site.site.name == "I-35 NB at MP 174"
    assert site.camera.hfov_deg == 84.0
    assert site.queue_speed_mps == pytest.approx(25 * MPS_PER_MPH)
    assert site.approach[0].axis == ((36.11306, -97.05883), (36.11250, -97.05790))
    assert site.control_point[0].px == (412.0, 388.0)


def test_the_queue_speed_is_a_third_of_the_limit_or_25_mph(tmp_path: Path) -> None:
    assert Site().queue_speed_mps == pytest.approx(11.176)
    posted = site_of(tmp_path, "[site]\nposted_speed_mph = 60")
    assert posted.queue_speed_mps == pytest.approx(20 * MPS_PER_MPH)
    both = site_of(tmp_path, "[site]\nposted_speed_mph = 60\n[queue]\nspeed_mph = 10")
    assert both.queue_speed_mps == pytest.approx(10 * MPS_PER_MPH)


def test_an_empty_file_is_a_site_of_defaults(tmp_path: Path) -> None:
    assert site_of(tmp_path, "") == Site()


def test_a_byte_order_mark_is_no_error(tmp_path: Path) -> None:
    assert site_of(tmp_path, b"\xef\xbb\xbf[site]\nname = 'x'\n").site.name == "x"


BAD = {
    "syntax": ("[site\nname = 3", "not valid TOML", "line 1"),
    "half a value": ("[site]\nname = ", "not valid TOML", "end of document"),
    "key twice": ("[site]\nname = 'a'\nname = 'b'", "not valid TOML", "overwrite a value"),
    "unknown table": ("[sites]\nname = 'x'", "unknown key 'sites'", "did you mean 'site'?"),
    "unknown key": ("[site]\nposted_sped_mph = 5", "in [site]", "did you mean 'posted_speed_mph'?"),
    "far-off key": ("[site]\nzzz = 5", "unknown key 'zzz' in [site]", "known keys: "),
    "key of an approach": (
        f"[[approach]]\nname = 'a'\nlane = 2\n{AXIS}",
        "unknown key 'lane' in [approach 1]",
        "did you mean 'lanes'?",
    ),
    "key of a control point": (
        POINT * 4 + "pixel = [1, 2]",
        "unknown key 'pixel' in [control_point 4]",
        "",
    ),
    "no axis": ("[[approach]]\nname = 'a'", "approach 1", "needs either axis or axis_enu_m"),
    "two axes": (f"[[approach]]\nname='a'\n{AXIS}\n{AXIS_ENU}", "approach 1", "either"),
    "axis of one point": (
        "[[approach]]\nname = 'NB'\naxis = [[36.1, -97.0]]",
        "approach 1",
        "an axis needs two points or more",
    ),
    "empty axis": ("[[approach]]\nname = 'NB'\naxis = []", "approach 1", "two points or more"),
    "point twice": (
        "[[approach]]\nname = 'NB'\naxis = [[36.1, -97.0], [36.1, -97.0]]",
        "approach 1",
        "same point twice",
    ),
    "axis across a continent": (
        "[[approach]]\nname = 'NB'\naxis = [[36.1, -97.0], [30.1, -97.0]]",
        "approach 1",
        "lie about 666 km apart",
    ),
    "three numbers": (
        "[[approach]]\nname='NB'\naxis = [[36.1, -97.0, 3], [36.2, -97.0, 3]]",
        "approach 1.axis 1",
        "",
    ),
    "latitude": (
        "[[approach]]\nname = 'NB'\naxis = [[361, -97.0], [36.1, -97.0]]",
        "approach 1.axis 1 1",
        "less than or equal to 90",
    ),
    "longitude first": (
        "[[approach]]\nname = 'NB'\naxis = [[-97.0, 36.1], [-97.1, 36.1]]",
        "approach 1.axis 1 1",
        "(it is -97.0); a point is [latitude, longitude]",
    ),
    "nan": ("[site]\norigin = [nan, 0.0]", "site.origin 1", "finite"),
    "infinite": ("[telemetry]\noffset_s = inf", "telemetry.offset_s", "finite"),
    "nan width": (f"[[approach]]\nname='a'\nlane_width_m = nan\n{AXIS}", "lane_width_m", ""),
    "names": (
        f"[[approach]]\nname='a'\n{AXIS}\n[[approach]]\nname='a'\n{AXIS}",
        "two approaches have the same name",
        "",
    ),
    "no name": (f"[[approach]]\n{AXIS}", "approach 1.name", "required"),
    "empty name": (f"[[approach]]\nname=''\n{AXIS}", "approach 1.name", "at least 1 character"),
    "few points": (POINT * 3, "3 control points given", "at least 4"),
    "point nowhere": ("[[control_point]]\npx = [1, 2]\n", "control_point 1", "either at"),
    "text for number": ("[site]\nposted_speed_mph = 'fast'", "site.posted_speed_mph", "number"),
    "number for table": ("site = 3", "site", ""),
    "table for list": ("[approach]\nname = 'a'", "approach", ""),
    "number for name": ("[site]\nname = 5", "site.name", "string"),
    "zero limit": ("[site]\nposted_speed_mph = 0", "site.posted_speed_mph", "greater than 0"),
    "lens": ("[camera]\nhfov_deg = 180", "camera.hfov_deg", "less than 180"),
    "long distortion": ("[camera]\ndistortion = [1,2,3,4,5,6]", "camera.distortion", "5"),
    "pitch": ("[telemetry]\ngimbal_pitch_deg = -91", "telemetry.gimbal_pitch_deg", "-90"),
    "height": ("[telemetry]\nheight_agl_m = -5000", "telemetry.height_agl_m", "greater than 0"),
    "no lanes": (f"[[approach]]\nname='a'\nlanes = 0\n{AXIS}", "approach 1.lanes", ""),
    "mixed": (
        f"[[approach]]\nname='a'\n{AXIS}\n" + POINT * 4,
        "mixes latitude/longitude with local metres",
        "origin = ",
    ),
    "background": ("[paper]\nbackground = 'mog'", "paper.background", "'mog2'"),
    "blur": ("[paper]\nblur_px = 33", "paper.blur_px", "31"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_site_files_get_one_sentence(tmp_path: Path, case: str) -> None:
    text, *says = BAD[case]
    with pytest.raises(InputError) as raised:
        site_of(tmp_path, text)
    message = str(raised.value)
    assert message.startswith(str(tmp_path / "site.toml"))
    for part in says:
        assert part in message
    assert "\n" not in message
    assert "pydantic" not in message


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such site file"):
        read_site(tmp_path / "none.toml")
    with pytest.raises(InputError, match="is a folder, not a site file"):
        read_site(tmp_path)
    with pytest.raises(InputError, match="not a text file in UTF-8"):
        site_of(tmp_path, b"\xff\xfe\x00\x81")
    below = tmp_path / "site.toml" / "below.toml"
    with pytest.raises(InputError, match="site file"):
        read_site(below)
    with pytest.raises(InputError, match="cannot be read"):
        read_site(tmp_path / ("x" * 400))


def test_mixing_is_fine_where_the_origin_is_known(tmp_path: Path) -> None:
    text = f"[site]\norigin = [36.1, -97.0]\n[[approach]]\nname='a'\n{AXIS}\n" + POINT * 4
    assert site_of(tmp_path, text).site.origin == (36.1, -97.0)


leaves = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.datetimes(),
    st.sampled_from(["mog2", -97.0, 36.1, 2, [36.1, -97.0], [[36.1, -97.0], [36.2, -97.0]]]),
)
TABLES_OF_ONE = (SiteInfo, CameraOverride, TelemetryFill, QueueSettings, PaperSettings)
ALL_TABLES = (Site, ApproachSite, ControlPoint, *TABLES_OF_ONE)
known_keys = st.sampled_from(sorted({key for table in ALL_TABLES for key in table.model_fields}))
keys = st.one_of(known_keys, st.text(max_size=6))
tables = st.recursive(
    leaves,
    lambda inner: st.one_of(st.lists(inner, max_size=5), st.dictionaries(keys, inner, max_size=4)),
    max_leaves=12,
)


@given(st.dictionaries(keys, tables, max_size=5))
def test_no_table_at_all_raises_anything_but_input_errors(raw: dict[str, Any]) -> None:
    said = ""
    try:
        assert parse_settings(Site, raw, "site.toml").queue_speed_mps > 0
    except InputError as error:
        said = str(error)
    assert "\n" not in said


@given(st.text(max_size=60))
def test_no_text_at_all_raises_anything_but_input_errors(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    said = str(path)
    try:
        read_site(path)
    except InputError as error:
        said = str(error)
    assert said.startswith(str(path))
