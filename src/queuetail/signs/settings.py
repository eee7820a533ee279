"""`[[sign]]` and `[signs]` of a site file: which signs there are and how they are to be used."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, model_validator

from queuetail.settings import Finite, LatLon, Settings
from queuetail.signs.messages import DISTANCE, LONGEST_DISTANCE, fit, unshowable, with_distance
from queuetail.signs.records import Phases, SignKind


def _shown(line: str) -> str:
    if sentence := unshowable(line):
        raise ValueError(sentence)
    return line


Line = Annotated[str, Field(max_length=40), AfterValidator(_shown)]
Text = Annotated[
    tuple[Annotated[tuple[Line, ...], Field(min_length=1, max_length=6)], ...], Field(max_length=2)
]
Seconds = Annotated[float, Field(gt=0, le=3600)]


class SignSite(Settings):
    """`[[sign]]`: one warning sign; the size defaults to that of portable signs in the MUTCD."""

    name: Annotated[str, Field(min_length=1, max_length=60)]
    kind: SignKind = SignKind.PORTABLE
    approach: str | None = None  # whose traffic it warns; may be left out where there is one
    station_m: Finite | None = None
    at: LatLon | None = None
    lines: Annotated[int, Field(ge=1, le=6)] = 3
    characters: Annotated[int, Field(ge=4, le=40)] = 8
    phases: Annotated[int, Field(ge=1, le=2)] = 2
    default: Text = ()  # shown while nothing is known; blank unless given
    clear: Text = ()  # shown while there is no queue; blank unless given
    address: str | None = None  # host or host:port of its NTCIP controller
    secrets: str | None = None  # file with the community or the user, readable by its owner only
    message_number: Annotated[int, Field(ge=1, le=255)] = 1  # changeable; the default's is the next

    @model_validator(mode="after")
    def _is_whole(self) -> SignSite:
        if (self.station_m is None) == (self.at is None):
            raise ValueError("a sign needs either station_m or at (latitude, longitude)")
        if self.kind is SignKind.BEACON and (self.default or self.clear):
            raise ValueError("a beacon shows no text: leave default and clear out")
        for key, text in (("default", self.default), ("clear", self.clear)):
            if DISTANCE in _words(text):
                raise ValueError(f"{key} is for when no queue is near: no {DISTANCE}")
            if fit(text, self.lines, self.characters, self.phases) != text:
                raise ValueError(f"{key} is larger than the sign, which has {self.size}")
        return self

    @property
    def size(self) -> str:
        """The size in words."""
        phases = "one phase" if self.phases == 1 else f"{self.phases} phases"
        return f"{phases} of {self.lines} lines of {self.characters} characters"


class SignsSettings(Settings):
    """`[signs]`: when and how far ahead signs warn, their words, and how they are controlled."""

    units: Literal["us", "metric"] = "us"
    warning_distance_m: Annotated[float, Field(gt=0, le=5000)] | None = None
    reach_m: Annotated[float, Field(gt=0, le=20_000)] = 3300.0  # 2 miles
    sigma_factor: Annotated[float, Field(ge=0, le=5)] = 2.0
    max_age_s: Annotated[float, Field(ge=0.5, le=30)] = 2.0
    hold_s: Annotated[float, Field(ge=0, le=600)] = 60.0
    release_s: Seconds = 10.0
    phase_s: Annotated[float, Field(ge=2, le=4)] = 2.5  # MUTCD: 2 s or more, 8 s in all at most
    warning: Text = (("STOPPED", "TRAFFIC", DISTANCE), ("PREPARE", "TO STOP"))
    ahead: Text = (("STOPPED", "TRAFFIC", "AHEAD"), ("PREPARE", "TO STOP"))
    caution: Text = (("BE", "PREPARED", "TO STOP"),)
    priority: Annotated[int, Field(ge=1, le=255)] = 100
    duration_min: Annotated[int, Field(ge=1, le=10)] = 1
    refresh_s: Annotated[float, Field(ge=1, le=120)] = 20.0
    comm_loss_min: Annotated[int, Field(ge=1, le=60)] = 2
    disarm_after_s: Annotated[float, Field(ge=1, le=3600)] = 120.0
    dry_run: bool = False

    @model_validator(mode="after")
    def _is_safe(self) -> SignsSettings:
        if DISTANCE not in _words(self.warning):
            raise ValueError(f"warning has to tell the distance, as {DISTANCE}")
        if DISTANCE in _words(self.ahead) or DISTANCE in _words(self.caution):
            raise ValueError(f"ahead and caution are for when no distance is known: no {DISTANCE}")
        if not _words(self.ahead) or not _words(self.caution):
            raise ValueError("ahead and caution may not be empty: they warn drivers")
        if self.refresh_s > 30 * self.duration_min:
            raise ValueError(
                "refresh_s has to be half of duration_min or less, or the sign goes blank between"
            )
        return self


def check_signs(signs: Iterable[SignSite], settings: SignsSettings, approaches: set[str]) -> None:
    """Check the signs against each other, the words and the approaches; raises ValueError."""
    signs = tuple(signs)
    names = [sign.name for sign in signs]
    if len(set(names)) != len(names):
        raise ValueError("two signs have the same name")
    at: dict[str, SignSite] = {}
    for sign in signs:
        if (
            sign.address is not None
            and (other := at.setdefault(_whole(sign.address), sign)) != sign
        ):
            raise ValueError(
                f"signs {other.name!r} and {sign.name!r} have the same address, {sign.address}"
            )
        if sign.approach is not None and approaches and sign.approach not in approaches:
            raise ValueError(
                f"sign {sign.name!r} is for approach {sign.approach!r}, which the file does not "
                f"have; it has {', '.join(sorted(approaches))}"
            )
        if sign.approach is None and len(approaches) > 1:
            raise ValueError(
                f"sign {sign.name!r} does not say which approach it is for; "
                f"approach is one of {', '.join(sorted(approaches))}"
            )
        if sign.kind is SignKind.BEACON:
            continue
        for key in ("warning", "ahead", "caution"):
            text: Phases = with_distance(getattr(settings, key), LONGEST_DISTANCE[settings.units])
            if not fit(text, sign.lines, sign.characters, sign.phases):
                raise ValueError(
                    f"[signs] {key} does not fit on sign {sign.name!r}, which has {sign.size}"
                )


def _whole(address: str) -> str:
    """Return an address with its port, so that two ways to write it are the same."""
    has_port = re.search(r"(^[^:]*|\]):\d+$", address) is not None
    return address.lower() if has_port else f"{address.lower()}:161"


def _words(text: Phases) -> str:
    return " ".join(" ".join(lines) for lines in text).strip()
