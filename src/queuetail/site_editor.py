"""Changing a site file: a table's keys in its own text, comments kept, or the whole file anew."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from queuetail.config import Site, parse_settings
from queuetail.errors import InputError
from queuetail.files import write_text

Value = str | int | float | bool | None


def whole_text(site: Site) -> str:
    """Return the settings as a site file, without what is the default anyway."""
    given = site.model_dump(mode="json", exclude_defaults=True, exclude_none=True)
    tables = [_table(f"[{name}]", value) for name, value in given.items() if _is_table(value)]
    for name, entries in given.items():
        if isinstance(entries, list):
            tables += [_table(f"[[{name}]]", entry) for entry in entries]
    return "\n".join(tables)


def with_table(text: str, table: str, values: Mapping[str, Value]) -> str:
    """Return a site file's text with some scalar keys of one table set; None takes one away.

    Where the text is too unusual to be edited in place it is written anew, without its comments.
    """
    before = tomllib.loads(text)
    wanted = {**before, table: {**before.get(table, {}), **values}}
    wanted[table] = {k: v for k, v in wanted[table].items() if v is not None}
    edited = _edited(text, table, values)
    try:
        if tomllib.loads(edited) == wanted or not wanted[table]:
            return edited
    except tomllib.TOMLDecodeError:
        pass
    return whole_text(parse_settings(Site, wanted, "the site file"))


def save(path: Path, text: str, *, overwrite: bool = False) -> Site:
    """Write a site file once it is valid, and return its settings.

    Raises InputError where it is not, or where a file is there and may not be overwritten.
    """
    site = parse_settings(Site, tomllib.loads(text), str(path))
    if path.exists() and not overwrite:
        raise InputError(f"{path} exists already, and was left as it is")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, text)
    except OSError as error:
        raise InputError(f"{path} cannot be written ({error.strerror})") from None
    return site


def _edited(text: str, table: str, values: Mapping[str, Value]) -> str:
    lines = text.splitlines()
    header = re.compile(rf"\s*\[\s*{re.escape(table)}\s*\]\s*(#.*)?$")
    begin = next((i for i, line in enumerate(lines) if header.match(line)), None)
    if begin is None:
        new = [f"{k} = {_literal(v)}" for k, v in values.items() if v is not None]
        return "\n".join([*lines, *([""] if lines else []), f"[{table}]", *new]) + "\n"
    end = next(
        (i for i in range(begin + 1, len(lines)) if re.match(r"\s*\[", lines[i])), len(lines)
    )
    section = lines[begin + 1 : end]
    for key, value in values.items():
        mine = re.compile(rf"\s*{re.escape(key)}\s*=")
        at = next((i for i, line in enumerate(section) if mine.match(line)), None)
        if value is None:
            section = [line for line in section if not mine.match(line)]
        elif at is None:
            last = max((i for i, line in enumerate(section) if line.strip()), default=-1)
            section.insert(last + 1, f"{key} = {_literal(value)}")
        else:
            section[at] = f"{key} = {_literal(value)}"
    return "\n".join([*lines[: begin + 1], *section, *lines[end:]]) + "\n"


def _is_table(value: Any) -> bool:
    return isinstance(value, dict)


def _table(header: str, values: Mapping[str, Any]) -> str:
    return "\n".join([header, *(f"{k} = {_literal(v)}" for k, v in values.items())]) + "\n"


def _literal(value: Any) -> str:
    """Return a value in TOML; JSON's strings and numbers are TOML's, too."""
    if isinstance(value, list):
        return "[" + ", ".join(_literal(v) for v in value) + "]"
    if isinstance(value, float):
        return repr(value)
    text = json.dumps(value, ensure_ascii=False)
    return text.replace("\x7f", "\\u007f")
