"""`live`: the end of the queue while it happens."""

from __future__ import annotations

import argparse
import math
import signal
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from threading import Event
from time import monotonic
from typing import TYPE_CHECKING

from queuetail.commands import Commands

if TYPE_CHECKING:
    from queuetail.config import Site
    from queuetail.console.live_source import LiveSource
    from queuetail.live.outlet import LiveSink
    from queuetail.live.recorder import Recorder
    from queuetail.live.runtime import LiveRun
    from queuetail.signs.controller import SignController
    from queuetail.video.stream_source import StreamSource

PORT = 8080
LOOPBACK = "127.0.0.1"
SIGNS_FOLDER = Path("out/signs")  # for the log and the switch of a run that writes nothing else


def add(commands: Commands) -> None:
    """Add this module's command to the parser."""
    from queuetail.presets import DEFAULT_PRESET, PRESETS

    live = commands.add_parser("live", help="find the end of the queue in live video")
    live.add_argument(
        "video", metavar="VIDEO", help="rtsp://…, udp://…, rtmp://…, srt://…, /dev/video0, a file"
    )
    live.add_argument(
        "--telemetry",
        metavar="SPEC",
        help="radio:DEVICE, mavlink:…, dji-mqtt://…, json-udp:PORT, csv:FILE, or a recording's log "
        "(default: the KLV inside the video)",
    )
    live.add_argument("--site", type=Path, metavar="SITE.toml", help="the road, lens and limits")
    live.add_argument(
        "--preset",
        choices=sorted(PRESETS),
        default=DEFAULT_PRESET,
        help="the method (default: %(default)s)",
    )
    live.add_argument("--out", type=Path, metavar="DIR", help="write tables and events there")
    live.add_argument("--record", type=Path, metavar="DIR", help="record video and data there")
    live.add_argument(
        "--store",
        metavar="URL",
        help="keep the history there (default: QUEUETAIL_STORE of the environment, out/history.db)",
    )
    live.add_argument("--no-store", action="store_true", help="keep no history")
    live.add_argument(
        "--port",
        type=port,
        default=PORT,
        metavar="N",
        help="of the console, /health and /metrics (default: %(default)s; 0: any free one)",
    )
    live.add_argument(
        "--host",
        default=LOOPBACK,
        metavar="ADDRESS",
        help="serve the console there, as 0.0.0.0 for the whole network (default: %(default)s); "
        "outside this machine tokens are asked for, which are printed",
    )
    live.add_argument("--duration", type=seconds, metavar="S", help="end after so many seconds")
    live.add_argument("--realtime", action="store_true", help="play a file as if it came live")
    live.add_argument("--loop", action="store_true", help="begin the file anew at its end")
    live.add_argument(
        "--rtsp-over",
        choices=("tcp", "udp"),
        default="tcp",
        help="how an RTSP server is to send (default: %(default)s)",
    )
    live.add_argument(
        "--dry-run-signs",
        action="store_true",
        help="send nothing to signs, and show what would be sent",
    )
    live.set_defaults(command=_live)


def _live(arguments: argparse.Namespace) -> int:
    from queuetail.commands.console import serve
    from queuetail.config import Site, read_site
    from queuetail.console.live_source import ConsoleSink
    from queuetail.errors import InputError
    from queuetail.feeds.build import build_feeds
    from queuetail.live.clock_watch import ClockWatch
    from queuetail.live.files import file_outlets, owned
    from queuetail.live.open_feed import open_feed
    from queuetail.live.runtime import LiveRun
    from queuetail.run import writable_folder
    from queuetail.video.stream_source import parse_source

    a = arguments
    site = read_site(a.site) if a.site else Site()
    source = parse_source(a.video, realtime=a.realtime, loop=a.loop, rtsp_over=a.rtsp_over)
    feed = open_feed(a.telemetry, source, site)
    started_utc = datetime.now(UTC)
    with ExitStack() as closing:
        out = closing.enter_context(owned(writable_folder(a.out))) if a.out else None
        recorder = _recorder(a, site, source, started_utc) if a.record else None
        sinks: list[LiveSink] = [recorder] if recorder is not None else []
        if recorder is not None:
            closing.callback(recorder.close)
        if not a.no_store:
            sinks.append(_store(a, site, source, started_utc))
            closing.callback(sinks[-1].close)
        clock = ClockWatch(site)
        sinks.append(clock)
        closing.callback(clock.close)
        run = LiveRun(
            source,
            feed,
            site,
            a.preset,
            packet_sinks=(recorder.packet,) if recorder is not None else (),
            telemetry_sinks=(*((recorder.telemetry,) if recorder is not None else ()), clock.hear),
            folder=a.record or a.out,
        )
        clock.warn_by(run.warn)
        feeds = build_feeds(site)
        closing.callback(feeds.close)
        shown = _shown(a, run, source, site)
        sinks += [*feeds.sinks, ConsoleSink(shown)]
        if (signs := shown.signs) is not None:
            closing.callback(signs.close)
            sinks.append(signs)
        server = serve(shown, a.port, a.host, feeds, signs)
        closing.callback(server.close)
        closing.callback(run.stop)
        if out:  # only now: a start that fails must not empty the files of an earlier run
            sinks += file_outlets(out, source.name, a.preset, site)
        for sink in sinks:
            run.subscribe(sink)
        _watch(run, a.duration)
    if run.refused is not None:
        raise InputError(f"{a.site}: {run.refused}")
    return 0


def _shown(a: argparse.Namespace, run: LiveRun, source: StreamSource, site: Site) -> LiveSource:
    """Return what the console shows, with the control of the site's signs, if it has any."""
    from queuetail.console.live_source import LiveSource
    from queuetail.errors import InputError
    from queuetail.store.address import store_address

    shown = LiveSource(run.health, source.name, a.preset, site, a.site)
    shown.on_adjust = run.adjust
    shown.store = None if a.no_store else store_address(a.store)
    if a.dry_run_signs and not site.sign:
        raise InputError("--dry-run-signs needs a --site file with a [[sign]]")
    shown.signs = _signs(a, site) if site.sign else None
    return shown


def _watch(run: LiveRun, duration_s: float | None) -> None:
    """Show the run until it ends, the time is up, or a signal asks for the end."""
    from queuetail.live.terminal import REFRESH_HZ, StatusView

    asked = Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda number, frame: asked.set())
    run.start()
    end_s = math.inf if duration_s is None else monotonic() + duration_s
    with StatusView() as view:
        while not (asked.is_set() or run.ended.is_set() or monotonic() >= end_s):
            view.show(run.newest())
            asked.wait(min(1 / REFRESH_HZ, max(end_s - monotonic(), 0.0)))
        view.show(run.newest())
        run.stop()


def _recorder(
    a: argparse.Namespace, site: Site, source: StreamSource, started_utc: datetime
) -> Recorder:
    from queuetail.live.mcap_records import RunAbout
    from queuetail.live.recorder import Recorder

    return Recorder(a.record, RunAbout(a.preset, site, source.name, started_utc))


def _store(
    a: argparse.Namespace, site: Site, source: StreamSource, started_utc: datetime
) -> LiveSink:
    from queuetail.store.address import store_address
    from queuetail.store.database import Store
    from queuetail.store.sink import StoreSink

    address = store_address(a.store)
    if address.path is not None:  # a database elsewhere may be away; a file must be usable now
        Store(address).prepare()
    return StoreSink(address, site.site.name, source.name, a.preset, started_utc)


def _signs(a: argparse.Namespace, site: Site) -> SignController:
    """Return the control of the site's signs, which is off until an operator arms it."""
    from queuetail.run import writable_folder
    from queuetail.signs.controller import SignController

    folder = writable_folder(a.out or a.record or SIGNS_FOLDER)
    return SignController(site, folder, dry_run=a.dry_run_signs)


def port(text: str) -> int:
    """Parse a TCP port."""
    if not text.isascii() or not text.isdigit() or int(text) > 65_535:
        raise argparse.ArgumentTypeError(f"'{text}' is no port from 0 to 65535")
    return int(text)


def seconds(text: str) -> float:
    """Parse a duration."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"'{text}' is no number of seconds above 0")
    return value
