"""Site files and presets: TOML into frozen settings; every unknown key is refused with a hint."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator

from queuetail.errors import InputError
from queuetail.feeds.settings import FeedsSettings
from queuetail.settings import Finite, Latitude, LatLon, Longitude, Metres2, Settings
from queuetail.signs.settings import SignSite, SignsSettings, check_signs

T = TypeVar("T", bound="Settings")

MPS_PER_MPH = 0.44704
KM_PER_DEGREE = 111.0  # of latitude; of longitude it is less, which a sanity check may ignore
MAX_LEG_KM = 100.0  # no road is straight for longer: a digit or a sign is wrong
LIST = "has to be a list, in brackets"
DEFAULT_QUEUE_SPEED_MPH = 25.0  # Messenger et al. (2023): where no limit is posted


class SiteInfo(Settings):
    """`[site]`: what the place is called and what is posted there."""

    name: str = "unnamed site"
    posted_speed_mph: Annotated[float, Field(gt=0, le=120)] | None = None
    origin: LatLon | None = None  # the place of enu_m (0, 0), where that is known


class CameraOverride(Settings):
    """`[camera]`: what is known better than telemetry says of the lens."""

    hfov_deg: Annotated[float, Field(gt=0, lt=180)] | None = None
    distortion: Annotated[tuple[Finite, ...], Field(max_length=5)] = ()


CONSTANTS = (
    *("lat_deg", "lon_deg", "height_agl_m"),
    *("heading_deg", "gimbal_pitch_deg", "gimbal_roll_deg"),
)


class TelemetryFill(Settings):
    """`[telemetry]`: constants for what the flight log lacks, and what is to be added to it."""

    offset_s: Finite = 0.0  # added to the log's times: positive where the log started later
    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    height_agl_m: Annotated[float, Field(gt=0, le=10_000)] | None = None
    heading_deg: Finite | None = None
    gimbal_pitch_deg: Annotated[float, Field(ge=-90, le=90)] | None = None
    gimbal_roll_deg: Finite | None = None
    # Added to what the log or a constant says, as `queuetail check --improve` finds them.
    heading_offset_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    pitch_offset_deg: Annotated[float, Field(ge=-45, le=45)] = 0.0
    height_offset_m: Annotated[float, Field(ge=-1000, le=1000)] = 0.0

    @property
    def constants(self) -> dict[str, float]:
        """The fields that are filled, and with what."""
        return {n: v for n in CONSTANTS if (v := getattr(self, n)) is not None}


class QueueSettings(Settings):
    """`[queue]`: which speed counts as queued."""

    speed_mph: Annotated[float, Field(gt=0, le=120)] | None = None


class ApproachSite(Settings):
    """`[[approach]]`: one carriageway in one direction, along the left edge of its left lane."""

    name: Annotated[str, Field(min_length=1)]
    lanes: Annotated[int, Field(ge=1, le=12)] = 1
    lane_width_m: Annotated[float, Field(gt=1.5, lt=10)] = 3.5
    start_station_m: Finite = 0.0  # of the axis' first point
    taper_station_m: Finite | None = None  # where the first lane begins to close
    axis: tuple[LatLon, ...] | None = None
    axis_enu_m: tuple[Metres2, ...] | None = None

    @model_validator(mode="after")
    def _has_one_axis(self) -> ApproachSite:
        points = self.axis if self.axis is not None else self.axis_enu_m
        if points is None or (self.axis is not None and self.axis_enu_m is not None):
            raise ValueError("an approach needs either axis or axis_enu_m")
        if len(points) < 2:
            raise ValueError("an axis needs two points or more, in the direction of travel")
        if any(math.dist(a, b) == 0 for a, b in pairwise(points)):
            raise ValueError("an axis has the same point twice in a row")
        unit_km = KM_PER_DEGREE if self.axis is not None else 1e-3
        longest_km = unit_km * max(math.dist(a, b) for a, b in pairwise(points))
        if longest_km > MAX_LEG_KM:
            raise ValueError(
                f"two neighbouring points of the axis lie about {longest_km:.0f} km apart; "
                "give the road near the drone, as [latitude, longitude]"
            )
        return self


class ControlPoint(Settings):
    """`[[control_point]]`: a pixel whose place on the ground is known."""

    px: Metres2
    at: LatLon | None = None
    enu_m: Metres2 | None = None

    @model_validator(mode="after")
    def _has_one_place(self) -> ControlPoint:
        if (self.at is None) == (self.enu_m is None):
            raise ValueError("a control point needs either at (latitude, longitude) or enu_m")
        return self


class PaperSettings(Settings):
    """`[paper]`: the sliders of Messenger et al. (2023), in pixels of the scaled picture."""

    width_px: Annotated[int, Field(ge=160, le=3840)] = 720
    blur_px: Annotated[int, Field(ge=3, le=31)] = 5
    background: Literal["mog2", "average", "first"] = "mog2"
    dilate_px: Annotated[int, Field(ge=3, le=9)] = 5
    min_blob_px2: Annotated[float, Field(gt=0)] = 40.0
    direction_deg: Finite | None = None  # compass course of the queue, where there is no approach


class Site(Settings):
    """A whole site file; the defaults stand for no site file at all."""

    site: SiteInfo = SiteInfo()
    camera: CameraOverride = CameraOverride()
    telemetry: TelemetryFill = TelemetryFill()
    queue: QueueSettings = QueueSettings()
    approach: tuple[ApproachSite, ...] = ()
    control_point: tuple[ControlPoint, ...] = ()
    paper: PaperSettings = PaperSettings()
    sign: tuple[SignSite, ...] = ()
    signs: SignsSettings = SignsSettings()
    feeds: FeedsSettings = FeedsSettings()

    @model_validator(mode="after")
    def _has_signs_that_fit(self) -> Site:
        check_signs(self.sign, self.signs, {a.name for a in self.approach})
        return self

    @model_validator(mode="after")
    def _is_consistent(self) -> Site:
        names = [a.name for a in self.approach]
        if len(set(names)) != len(names):
            raise ValueError("two approaches have the same name")
        if 0 < len(self.control_point) < 4:
            raise ValueError(
                f"{len(self.control_point)} control points given, at least 4 are needed"
            )
        geodetic = [c.at is not None for c in self.control_point]
        geodetic += [a.axis is not None for a in self.approach]
        local = [c.enu_m is not None for c in self.control_point]
        local += [a.axis_enu_m is not None for a in self.approach]
        if any(geodetic) and any(local) and self.site.origin is None:
            raise ValueError(
                "the file mixes latitude/longitude with local metres; "
                "say where (0, 0) is with origin = [latitude, longitude] in [site]"
            )
        local_axes = any(a.axis_enu_m is not None for a in self.approach)
        if local_axes and not self.control_point and self.site.origin is None:
            raise ValueError(
                "axis_enu_m counts metres from an unknown place; "
                "say where (0, 0) is with origin = [latitude, longitude] in [site]"
            )
        return self

    @property
    def queue_speed_mps(self) -> float:
        """The speed below which a vehicle counts as queued: a third of the limit, or 25 mph."""
        if self.queue.speed_mph is not None:
            return self.queue.speed_mph * MPS_PER_MPH
        if self.site.posted_speed_mph is not None:
            return self.site.posted_speed_mph * MPS_PER_MPH / 3
        return DEFAULT_QUEUE_SPEED_MPH * MPS_PER_MPH


def read_site(path: Path) -> Site:
    """Read a site file; raises InputError with the file, the key and the mend."""
    return parse_settings(Site, read_toml(path, "site file"), str(path))


def read_toml(path: Path, kind: str) -> dict[str, Any]:
    """Read a TOML file that should be a `kind`; raises InputError in those words."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such {kind}") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a folder, not a {kind}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file in UTF-8, so it is no {kind}") from None
    except OSError as error:
        raise InputError(f"{path}: the {kind} cannot be read ({error.strerror})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not valid TOML: {error}") from None


def parse_settings(model: type[T], raw: dict[str, Any], source: str) -> T:
    """Validate `raw` against `model`; raises InputError naming the first thing that is wrong."""
    try:
        return model.model_validate(raw)
    except ValidationError as error:
        raise InputError(f"{source}: {_first_problem(model, error)}") from None


def _first_problem(model: type[Settings], error: ValidationError) -> str:
    problem = error.errors()[0]
    location = problem["loc"]
    where = _dotted(location)
    if problem["type"] == "extra_forbidden":
        table = _dotted(location[:-1])
        known = list(_fields_at(model, location[:-1]))
        near = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(sorted(known))}"
        inside = f" in [{table}]" if table else ""
        return f"unknown key {location[-1]!r}{inside}; {hint}"
    message = problem["msg"].removeprefix("Value error, ")
    given = problem.get("input")
    if problem["type"] == "tuple_type":
        is_table = isinstance(given, Mapping)
        message = f"has to be a list: write [[{where}]]" if is_table else LIST
    elif problem["type"] == "model_type":
        message = f"has to be one table: write [{where}]"
    if problem["type"] != "value_error" and isinstance(given, str | int | float):
        message += f" (it is {given!r})"
    if "axis" in location and str(problem["type"]).endswith("_than_equal"):
        message += "; a point is [latitude, longitude]"
    return f"{where}: {message}" if where else message


def _dotted(location: tuple[int | str, ...]) -> str:
    text = ""
    for part in location:
        text += f" {part + 1}" if isinstance(part, int) else f".{part}" if text else part
    return text


def _fields_at(model: type[Settings], location: tuple[int | str, ...]) -> set[str]:
    """Return the keys that are known in the table at `location` of `model`."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        annotation = current.model_fields[part].annotation
        arguments = [a for a in getattr(annotation, "__args__", ()) if hasattr(a, "model_fields")]
        current = arguments[0] if arguments else annotation
    return set(current.model_fields)
