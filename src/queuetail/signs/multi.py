"""MULTI, the markup of NTCIP 1203 section 6: built from phases, and read back.

Only what queuetail writes and what a simulated sign shows is understood; anything else is refused
with the kind of fault and its place, as dmsMultiSyntaxError has them.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import IntEnum

from queuetail.signs.records import Phases

DEFAULT_ON_S, DEFAULT_OFF_S = 3.0, 0.0  # dmsPageOnTime and dmsPageOffTime of the simulated sign
TAG = re.compile(r"\[\[|\]\]|\[([^\[\]]*)\]|\[|\]|[^\[\]]+")
# Tags that change nothing of what queuetail needs to know of a message: fonts and colours.
IGNORED = re.compile(r"(fo\d*(,[0-9a-f]{4})?|cf\d*|cb\d*|pb\d*|sc\d+(,\d+)?|/sc)$")


class Syntax(IntEnum):
    """dmsMultiSyntaxError."""

    OTHER = 1
    NONE = 2
    UNSUPPORTED_TAG = 3
    UNSUPPORTED_TAG_VALUE = 4
    TEXT_TOO_BIG = 5
    FONT_NOT_DEFINED = 6
    CHARACTER_NOT_DEFINED = 7
    FIELD_DEVICE_NOT_EXIST = 8
    FIELD_DEVICE_ERROR = 9
    FLASH_REGION_ERROR = 10
    TAG_CONFLICT = 11
    TOO_MANY_PAGES = 12
    FONT_VERSION_ID = 13
    GRAPHIC_ID = 14
    GRAPHIC_NOT_DEFINED = 15
    INVALID_CHARACTER_ENCODING = 16


class MultiError(ValueError):
    """A MULTI string that is not understood: what is wrong, and at which character."""

    def __init__(self, syntax: Syntax, position: int) -> None:
        super().__init__(f"{syntax.name.lower().replace('_', ' ')} at character {position}")
        self.syntax, self.position = syntax, position


@dataclass(frozen=True, slots=True)
class Line:
    """One line of a page, and how it lies on the sign: left, centre, right or full."""

    text: str
    justify: str = "centre"
    flash: bool = False


@dataclass(frozen=True, slots=True)
class Page:
    """One page: its lines, whether they lie at the top, middle or bottom, and its times."""

    lines: tuple[Line, ...]
    vertical: str = "middle"
    on_s: float = DEFAULT_ON_S
    off_s: float = DEFAULT_OFF_S


def build(phases: Phases, phase_s: float) -> str:
    """Return the MULTI text of phases: middle of the sign, lines centred; empty for blank."""
    if not phases:
        return ""
    pages = ["[nl]".join(_escaped(line) for line in lines) for lines in phases]
    head = f"[pt{round(phase_s * 10)}o0]" if len(pages) > 1 else ""
    return f"{head}[jp3][jl3]{'[np]'.join(pages)}"


def parse(multi: str) -> tuple[Page, ...]:
    """Read a MULTI text into pages; raises MultiError."""
    reader = _Reader()
    for match in TAG.finditer(multi):
        token = match.group(0)
        if token in ("[[", "]]"):
            reader.add(token[0])
        elif token in ("[", "]"):
            raise MultiError(Syntax.UNSUPPORTED_TAG, match.start())
        elif match.group(1) is not None:
            reader.tag(match.group(1).lower(), match.start())
        else:
            reader.text(token, match.start())
    return reader.pages()


def phases_of(multi: str) -> Phases:
    """Return the words of a MULTI text, page by page; raises MultiError."""
    pages = parse(multi)
    found = tuple(tuple(line.text for line in page.lines) for page in pages)
    return found if any(any(lines) for lines in found) else ()


class _Reader:
    """What has been read so far."""

    def __init__(self) -> None:
        self._pages: list[Page] = []
        self._lines: list[Line] = []
        self._text = ""
        self._justify, self._vertical = "centre", "middle"
        self._flash, self._flashed = False, False
        self._on_s, self._off_s = DEFAULT_ON_S, DEFAULT_OFF_S

    def add(self, character: str) -> None:
        self._text += character
        self._flashed |= self._flash

    def text(self, text: str, position: int) -> None:
        for offset, character in enumerate(text):
            if not " " <= character <= "~":
                raise MultiError(Syntax.CHARACTER_NOT_DEFINED, position + offset)
            self.add(character)

    def tag(self, tag: str, position: int) -> None:
        if re.fullmatch(r"nl\d?", tag):
            self._end_line()
        elif tag == "np":
            self._end_page()
        elif match := re.fullmatch(r"jl(\d?)", tag):
            sides = {"": "centre", "2": "left", "3": "centre", "4": "right", "5": "full"}
            self._justify = _known(sides, match[1], position)
        elif match := re.fullmatch(r"jp(\d?)", tag):
            places = {"": "middle", "2": "top", "3": "middle", "4": "bottom"}
            self._vertical = _known(places, match[1], position)
        elif match := re.fullmatch(r"pt(\d{0,3})(?:o(\d{1,3}))?", tag):
            self._on_s = int(match[1]) / 10 if match[1] else DEFAULT_ON_S
            self._off_s = int(match[2]) / 10 if match[2] else DEFAULT_OFF_S
            if self._on_s == 0:
                raise MultiError(Syntax.UNSUPPORTED_TAG_VALUE, position)
        elif re.fullmatch(r"fl(t\d{1,3}o\d{1,3})?", tag):
            self._flash = True
        elif tag == "/fl":
            self._flash = False
        elif match := re.fullmatch(r"hc([0-9a-f]{1,4})", tag):
            self.text(chr(int(match[1], 16)), position)
        elif not IGNORED.fullmatch(tag):
            raise MultiError(Syntax.UNSUPPORTED_TAG, position)

    def pages(self) -> tuple[Page, ...]:
        self._end_page()
        return tuple(self._pages)

    def _end_line(self) -> None:
        self._lines.append(Line(self._text, self._justify, self._flashed))
        self._text, self._flashed = "", False

    def _end_page(self) -> None:
        self._end_line()
        self._pages.append(Page(tuple(self._lines), self._vertical, self._on_s, self._off_s))
        self._lines = []


def _known(table: dict[str, str], key: str, position: int) -> str:
    if key not in table:
        raise MultiError(Syntax.UNSUPPORTED_TAG_VALUE, position)
    return table[key]


def _escaped(line: str) -> str:
    return line.replace("[", "[[").replace("]", "]]")
