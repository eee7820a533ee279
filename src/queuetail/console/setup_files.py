"""Putting settings to use: checked, saved as a site file without overwriting unasked, and run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Protocol, runtime_checkable

from fastapi import HTTPException
from pydantic import BaseModel, Field

from queuetail.config import Site, parse_settings
from queuetail.console.source import ConsoleSource
from queuetail.errors import InputError
from queuetail.site_editor import save

FOLDER = Path("sites")  # for new site files, where the run has none
FileName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9 _.\-]{0,59}\.toml$")]


@runtime_checkable
class Adjustable(Protocol):
    """A source whose run can go on with other settings."""

    def adjust(self, site: Site, site_file: Path | None) -> None:
        """Go on with other settings; raises InputError where they do not fit."""


class Saving(BaseModel):
    """Whether settings are kept in a file, too."""

    file: FileName | None = Field(
        None, description="in the folder of the site file; none: not kept"
    )
    overwrite: bool = False


class Used(BaseModel):
    """What became of settings."""

    in_use: bool = Field(description="the run goes on with them; a finished one cannot")
    file: str | None = Field(description="where they are kept")


def folder_of(source: ConsoleSource) -> Path:
    """Return the folder that site files are kept in."""
    given = source.about.site_file
    return given.parent if given is not None else FOLDER


def checked(raw: dict[str, Any]) -> Site:
    """Return settings that were put together; raises HTTPException with the first fault."""
    try:
        return parse_settings(Site, raw, "the settings")
    except InputError as error:
        raise HTTPException(422, str(error)) from None


def use(source: ConsoleSource, site: Site, text: str, saving: Saving) -> Used:
    """Keep a site file's text and let the run go on with it; both or none of them.

    Raises HTTPException: 409 where a file is there that may not be overwritten.
    """
    path = folder_of(source) / saving.file if saving.file is not None else None
    if path is not None and path.exists() and not saving.overwrite:
        raise HTTPException(409, f"{path.name} exists already: may it be overwritten?")
    try:
        if path is not None:
            save(path, text, overwrite=saving.overwrite)
        if isinstance(source, Adjustable):
            source.adjust(site, path or source.about.site_file)
            return Used(in_use=True, file=str(path) if path else None)
    except InputError as error:
        raise HTTPException(422, str(error)) from None
    return Used(in_use=False, file=str(path) if path else None)
