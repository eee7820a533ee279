"""Words on a sign: how they fit its size.

The MUTCD (2009, sections 2L.05 and 6F.60) allows portable signs two phases of three lines of eight
characters, each phase understandable by itself and shown for 2 s or more, 8 s in all at most.
"""

from __future__ import annotations

import re

from queuetail.signs.records import Phases

DISTANCE = "{distance}"
TAG = re.compile(r"[\[\]{}]")
LONGEST_DISTANCE = {"us": "1 1/2 MI", "metric": "1.5 KM"}


def with_distance(text: Phases, distance: str) -> Phases:
    """Return the text with the distance put in."""
    return tuple(tuple(line.replace(DISTANCE, distance) for line in lines) for lines in text)


def unshowable(line: str) -> str:
    """Say what is wrong with a line of text; empty for what every sign can show."""
    if not line.isascii() or (line and not line.isprintable()):
        return f"'{line}' has characters that signs cannot show; use plain ASCII"
    if TAG.search(line.replace(DISTANCE, "")):
        return f"'{line}' has a tag; text takes none but {DISTANCE}, where a distance is told"
    return ""


def fit(text: Phases, lines: int, characters: int, phases: int) -> Phases:
    """Return the text as it fits a sign, or no phase at all where it does not.

    Its own lines are kept where they fit; else words are wrapped anew; where the sign has fewer
    phases, the first ones are kept: each phase is understandable by itself.
    """
    fitted = []
    for phase in text[:phases]:
        page = phase if _fits(phase, lines, characters) else _wrapped(phase, characters)
        if not _fits(page, lines, characters):
            return ()
        fitted.append(page)
    return tuple(fitted)


def _fits(page: tuple[str, ...], lines: int, characters: int) -> bool:
    return len(page) <= lines and all(len(line) <= characters for line in page)


def _wrapped(phase: tuple[str, ...], characters: int) -> tuple[str, ...]:
    """Put as many of the phase's lines side by side as there is room for; none is broken."""
    rows: list[str] = []
    for line in phase:
        joined = f"{rows[-1]} {line}" if rows else line
        if rows and len(joined) <= characters:
            rows[-1] = joined
        else:
            rows.append(line)
    return tuple(rows)
