"""Which live source an address means, and how FFmpeg is to open it with little delay."""

from __future__ import annotations

import os
import re
import stat
import sys
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from urllib.parse import parse_qsl, quote, urlsplit, urlunsplit

from queuetail.errors import InputError

PASSWORD_VARIABLE = "QUEUETAIL_VIDEO_PASSWORD"
OPEN_S, LISTEN_S, READ_S = 5.0, 3.0, 2.0
# Enough for the stream's headers.  No "nobuffer" flag: it throws away the pictures that were read
# to find them, the first key frame among them, and so costs a whole group of pictures.
QUICK_START = {"probesize": "1000000", "analyzeduration": "1000000", "fpsprobesize": "0"}
LOW_DELAY = {**QUICK_START, "flags": "low_delay", "fflags": "discardcorrupt"}


class Kind(StrEnum):
    """How the pictures come in."""

    RTSP = "rtsp"
    UDP = "udp"
    TCP = "tcp"
    RTMP = "rtmp"
    HTTP = "http"
    SRT = "srt"
    DEVICE = "device"
    FILE = "file"


SCHEMES = {
    "rtsp": Kind.RTSP,
    "rtsps": Kind.RTSP,
    "udp": Kind.UDP,
    "tcp": Kind.TCP,
    "rtmp": Kind.RTMP,
    "rtmps": Kind.RTMP,
    "http": Kind.HTTP,
    "https": Kind.HTTP,
    "srt": Kind.SRT,
}


@dataclass(frozen=True, slots=True)
class StreamSource:
    """One live source: the address for FFmpeg, and the one that may be shown."""

    kind: Kind
    address: str  # may hold the password: never shown
    name: str
    options: dict[str, str] = field(default_factory=dict)
    container_format: str | None = None
    is_listening: bool = False  # waits for someone to send: no pauses between tries
    is_looping: bool = False
    open_s: float = OPEN_S
    read_s: float = READ_S


GIVE = "give rtsp://…, udp://…, /dev/video0, or a recording"
VIDEO4LINUX = 81  # the major number of its devices


def parse_source(
    text: str, *, realtime: bool = False, loop: bool = False, rtsp_over: str = "tcp"
) -> StreamSource:
    """Return the source that an address, a device or a file means; raises InputError.

    A file is only taken with `realtime`, and begins anew at its end with `loop`.
    """
    if not text.strip():
        raise InputError(f"VIDEO is empty; {GIVE}")
    scheme = text.split("://", 1)[0].lower() if "://" in text else ""
    kind = SCHEMES.get(scheme)
    if kind is None and scheme and scheme != "file":
        known = ", ".join(f"{s}://" for s in SCHEMES)
        raise InputError(f"{text}: '{scheme}' is no kind of stream; known are {known}")
    if kind is not None:
        if loop:
            raise InputError(f"{shown(text)} is a stream, which has no end to loop at")
        return _stream(kind, text, rtsp_over)
    path = Path(text.removeprefix("file://").split("?", 1)[0])
    if re.match(r"/dev/video\d", str(path)) or _is_device(path):
        return _device(path, text)
    if not path.is_file():
        what = "is a folder" if path.is_dir() else "is no file, no device and no address"
        raise InputError(f"{text} {what}; {GIVE}")
    if not realtime:
        raise InputError(
            f"{text} is a recording: use 'queuetail run', or --realtime to play it as if it "
            "came live"
        )
    name = os.fsencode(path.name).decode(errors="replace")  # so that it can be recorded and sent
    return StreamSource(Kind.FILE, str(path), name, is_looping=loop)


def shown(address: str) -> str:
    """Return an address without its password."""
    return re.sub(r"(://[^/@:]*):[^/@]*@", r"\1@", address)


def _stream(kind: Kind, text: str, rtsp_over: str) -> StreamSource:
    try:
        parts = urlsplit(text)
        has_host = bool(parts.hostname) or kind in (Kind.UDP, Kind.SRT)
        has_place = has_host and (parts.port is not None or kind in NAMED_PORTS)
    except ValueError:
        has_place = False
    if not has_place:
        raise InputError(f"{shown(text)} is not complete; write {EXAMPLES[kind]}")
    if parts.password is not None:
        raise InputError(
            f"{shown(text)}: a password in an address can be read by every user of this machine; "
            f"leave it out and set it in the environment as {PASSWORD_VARIABLE}"
        )
    address = _with_password(text) if parts.username else text
    options = dict(LOW_DELAY)
    if kind is Kind.RTSP:
        return StreamSource(kind, address, text, {**options, "rtsp_transport": rtsp_over})
    if kind is Kind.UDP:
        # FFmpeg reads the socket in a thread of its own, so that nothing is lost while we decode.
        options |= {"overrun_nonfatal": "1", "fifo_size": "50000", "buffer_size": "1000000"}
        return StreamSource(
            kind, address, text, options, "mpegts", is_listening=True, open_s=LISTEN_S
        )
    query = dict(parse_qsl(parts.query, keep_blank_values=True))
    listens = "listen" in query or parts.hostname in ("0.0.0.0", "::")
    if kind in (Kind.RTMP, Kind.TCP) and listens:
        bare = urlunsplit(urlsplit(address)._replace(query=""))
        listening = {**options, "listen": "1"}
        return StreamSource(kind, bare, bare, listening, is_listening=True, open_s=LISTEN_S)
    if kind is Kind.SRT:
        listens = query.get("mode") == "listener"
        return StreamSource(kind, address, text, options, "mpegts", is_listening=listens)
    return StreamSource(kind, address, text, options)


NAMED_PORTS = (Kind.RTSP, Kind.RTMP, Kind.HTTP)  # a default port goes with the scheme
EXAMPLES = {
    Kind.RTSP: "rtsp://HOST:554/PATH",
    Kind.UDP: "udp://0.0.0.0:PORT",
    Kind.TCP: "tcp://HOST:PORT, or tcp://0.0.0.0:PORT to wait for a sender",
    Kind.RTMP: "rtmp://0.0.0.0:1935/live/NAME to wait for a sender, or rtmp://HOST/live/NAME",
    Kind.HTTP: "https://HOST/PATH",
    Kind.SRT: "srt://HOST:PORT, or srt://0.0.0.0:PORT?mode=listener to wait for a sender",
}


def _with_password(text: str) -> str:
    """Put the password from the environment into an address that names a user."""
    password = os.environ.get(PASSWORD_VARIABLE)
    if not password:
        return text
    parts = urlsplit(text)
    user, _, place = parts.netloc.rpartition("@")
    return urlunsplit(parts._replace(netloc=f"{user}:{quote(password, safe='')}@{place}"))


def _is_device(path: Path) -> bool:
    try:
        return stat.S_ISCHR(path.stat().st_mode)
    except OSError:
        return False


def _device(path: Path, text: str) -> StreamSource:
    """Return a webcam or an HDMI grabber; `?video_size=1280x720&framerate=30` sets its mode."""
    wanted = dict(parse_qsl(text.partition("?")[2]))
    unknown = sorted(set(wanted) - {"video_size", "framerate", "input_format", "channel"})
    if unknown:
        raise InputError(
            f"{text}: a device has no option '{unknown[0]}'; known are video_size, framerate, "
            "input_format and channel"
        )
    if not path.exists():
        raise InputError(f"{path}: there is no such device; plug the camera in and look at /dev")
    if sys.platform == "linux" and os.major(path.stat().st_rdev) != VIDEO4LINUX:
        raise InputError(f"{path} is no camera; look for /dev/video0 and its like")
    return StreamSource(Kind.DEVICE, str(path), str(path), wanted, "v4l2")
