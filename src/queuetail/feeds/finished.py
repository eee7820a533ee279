"""A finished run told in the format of a feed: what a live run would have sent at one moment."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from queuetail.config import Site
from queuetail.console.run_source import RunSource, road_of
from queuetail.errors import InputError
from queuetail.feeds import cap, cifs, cot, denm, tim, wzdx
from queuetail.feeds.answers import Answer, Reader, headline
from queuetail.feeds.build import slug
from queuetail.feeds.episodes import Notice, NoticeBook
from queuetail.feeds.settings import CapFeed, CifsFeed, CotFeed, DenmFeed, TimFeed, WzdxFeed
from queuetail.feeds.state_json import FORMAT, state_record
from queuetail.live.records import Health, Published
from queuetail.pipeline import NO_TRACKS
from queuetail.sinks.folder import read_run
from queuetail.traffic.road import assign
from queuetail.types import GroundMapping, Observation, Registration, Unknown

VALID_S, REFRESH_S = 120.0, 40.0
NOWHERE = "https://ode.invalid/tim"  # RFC 2606: a printed message goes nowhere


@dataclass(frozen=True, slots=True)
class Moment:
    """The answers of one moment of a run, and the messages that stand then."""

    site: Site
    road: str
    answers: tuple[Answer, ...]
    notices: tuple[Notice, ...]
    book: NoticeBook


def moment_of(folder: Path, t_s: float | None, site: Site | None) -> Moment:
    """Return what a run had answered by `t_s`, or by the last moment with a queue.

    Raises InputError where the folder is no run, or the run had not begun.
    """
    source = RunSource(folder, site)
    site = source.about.site
    approaches, origin = road_of(read_run(folder), site)
    mapping: GroundMapping | Unknown = Unknown(("the run has no coordinates",))
    if origin is not None:
        mapping = GroundMapping(np.eye(3), np.eye(3), origin)
    past = source.past(source.about.start_s, source.about.end_s)
    if t_s is None:
        t_s = next((p.t_s for p in reversed(past) if p.state.eoq is not None), past[-1].t_s)
    if t_s < past[0].t_s:
        raise InputError(f"{folder}: the run's first answer is that of {past[0].t_s:.1f} s")
    feeds = site.feeds
    reader = Reader(feeds.sigma_factor)
    run = slug(site.site.name)
    book = NoticeBook(run, VALID_S, REFRESH_S, feeds.settle_s, feeds.moved_m)
    answers: tuple[Answer, ...] = ()
    for at_s in sorted({p.t_s for p in past if p.t_s <= t_s + 1e-6}):
        states = tuple(p.state for p in source.past(at_s, at_s))
        seen = Observation(
            frame_index=0,
            t_s=at_s,
            mapping=mapping,
            registration=Registration(np.eye(3), 1.0),
            detections_px=np.empty((0, 4)),
            approaches=approaches,
            vehicles=assign(NO_TRACKS, approaches),
            states=states,
        )
        utc = next(p.utc for p in source.past(at_s, at_s))
        read = reader.read(Published(0, utc, None, seen, Health()))
        answers = tuple(replace(answer, made_s=at_s) for answer in read)
        book.take(answers, at_s)
    source.close()
    return Moment(site, feeds.road or site.site.name, answers, book.current(t_s), book)


def _wzdx(moment: Moment) -> bytes:
    feed = moment.site.feeds.wzdx or WzdxFeed()
    pages = wzdx.WzdxPages(moment.site.site.name, moment.site.feeds, feed)
    pages.take(moment.answers, moment.answers[0].made_s)
    return pages.build(moment.answers[0].made_s, moment.answers[0].utc)


def _cifs(moment: Moment) -> bytes:
    feed = moment.site.feeds.cifs or CifsFeed()
    return cifs.CifsPages(moment.road, feed, moment.book).build(
        moment.answers[0].made_s, moment.answers[0].utc
    )


def _cap(moment: Moment) -> bytes:
    feed = moment.site.feeds.cap or CapFeed(sender="queuetail", addresses="nobody")
    organization = moment.site.feeds.organization
    return _lines(cap.alert_text(n, organization, moment.road, feed) for n in _needed(moment))


def _cot(moment: Moment) -> bytes:
    feed = moment.site.feeds.cot or CotFeed()
    return _lines(cot.event(notice, feed) for notice in _needed(moment))


def _tim(moment: Moment) -> bytes:
    feed = moment.site.feeds.tim or TimFeed(url=NOWHERE)
    messages = [tim.message(notice, {}, moment.road, feed) for notice in _needed(moment)]
    return _lines(json.dumps(message, indent=1).encode() for message in messages)


def _denm(moment: Moment) -> bytes:
    feed = moment.site.feeds.denm or DenmFeed(url="udp://127.0.0.1:1", station_id=0)
    encoder = denm.Encoder(feed)
    return _lines(encoder.encode(notice).hex().encode() for notice in _needed(moment))


def _state(moment: Moment) -> bytes:
    states = [state_record(answer, moment.site.feeds.max_age_s) for answer in moment.answers]
    whole = {"format": FORMAT, "site": moment.site.site.name, "approaches": states}
    return (json.dumps(whole, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


FORMATS: dict[str, Callable[[Moment], bytes]] = {
    "wzdx": _wzdx,
    "cifs": _cifs,
    "cap": _cap,
    "cot": _cot,
    "tim": _tim,
    "denm": _denm,
    "state": _state,
}


def _needed(moment: Moment) -> tuple[Notice, ...]:
    """Return the messages that stand; raises InputError where there is none to print."""
    if not moment.notices:
        told = "; ".join(headline(answer) for answer in moment.answers)
        raise InputError(f"there is no message to print then: {told}")
    return moment.notices


def _lines(texts: Iterable[bytes]) -> bytes:
    return b"".join(text + b"\n" for text in texts)
