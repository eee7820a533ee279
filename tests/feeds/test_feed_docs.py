"""docs/feeds.md: its examples are what queuetail writes, and every key and field is explained."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from cap_schema import check_alert
from feed_answers import START, answer, queue
from lxml import etree
from pydantic import BaseModel
from test_pages import CIFS_SCHEMA, cifs, wzdx
from wzdx_schema import device_feed_validator

from queuetail import __version__
from queuetail.config import Site, parse_settings
from queuetail.feeds import cap, cot, settings
from queuetail.feeds.episodes import NoticeBook
from queuetail.feeds.settings import CotFeed
from queuetail.feeds.state_json import FORMAT, state_record

SECTIONS: dict[str, type[BaseModel]] = {
    "WZDx": settings.WzdxFeed,
    "Waze CIFS": settings.CifsFeed,
    "CAP": settings.CapFeed,
    "MQTT": settings.MqttFeed,
    "Webhooks": settings.WebhookFeed,
    "Cursor on Target": settings.CotFeed,
    "TIM": settings.TimFeed,
    "DENM": settings.DenmFeed,
}


@pytest.fixture(scope="module")
def page(root: Path) -> str:
    return (root / "docs" / "feeds.md").read_text("utf-8")


def section(page: str, title: str) -> str:
    (found,) = re.findall(rf"^## {title}\n(.*?)(?=^## |\Z)", page, re.M | re.S)
    return str(found)


def block(text: str, language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", text, re.M | re.S)
    return str(found)


@pytest.mark.parametrize("title", SECTIONS)
def test_every_key_is_explained_and_exists(page: str, title: str) -> None:
    text = section(page, title).split("\n### ")[0]
    (table,) = text.split("| key | meaning | default |")[1:]
    rows = re.findall(r"^\| (`.*?) \|", table, re.M)
    found = {name for row in rows for name in re.findall(r"`([^`]+)`", row)}
    assert found == set(SECTIONS[title].model_fields)


def test_every_field_of_the_state_is_explained(page: str) -> None:
    record = state_record(answer(queue()), 10.0)
    inner = {f"end.{name}" for name in record["end"]}
    text = section(page, "MQTT").split("### The state")[1]
    rows = re.findall(r"^\| (`.*?) \|", text, re.M)
    found = {name for row in rows for name in re.findall(r"`([^`]+)`", row)}
    assert found == set(record) | inner


def test_the_site_file_shown_is_one(page: str, root: Path) -> None:
    (added,) = re.findall(r"<<'END'\n(.*?)^END$", page, re.M | re.S)
    text = (root / "examples" / "flagger" / "site.toml").read_text("utf-8") + added
    site = parse_settings(Site, tomllib.loads(text), "docs/feeds.md")
    assert site.feeds.cot is not None


def written() -> dict[str, Any]:
    """Return the examples as queuetail writes them."""
    pages = wzdx()
    pages.take((answer(queue()),), 0.0)
    incidents = cifs()
    incidents.take((answer(queue()),), 0.0)
    (notice,) = NoticeBook("i-35-1f2e3d4c", 120.0, 40.0, 0.0, 25.0).take((answer(queue()),), 0.0)
    feed = settings.CapFeed(sender="noc@example.org", addresses="noc")
    return {
        "WZDx": pages.record(1.0, START),
        "Waze CIFS": json.loads(incidents.build(1.0, START)),
        "MQTT": {
            "format": FORMAT,
            "site": "I-35 NB at MP 174",
            "approaches": [state_record(answer(queue()), 10.0)],
        },
        "CAP": cap.alert_text(notice, "Example DOT", "I-35", feed),
        "Cursor on Target": cot.event(notice, CotFeed()),
    }


@pytest.mark.parametrize("title", ["WZDx", "Waze CIFS", "MQTT"])
def test_the_json_shown_is_what_is_written(page: str, title: str) -> None:
    shown = json.loads(block(section(page, title), "json").replace("0.1.0", __version__))
    assert shown == written()[title]


@pytest.mark.parametrize("title", ["CAP", "Cursor on Target"])
def test_the_xml_shown_is_what_is_written(page: str, title: str) -> None:
    parser = etree.XMLParser(remove_blank_text=True)
    shown = etree.fromstring(block(section(page, title), "xml").strip().encode(), parser)
    assert etree.tostring(shown) == etree.tostring(etree.fromstring(written()[title], parser))


def test_the_examples_are_valid(page: str, shared: Path) -> None:
    feed = json.loads(block(section(page, "WZDx"), "json"))
    device_feed_validator(shared).validate(feed)
    jsonschema.validate(json.loads(block(section(page, "Waze CIFS"), "json")), CIFS_SCHEMA)
    parser = etree.XMLParser(remove_blank_text=True)
    shown = etree.fromstring(block(section(page, "CAP"), "xml").strip().encode(), parser)
    check_alert(etree.tostring(shown))


def test_the_commands_shown_can_be_read(page: str) -> None:
    for text in re.findall(r"^```console\n(.*?)^```", page, re.M | re.S):
        for line in text.split("cat >>")[0].splitlines():
            shlex.split(line)
