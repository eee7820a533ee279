"""`--record`: the incoming video and all that was made of it, safe against power loss.

One thread writes; whoever offers never waits.  About twice a second everything is brought to the
disk, so that a kill loses less than the last second.  A disk that is full, or fails, stops the
recording with one sentence in its health, and nothing else.
"""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import shutil
from collections import deque
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from threading import Condition, Lock, Thread
from time import monotonic, time
from typing import TYPE_CHECKING

from queuetail.errors import InputError
from queuetail.live.mcap_file import McapFile, repair
from queuetail.live.mcap_records import (
    AnswerMessages,
    Message,
    RunAbout,
    nanoseconds,
    telemetry_message,
)
from queuetail.live.records import OutletHealth, OutletState, Published
from queuetail.live.segments import UnwritableError, VideoSegments
from queuetail.types import TelemetrySample

if TYPE_CHECKING:
    from av.packet import Packet
    from av.stream import Stream

    from queuetail.live.outlet import StreamInfo

LOG = logging.getLogger(__name__)
FLUSH_EVERY_S = 0.4
CLOSE_WITHIN_S = 10.0
UNTOUCHED_S = 30.0  # a recording nobody wrote to for so long is not being written
DISK_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}


@dataclass(frozen=True, slots=True)
class Limits:
    """How a recording is cut, and when it gives way."""

    segment_s: float = 60.0
    keep_free_mb: float = 500.0  # on the disk, for everything else that runs there
    waiting_mb: float = 64.0  # of packets that a slow disk may fall behind
    waiting_messages: int = 20_000


@dataclass(frozen=True, slots=True)
class _Picture:
    """A packet on its way to the disk."""

    packet: Packet[Stream]
    stream: StreamInfo
    utc: datetime


class Recorder:
    """A :class:`LiveSink` and a :class:`PacketSink` that writes one recording's folder."""

    def __init__(self, parent: Path, about: RunAbout, limits: Limits | None = None) -> None:
        """Make the recording's folder below `parent`; raises InputError where it cannot be made.

        Recordings there that were cut are finished, so that every MCAP reader takes them.
        """
        self._about = about
        self._limits = limits or Limits()
        self.folder = new_folder(parent, about.started_utc)
        self._intake = _Intake(self._limits)
        self._lock = Lock()
        self._messages = AnswerMessages()
        self._written = 0
        self._problem = ""
        self._last_written_s: float | None = None
        self._video = VideoSegments(self.folder, self._limits.segment_s)
        self._data: McapFile | None = None
        self._data_number = 0
        self._data_since_s = 0.0
        self._thread = Thread(target=self._work, name="recorder", daemon=True)
        self._thread.start()

    def packet(self, packet: Packet[Stream], stream: StreamInfo, utc: datetime) -> None:
        """Take a packet of the incoming video; returns at once."""
        self._intake.put_packet(_Picture(packet, stream, utc))

    def telemetry(self, sample: TelemetrySample, utc: datetime, source: str = "") -> None:
        """Take a telemetry sample as it arrived; returns at once."""
        self._intake.put([telemetry_message(sample, utc, source)])

    def offer(self, published: Published) -> None:
        """Take an answer; returns at once."""
        with self._lock:
            messages = list(self._messages.of(published))
        self._intake.put(messages)

    def health(self) -> OutletHealth:
        """Return how the recording stands: ``failed``, with the reason, once it has stopped."""
        with self._lock:
            age_s = None if self._last_written_s is None else monotonic() - self._last_written_s
            return OutletHealth(
                name="recording",
                state=OutletState.FAILED if self._problem else OutletState.OK,
                delivered=self._written,
                dropped=self._intake.dropped + self._video.skipped,
                waiting=len(self._intake),
                last_error=self._problem,
                delivery_age_s=age_s,
            )

    def close(self) -> None:
        """Write what waits and finish the files; a second call does nothing."""
        self._intake.close()
        self._thread.join(CLOSE_WITHIN_S)
        if self._thread.is_alive():
            LOG.warning("the recording in %s was left unfinished: its disk hangs", self.folder)

    def _work(self) -> None:
        try:
            self._check_space()
            self._next_data_file()
            with contextlib.suppress(OSError):  # an old recording's trouble is not this one's
                finish_cut_recordings(self.folder.parent, but=self.folder)
            flushed_s = monotonic()
            while self._intake.is_open or len(self._intake):
                for item in self._intake.take(FLUSH_EVERY_S):
                    self._write(item)
                if monotonic() - flushed_s >= FLUSH_EVERY_S:
                    self._flush()
                    flushed_s = monotonic()
            self._video.close()
            self._close_data()
        except OSError as error:
            self._stop(self._disk_words(error))
        except UnwritableError as error:
            self._stop(f"recording to {self.folder} stopped: {error}; detection goes on")
        except Exception as error:  # whatever goes wrong here must not harm the detection
            LOG.exception("recording")
            self._stop(f"recording to {self.folder} stopped: {type(error).__name__}: {error}")

    def _write(self, item: _Picture | Message) -> None:
        if isinstance(item, _Picture):
            self._video.write(item.packet, item.stream, item.utc)
            return
        assert self._data is not None
        self._data.write(item)
        if item.topic == "/answer":
            with self._lock:
                self._written += 1
                self._last_written_s = monotonic()

    def _flush(self) -> None:
        """Bring everything to the disk: the pictures first, as messages refer to them."""
        assert self._data is not None
        self._video.flush()
        self._data.flush()
        self._check_space()
        if monotonic() - self._data_since_s >= self._limits.segment_s:
            self._close_data()
            self._next_data_file()

    def _next_data_file(self) -> None:
        self._data_number += 1
        self._data_since_s = monotonic()
        self._data = McapFile(self.folder / f"data-{self._data_number:05d}.mcap")
        now_ns = nanoseconds(datetime.now(UTC))
        self._data.write(Message("/run", now_ns, self._about.record()))
        self._data.flush()
        sync_folder(self.folder)

    def _close_data(self) -> None:
        if self._data is not None:
            self._data.close()

    def _check_space(self) -> None:
        free_mb = shutil.disk_usage(self.folder).free / 1e6
        if free_mb < self._limits.keep_free_mb:
            raise _TooFullError(
                f"recording to {self.folder} stopped: its disk has {free_mb:.0f} MB left, and "
                f"{self._limits.keep_free_mb:.0f} MB are kept free; make room and start again; "
                "detection goes on"
            )

    def _disk_words(self, error: OSError) -> str:
        if isinstance(error, _TooFullError):
            return str(error)
        why = "its disk is full" if error.errno in DISK_FULL else "its disk fails"
        return (
            f"recording to {self.folder} stopped: {why} ({error.strerror or error}); "
            "mend that and start again; detection goes on"
        )

    def _stop(self, problem: str) -> None:
        with self._lock:
            self._problem = problem
        LOG.error("%s", problem)
        self._intake.stop()
        self._video.abandon()
        with contextlib.suppress(OSError):
            self._close_data()


class _TooFullError(OSError):
    """The disk has less left than is to be kept free."""


class _Intake:
    """What waits for the disk, bounded; pictures are dropped up to the next key picture."""

    def __init__(self, limits: Limits) -> None:
        self._items: deque[_Picture | Message] = deque()
        self._changed = Condition()
        self._most_bytes = limits.waiting_mb * 1e6
        self._most_messages = limits.waiting_messages
        self._bytes = 0
        self._messages = 0
        self._broken: set[tuple[int, int]] = set()  # streams that wait for a key picture
        self._is_open = True
        self._dropped = 0

    def put(self, messages: list[Message]) -> None:
        with self._changed:
            if not self._is_open or self._messages + len(messages) > self._most_messages:
                self._dropped += len(messages)
                return
            self._items.extend(messages)
            self._messages += len(messages)
            self._changed.notify()

    def put_packet(self, picture: _Picture) -> None:
        packet, which = picture.packet, (picture.stream.session, picture.stream.index)
        with self._changed:
            if packet.is_keyframe or picture.stream.kind != "video":
                self._broken.discard(which)
            full = self._bytes + packet.size > self._most_bytes
            if not self._is_open or full or which in self._broken:
                self._dropped += 1
                self._broken.add(which)
                return
            self._items.append(picture)
            self._bytes += packet.size
            self._changed.notify()

    def take(self, timeout_s: float) -> list[_Picture | Message]:
        """Return all that waits, after `timeout_s` at the latest."""
        with self._changed:
            if not self._items and self._is_open:
                self._changed.wait(timeout_s)
            items = list(self._items)
            self._items.clear()
            self._bytes = self._messages = 0
            return items

    def close(self) -> None:
        with self._changed:
            self._is_open = False
            self._changed.notify_all()

    def stop(self) -> None:
        """Take no more, and forget what waits."""
        with self._changed:
            self._is_open = False
            self._dropped += len(self._items)
            self._items.clear()

    @property
    def is_open(self) -> bool:
        with self._changed:
            return self._is_open

    @property
    def dropped(self) -> int:
        with self._changed:
            return self._dropped

    def __len__(self) -> int:
        with self._changed:
            return len(self._items)


def new_folder(parent: Path, started_utc: datetime) -> Path:
    """Make a folder for a recording, never one that is there; raises InputError."""
    name = f"{started_utc:%Y%m%dT%H%M%SZ}"
    try:
        parent.mkdir(parents=True, exist_ok=True)
        for suffix in ("", *(f"-{i}" for i in range(2, 1000))):
            try:
                folder = parent / f"{name}{suffix}"
                folder.mkdir()
            except FileExistsError:
                if not parent.is_dir():
                    raise
            else:
                return folder
    except OSError as error:
        raise InputError(
            f"{parent}: recordings cannot be written there ({error.strerror}); "
            "choose another --record folder"
        ) from None
    raise InputError(f"{parent} holds a thousand recordings of this second; choose another folder")


def finish_cut_recordings(parent: Path, but: Path | None = None) -> list[Path]:
    """Finish the MCAP files below `parent` that were cut; return which."""
    mended = []
    for folder in sorted(p for p in parent.iterdir() if p.is_dir() and p != but):
        files = sorted(folder.glob("data-*.mcap"))
        if files and time() - files[-1].stat().st_mtime >= UNTOUCHED_S and repair(files[-1]):
            mended.append(files[-1])
    return mended


def sync_folder(folder: Path) -> None:
    """Bring a folder's list of files to the disk, where the system can do that."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
