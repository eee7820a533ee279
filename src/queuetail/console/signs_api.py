"""The signs' routes: what each should show and does show, its face, and the switch of control."""

from __future__ import annotations

from functools import lru_cache
from typing import Annotated

from fastapi import FastAPI, HTTPException, Path, Query, Response
from pydantic import BaseModel, Field

from queuetail.console.live_source import LiveSource
from queuetail.console.source import ConsoleSource
from queuetail.errors import InputError
from queuetail.live.records import OutletState
from queuetail.signs import face
from queuetail.signs.arming import ArmState
from queuetail.signs.controller import SignController
from queuetail.signs.line import LineReport
from queuetail.signs.multi import Line, Page
from queuetail.signs.records import Decision, Fit, Phases, SignKind, SignState
from queuetail.signs.settings import SignSite

NO_SIGNS = "this run controls no signs: it is finished, or its site file has no [[sign]]"
ONLOOKER = "console"  # who disarms without a name: one click has to be enough
Place = tuple[float, float]


class Armed(BaseModel):
    """Whether signs are controlled, on whose word, since when and why."""

    armed: bool
    who: str
    since_utc: str
    reason: str


class Arm(BaseModel):
    """Arms or disarms the control of all signs."""

    armed: bool
    who: Annotated[str, Field(max_length=60, description="needed to arm")] = ""


class SignPlace(BaseModel):
    """Whether a portable sign stands well, and where it should be moved."""

    fit: Fit
    move_m: float = Field(description="upstream when positive")
    move_to_station_m: float | None
    move_to: Place | None = Field(description="latitude and longitude")


class SignNow(BaseModel):
    """One sign: what it should show, why, and what it does show by its own word."""

    name: str
    kind: SignKind
    is_controlled: bool = Field(description="it has an address, and this is no dry run")
    state: SignState | None = Field(description="none before the first decision")
    phases: Phases = Field(description="what it should show; none: blank")
    beacon: bool
    reasons: tuple[str, ...]
    distance_m: float | None
    required_m: float | None
    passes_in_s: float | None = Field(description="until the queue reaches the sign")
    place: SignPlace | None
    shown: Phases | None = Field(description="by its own word; none until it told")
    shown_age_s: float | None
    delivery: OutletState
    last_error: str


class Signs(BaseModel):
    """All signs of the run."""

    control: Armed | None = Field(description="none where no run controls signs")
    dry_run: bool
    can_arm: bool = Field(description="there is a sign that can be controlled")
    is_outdated: bool = Field(description="the settings name other signs, for the next start")
    signs: list[SignNow]


def add(app: FastAPI, source: ConsoleSource) -> None:
    """Add the signs' routes to an application."""

    @app.get("/api/v1/signs", tags=["signs"])
    def signs() -> Signs:
        """Return every sign with its decision, and who has armed their control."""
        controller, about = controller_of(source), source.about
        here = controller.signs if controller is not None else ()
        outdated = about.is_live and about.site.sign != here
        if controller is None:
            return Signs(control=None, dry_run=False, can_arm=False, is_outdated=outdated, signs=[])
        decisions = {d.sign: d for d in controller.decisions()}
        reports = {r.name: r for r in controller.reports()}
        return Signs(
            control=_armed(controller.arming.state),
            dry_run=controller.dry_run,
            can_arm=any(sign.address is not None for sign in controller.signs),
            is_outdated=outdated,
            signs=[_now(s, decisions.get(s.name), reports.get(s.name)) for s in controller.signs],
        )

    @app.post(
        "/api/v1/signs/arming",
        tags=["signs"],
        responses={403: {"description": "a viewer"}, 409: {"description": "cannot be armed"}},
    )
    def arming(asked: Arm) -> Armed:
        """Arm or disarm; for operators. Arming needs a name, which is logged."""
        controller = controller_of(source)
        if controller is None:
            raise HTTPException(409, NO_SIGNS)
        if not asked.armed:
            return _armed(controller.arming.disarm(asked.who.strip() or ONLOOKER))
        try:
            return _armed(controller.arming.arm(asked.who))
        except InputError as error:
            raise HTTPException(409, str(error)) from None

    _add_faces(app, source)


def _add_faces(app: FastAPI, source: ConsoleSource) -> None:
    @app.get(
        "/api/v1/signs/{number}/face.png",
        tags=["signs"],
        response_class=Response,
        responses={200: {"content": {"image/png": {}}}, 404: {"description": "no such sign"}},
    )
    def sign_face(
        number: Annotated[int, Path(ge=1, le=10_000, description="in the order of the site file")],
        phase: Annotated[int, Query(ge=1, le=2)] = 1,
        shown: Annotated[bool, Query(description="what it does show, not what it should")] = False,
    ) -> Response:
        """Return one phase of a sign as a picture of its face; dark where there is none."""
        controller = controller_of(source)
        if controller is None or number > len(controller.signs):
            raise HTTPException(404, "there is no such sign")
        sign = controller.signs[number - 1]
        known: Phases | None = None
        if shown:
            known = next((r.shown for r in controller.reports() if r.name == sign.name), None)
        else:
            known = next((d.phases for d in controller.decisions() if d.sign == sign.name), None)
        lines = known[phase - 1] if known is not None and phase <= len(known) else ()
        picture = _face(lines, sign.lines, sign.characters)
        return Response(picture, media_type="image/png", headers={"Cache-Control": "no-store"})


def controller_of(source: ConsoleSource) -> SignController | None:
    """Return the control of a live run's signs, if it has any."""
    return source.signs if isinstance(source, LiveSource) else None


def _now(sign: SignSite, decision: Decision | None, report: LineReport | None) -> SignNow:
    return SignNow(
        name=sign.name,
        kind=sign.kind,
        is_controlled=report is not None,
        state=decision.state if decision else None,
        phases=decision.phases if decision else (),
        beacon=decision.beacon if decision else False,
        reasons=decision.reasons if decision else (),
        distance_m=decision.distance_m if decision else None,
        required_m=decision.required_m if decision else None,
        passes_in_s=decision.passes_in_s if decision else None,
        place=_place(decision) if decision else None,
        shown=report.shown if report else None,
        shown_age_s=report.shown_age_s if report else None,
        delivery=report.state if report else OutletState.OFF,
        last_error=report.last_error if report else "",
    )


def _place(decision: Decision) -> SignPlace | None:
    placement = decision.placement
    if placement is None:
        return None
    lat, lon = placement.move_to_lat_deg, placement.move_to_lon_deg
    return SignPlace(
        fit=placement.fit,
        move_m=placement.move_m,
        move_to_station_m=placement.move_to_station_m,
        move_to=None if lat is None or lon is None else (lat, lon),
    )


def _armed(state: ArmState) -> Armed:
    return Armed(armed=state.armed, who=state.who, since_utc=state.since_utc, reason=state.reason)


@lru_cache(maxsize=256)
def _face(texts: tuple[str, ...], lines: int, characters: int) -> bytes:
    page = Page(tuple(Line(text) for text in texts)) if texts else None
    return face.png(page, lines, characters)
