"""The documents say what the code does: commands, options, keys, links, programs."""

from __future__ import annotations

import argparse
import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from pydantic import BaseModel

import queuetail
from queuetail.cli import main, parser
from queuetail.config import Site, parse_settings, read_site
from queuetail.mapping import control_point_mapping
from short_flight import cut_flight

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
CLIPS = sorted((ROOT / "examples" / "clips").glob("*.toml"))


def fenced(page: Path, language: str) -> list[str]:
    """Return the page's fenced blocks of one language."""
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S)


def shown_commands() -> list[str]:
    """Return the queuetail commands in the pages' console blocks."""
    lines = [line for p in PAGES for block in fenced(p, "console") for line in block.splitlines()]
    return sorted({line for line in lines if line.startswith("queuetail ")})


def subcommands() -> dict[str, argparse.ArgumentParser]:
    found = [a for a in parser()._actions if isinstance(a, argparse._SubParsersAction)]
    return dict(found[0].choices)


def sections(page: Path, heading: str) -> dict[str, str]:
    """Return the text below each heading of a page that matches, by the heading's first group."""
    parts = re.split(r"^## ", page.read_text("utf-8"), flags=re.M)[1:]
    found = [(re.match(heading, part), part) for part in parts]
    return {match[1]: part for match, part in found if match}


def documented(section: str) -> set[str]:
    """Return the names in backticks of the first column of the section's tables."""
    rows = re.findall(r"^\| (`.*?) \|", section, re.M)
    return {name.split()[0] for row in rows for name in re.findall(r"`([^`]+)`", row)}


@pytest.mark.parametrize("command", shown_commands())
def test_commands_shown_are_commands(command: str) -> None:
    parser().parse_args(shlex.split(command, comments=True)[1:])


def test_every_command_and_option_is_documented_and_exists() -> None:
    pages = sections(ROOT / "docs" / "commands.md", r"queuetail (\w+)")
    commands = subcommands()
    assert set(pages) == set(commands)
    for name, command in commands.items():
        actions = [a for a in command._actions if a.dest != "help"]
        options = {a.option_strings[-1] if a.option_strings else str(a.metavar) for a in actions}
        assert documented(pages[name]) == options, name


def site_tables() -> Iterator[tuple[str, type[BaseModel]]]:
    for name, field in Site.model_fields.items():
        arguments = [a for a in getattr(field.annotation, "__args__", ()) if isinstance(a, type)]
        model = arguments[0] if arguments else field.annotation
        assert isinstance(model, type)
        assert issubclass(model, BaseModel)
        yield name, model


def test_every_key_of_the_site_file_is_documented_and_exists() -> None:
    pages = sections(ROOT / "docs" / "sites.md", r"`\[+(\w+)\]+`")
    tables = dict(site_tables())
    assert set(pages) == set(tables)
    for name, model in tables.items():
        assert documented(pages[name]) == set(model.model_fields), name


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_toml_shown_is_valid(page: Path) -> None:
    for block in fenced(page, "toml"):
        raw = tomllib.loads(block)
        if page.name in ("README.md", "quickstart.md", "sites.md"):
            parse_settings(Site, raw, page.name)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_links_and_pictures_are_here(page: Path) -> None:
    text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.M | re.S)
    for picture, target in re.findall(r"(!?)\[[^\]]*\]\(([^)\s]+)\)", text):
        if target.startswith("http"):
            assert not picture, f"{target} is not part of the project"
            continue
        path, _, anchor = target.partition("#")
        goal = (page.parent / path).resolve() if path else page
        assert goal.exists(), target
        assert not anchor or anchor in anchors(goal), target
    assert "<img" not in text


def anchors(page: Path) -> set[str]:
    """Return the anchors that GitHub gives to a page's headings."""
    headings = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.M)
    plain = [re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-") for h in headings]
    return set(plain)


def test_the_demo_picture_is_small() -> None:
    assert (ROOT / "docs" / "images" / "demo.jpg").stat().st_size < 300_000


def test_the_program_in_the_readme_is_that_of_the_package() -> None:
    assert queuetail.__doc__ is not None
    program = queuetail.__doc__.split("\n\n", 2)[2]
    assert "\n".join(line.removeprefix("    ") for line in program.splitlines()).strip() == (
        fenced(ROOT / "README.md", "python")[0].strip()
    )


def test_the_program_in_the_readme_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the flight's first seconds, in which a queue may or may not be seen."""
    flight = tmp_path / "examples" / "flagger"
    flight.mkdir(parents=True)
    cut_flight(ROOT / "examples" / "flagger" / "flight.mp4", flight / "flight.mp4", 1.5)
    for name in ("telemetry.csv", "site.toml"):
        shutil.copy(ROOT / "examples" / "flagger" / name, flight / name)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(fenced(ROOT / "README.md", "python")[0], names)
    assert (tmp_path / "out" / "first" / "queue.csv").stat().st_size > 0
    assert not (tmp_path / "out" / "first" / "annotated.mp4").exists()


def test_every_public_name_is_there() -> None:
    for name in queuetail.__all__:
        assert getattr(queuetail, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        queuetail.__getattr__("nothing")


def test_locating_as_shown(capsys: pytest.CaptureFixture[str]) -> None:
    flight = ROOT / "examples" / "flagger"
    command = ["locate", str(flight / "flight.mp4"), "640,360", "--time", "12.5"]
    assert main([*command, "--telemetry", str(flight / "telemetry.csv")]) == 0
    assert re.match(r"36\.\d{7},-97\.\d{7}  ± \d+\.\d m\n", capsys.readouterr().out)


@pytest.mark.parametrize("clip", CLIPS, ids=lambda p: p.stem)
def test_the_markings_of_the_real_clips_fit_a_plane(clip: Path) -> None:
    """The residuals that the site files and docs/real-clips.md tell."""
    site = read_site(clip)
    size = (1280, 720) if clip.stem.startswith("06") else (640, 360)
    assert control_point_mapping(site, None, *size).sigma_m < 0.15
    assert len(site.approach) == 2
