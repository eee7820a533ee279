"""When feeds speak: reports of every change, and messages that are begun, updated and cancelled.

Pure state machines over answers; the time is given to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum

from queuetail.feeds.answers import NO_LONGER_WATCHED, Answer
from queuetail.types import QueueStatus

ENDED = "queuetail has ended"


class Change(StrEnum):
    """Why a report is made."""

    STATUS = "status"
    MOVED = "moved"
    REFRESH = "refresh"
    ENDED = "ended"


@dataclass(frozen=True, slots=True)
class Report:
    """One answer to tell; `sequence` counts the reports of one feed."""

    change: Change
    answer: Answer
    sequence: int


class Reporter:
    """Chooses which answers a feed tells: every change, and a refresh now and then."""

    def __init__(self, refresh_s: float, moved_m: float) -> None:
        self._refresh_s, self._moved_m = refresh_s, moved_m
        self._told: dict[str, tuple[Answer, float]] = {}  # by approach: what, and when
        self._marked: dict[str, Answer] = {}  # the last that was no mere refresh
        self._sequence = 0

    def take(self, answers: Sequence[Answer], now_s: float) -> tuple[Report, ...]:
        """Return what is to be told of the newest answers."""
        present = {answer.approach for answer in answers}
        lost = [told for name, (told, _) in self._told.items() if name not in present]
        found = [(self._change(answer, now_s), answer) for answer in answers]
        reports = [self._report(why, answer, now_s) for why, answer in found if why is not None]
        for told in lost:
            if told.status is not QueueStatus.UNKNOWN:
                gone = replace(told.unknown(NO_LONGER_WATCHED), utc=answers[0].utc, made_s=now_s)
                reports.append(self._report(Change.STATUS, gone, now_s))
            del self._told[told.approach]
        return tuple(reports)

    def end(self, now_s: float, utc: datetime) -> tuple[Report, ...]:
        """Return the last reports: nothing is known from now on."""
        last = [replace(told.unknown(ENDED), utc=utc) for told, _ in self._told.values()]
        return tuple(self._report(Change.ENDED, answer, now_s) for answer in last)

    def _change(self, answer: Answer, now_s: float) -> Change | None:
        if answer.approach not in self._told:
            return Change.STATUS
        told, told_s = self._told[answer.approach]
        if told.status is not answer.status:
            return Change.STATUS
        marked = self._marked[answer.approach].end
        if marked is not None and answer.end is not None:
            moved_m = abs(answer.end.measured_m - marked.measured_m)
            if moved_m >= self._moved_m:
                return Change.MOVED
        return Change.REFRESH if now_s - told_s >= self._refresh_s else None

    def _report(self, change: Change, answer: Answer, now_s: float) -> Report:
        self._sequence += 1
        self._told[answer.approach] = answer, now_s
        if change is not Change.REFRESH:
            self._marked[answer.approach] = answer
        return Report(change, answer, self._sequence)


class Step(StrEnum):
    """What a notice does to the message about one queue."""

    NEW = "new"
    UPDATE = "update"
    CANCEL = "cancel"


@dataclass(frozen=True, slots=True)
class Notice:
    """One message about one queue; a cancel carries the last answer that had one, as its place."""

    step: Step
    id: str  # of the queue's episode: the same for all its notices
    sequence: int  # within the episode
    answer: Answer
    began: datetime
    sent: datetime  # the time of the answer that made it
    expires: datetime
    expires_s: float  # the same on the monotonic clock
    why: str = ""  # of a cancel, in words
    is_dissolved: bool = False  # cancelled because the queue was seen to dissolve
    references: tuple[tuple[str, datetime], ...] = ()  # (identifier, sent) of what it replaces

    @property
    def identifier(self) -> str:
        """The name of this one message."""
        return f"{self.id}.{self.sequence}"


@dataclass(slots=True)
class _Episode:
    notice: Notice
    told_s: float
    gone_s: float | None = None
    number: int = 0


class NoticeBook:
    """Begins, updates and cancels messages; each expires `valid_s` after its answer."""

    def __init__(
        self,
        prefix: str,
        valid_s: float,
        refresh_s: float,
        settle_s: float,
        moved_m: float,
    ) -> None:
        """`prefix` makes the episodes' names unique in the world."""
        self._prefix = prefix
        self._valid_s, self._refresh_s = valid_s, refresh_s
        self._settle_s, self._moved_m = settle_s, moved_m
        self._episodes: dict[str, _Episode] = {}
        self._count = 0

    def take(self, answers: Sequence[Answer], now_s: float) -> tuple[Notice, ...]:
        """Return the notices that the newest answers ask for."""
        notices: list[Notice] = []
        present = {answer.approach: answer for answer in answers}
        for name, answer in present.items():
            if answer.has_queue and answer.is_placed:
                notices += self._queue(name, answer, now_s)
            elif name in self._episodes:
                notices += self._gone(name, answer, now_s)
        for name in [name for name in self._episodes if name not in present]:
            was = self._episodes[name].notice.answer
            lost = replace(was.unknown(NO_LONGER_WATCHED), utc=answers[0].utc, made_s=now_s)
            notices += self._gone(name, lost, now_s)
        return tuple(notices)

    def end(self, now_s: float, utc: datetime) -> tuple[Notice, ...]:
        """Cancel whatever stands, because nothing is known from now on."""
        return tuple(
            self._cancel(name, f"unknown: {ENDED}", utc, now_s) for name in tuple(self._episodes)
        )

    def current(self, now_s: float) -> tuple[Notice, ...]:
        """Return the messages that stand now."""
        return tuple(e.notice for e in self._episodes.values() if now_s < e.notice.expires_s)

    def _queue(self, name: str, answer: Answer, now_s: float) -> list[Notice]:
        episode = self._episodes.get(name)
        if episode is None:
            self._count += 1
            new_id = f"{self._prefix}-{self._count}"
            notice = self._notice(Step.NEW, new_id, 0, answer, answer.utc)
            self._episodes[name] = _Episode(notice, now_s, number=self._count)
            return [notice]
        episode.gone_s = None
        last, end = episode.notice.answer.end, answer.end
        assert last is not None
        assert end is not None
        moved = abs(end.measured_m - last.measured_m) >= self._moved_m
        changed = moved or end.is_bound != last.is_bound
        if not changed and now_s - episode.told_s < self._refresh_s:
            return []
        before = episode.notice
        notice = self._notice(
            Step.UPDATE, before.id, before.sequence + 1, answer, before.began, before
        )
        episode.notice, episode.told_s = notice, now_s
        return [notice]

    def _gone(self, name: str, answer: Answer, now_s: float) -> list[Notice]:
        """Cancel a message whose queue has not been seen for long enough, or that expired."""
        episode = self._episodes[name]
        if episode.gone_s is None:
            episode.gone_s = now_s
        if now_s - episode.gone_s < self._settle_s and now_s < episode.notice.expires_s:
            return []
        if answer.status is QueueStatus.CLEAR:
            cancel = self._cancel(name, "the queue has dissolved", answer.utc, now_s)
            return [replace(cancel, is_dissolved=True)]
        why = f"unknown: {'; '.join(answer.reasons) or 'no reason given'}"
        return [self._cancel(name, why, answer.utc, now_s)]

    def _cancel(self, name: str, why: str, utc: datetime, now_s: float) -> Notice:
        before = self._episodes.pop(name).notice
        sent = max(utc, before.sent)
        return replace(
            before,
            step=Step.CANCEL,
            sequence=before.sequence + 1,
            sent=sent,
            expires=sent + timedelta(seconds=self._valid_s),
            expires_s=now_s + self._valid_s,
            why=why,
            references=((before.identifier, before.sent),),
        )

    def _notice(
        self,
        step: Step,
        new_id: str,
        sequence: int,
        answer: Answer,
        began: datetime,
        before: Notice | None = None,
    ) -> Notice:
        return Notice(
            step=step,
            id=new_id,
            sequence=sequence,
            answer=answer,
            began=began,
            sent=answer.utc,
            expires=answer.utc + timedelta(seconds=self._valid_s),
            expires_s=answer.made_s + self._valid_s,
            references=((before.identifier, before.sent),) if before is not None else (),
        )
