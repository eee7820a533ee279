"""Words on signs and distances ahead of queues."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from queuetail.config import Site, parse_settings
from queuetail.errors import InputError
from queuetail.signs.distances import STEPS, readable, stopping_sight_m, warning_distance_m
from queuetail.signs.messages import LONGEST_DISTANCE, fit, with_distance
from queuetail.signs.settings import SignsSettings

WORDS = SignsSettings()
DOCS = Path(__file__).resolve().parents[2] / "docs" / "signs.md"


def test_a_portable_sign_shows_the_words_as_they_are_written() -> None:
    for text in (WORDS.warning, WORDS.ahead, WORDS.caution):
        told = with_distance(text, "1/2 MILE")
        assert fit(told, 3, 8, 2) == told


@pytest.mark.parametrize(
    ("size", "shown"),
    [
        ((3, 8, 2), (("STOPPED", "TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))),
        ((3, 8, 1), (("STOPPED", "TRAFFIC", "1/2 MILE"),)),
        ((2, 16, 2), (("STOPPED TRAFFIC", "1/2 MILE"), ("PREPARE", "TO STOP"))),
        ((1, 24, 1), (("STOPPED TRAFFIC 1/2 MILE",),)),
        ((2, 8, 2), ()),
        ((3, 6, 2), ()),
    ],
)
def test_words_fit_the_signs_own_size(
    size: tuple[int, int, int], shown: tuple[tuple[str, ...], ...]
) -> None:
    assert fit(with_distance(WORDS.warning, "1/2 MILE"), *size) == shown


def test_every_distance_fits_eight_characters() -> None:
    for units, steps in STEPS.items():
        lengths = [len(text) for _, text in steps]
        assert max(lengths) <= 8
        assert len(LONGEST_DISTANCE[units]) == max(lengths)
        metres = [m for m, _ in steps]
        assert metres == sorted(metres)


@pytest.mark.parametrize(
    ("distance_m", "units", "text"),
    [
        (100.0, "us", None),
        (152.4, "us", "500 FT"),
        (402.3, "us", "1000 FT"),
        (402.4, "us", "1/4 MILE"),
        (804.0, "us", "1/4 MILE"),
        (805.0, "us", "1/2 MILE"),
        (1700.0, "us", "1 MILE"),
        (9999.0, "us", "3 MILES"),
        (149.0, "metric", None),
        (799.9, "metric", "600 M"),
        (1000.0, "metric", "1 KM"),
    ],
)
def test_distances_are_rounded_to_the_near_side(
    distance_m: float, units: str, text: str | None
) -> None:
    found = readable(distance_m, units)  # type: ignore[arg-type]
    assert (found.text if found else None) == text


@pytest.mark.parametrize(("mph", "feet"), [(45, 360), (55, 495), (65, 645), (75, 820)])
def test_stopping_sight_distance_is_that_of_the_green_book(mph: float, feet: float) -> None:
    """Table 3-1 rounds up to five feet."""
    assert stopping_sight_m(mph * 0.44704) / 0.3048 == pytest.approx(feet, abs=5)


def test_the_documented_table_of_distances_is_the_codes() -> None:
    rows = re.findall(r"^\| (\d+) mph \| (\d+) m \((\d+) ft\) \|", DOCS.read_text("utf-8"), re.M)
    assert len(rows) >= 6
    for mph, metres, feet in rows:
        assert warning_distance_m(float(mph)) == pytest.approx(float(metres), abs=0.5)
        assert warning_distance_m(float(mph)) / 0.3048 == pytest.approx(float(feet), abs=0.5)


def test_without_a_limit_the_distance_errs_on_the_long_side_and_a_site_may_say_its_own() -> None:
    assert warning_distance_m(None) == warning_distance_m(65.0)
    assert warning_distance_m(65.0, 700.0) == 700.0


SIGN = {"name": "PCMS 1", "station_m": 0.0}
APPROACH = {"name": "NB", "axis_enu_m": [[0, 0], [9, 0]]}
ROAD = {"site": {"origin": [36.0, -97.0]}, "approach": [APPROACH]}
TWO = {**ROAD, "approach": [APPROACH, {**APPROACH, "name": "SB"}]}


@pytest.mark.parametrize(
    ("raw", "sentence"),
    [
        ({"sign": [{"name": "A"}]}, "either station_m or at"),
        ({"sign": [{**SIGN, "at": [36.0, -97.0]}]}, "either station_m or at"),
        ({"sign": [SIGN, SIGN]}, "two signs have the same name"),
        (
            {"sign": [{**SIGN, "address": "h"}, {**SIGN, "name": "B", "address": "H:161"}]},
            "signs 'PCMS 1' and 'B' have the same address",
        ),
        ({"sign": [{**SIGN, "default": [["ROAD WORK"]]}]}, "default is larger than the sign"),
        ({"sign": [{**SIGN, "characters": 7}]}, "warning does not fit on sign 'PCMS 1'"),
        ({"sign": [{**SIGN, "lines": 2}]}, "2 phases of 2 lines of 8 characters"),
        ({"sign": [{**SIGN, "kind": "beacon", "clear": [["A"]]}]}, "a beacon shows no text"),
        ({"sign": [{**SIGN, "approach": "WB"}], **ROAD}, "which the file does not have; it has NB"),
        ({"sign": [SIGN], **TWO}, "does not say which approach"),
        ({"signs": {"warning": [["STOP"]]}}, "has to tell the distance"),
        ({"signs": {"ahead": [["{distance}"]]}}, "no {distance}"),
        ({"signs": {"caution": []}}, "may not be empty"),
        ({"signs": {"refresh_s": 45}}, "half of duration_min"),
        ({"signs": {"phase_s": 1.0}}, "signs.phase_s"),
        ({"signs": {"holds": 1.0}}, "did you mean 'hold_s'?"),
        ({"sign": [{**SIGN, "default": [["CAFÉ"]]}]}, "'CAFÉ' has characters"),
        ({"sign": [{**SIGN, "default": [["[nl]A"]]}]}, "'[nl]A' has a tag"),
        ({"sign": [{**SIGN, "clear": [["{distance}"]]}]}, "clear is for when no queue is near"),
        ({"signs": {"ahead": [["{when}"]]}}, "'{when}' has a tag"),
        ({"sign": {**SIGN}}, "sign: has to be a list: write [[sign]]"),
        ({"signs": [{"dry_run": True}]}, "signs: has to be one table: write [signs]"),
        ({"sign": [{**SIGN, "default": ["WORK"]}]}, "has to be a list, in brackets"),
    ],
)
def test_a_site_files_signs_are_checked(raw: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_settings(Site, raw, "site.toml")
    assert sentence in str(refused.value)


def test_a_sign_of_another_size_has_its_own_words() -> None:
    words = {"warning": [["SLOW", "{distance}"]], "ahead": [["SLOW"]], "caution": [["SLOW"]]}
    raw = {"sign": [{**SIGN, "lines": 2}], "signs": words}
    assert parse_settings(Site, raw, "site.toml").sign[0].lines == 2
