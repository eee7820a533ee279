"""A live run without its threads: a recorded flight, played into sinks packet by packet."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Callable, Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from time import monotonic, sleep

import av

from queuetail.config import read_site
from queuetail.flight import open_flight
from queuetail.live.outlet import StreamInfo
from queuetail.live.recorder import Recorder
from queuetail.live.records import Health, Published
from queuetail.pace import Pace
from queuetail.presets import PRESETS
from queuetail.types import Observation
from queuetail.video.capture import frame_of

START_UTC = datetime(2026, 5, 14, 15, 30, tzinfo=UTC)


def play(
    folder: Path,
    recorder: Recorder,
    seconds: float,
    *,
    is_paced: bool = False,
    session_at_s: Iterable[float] = (),
    seen: Callable[[Published], None] = lambda published: None,
) -> list[Observation]:
    """Process the first seconds of a flight's folder, offering all to the recorder.

    A new session, whose clock starts anew, begins at each of `session_at_s`.
    """
    site = read_site(folder / "site.toml")
    answers: list[Observation] = []
    with open_flight(folder / "flight.mp4", folder / "telemetry.csv", site) as flight:
        size = flight.video.width_px, flight.video.height_px
        pipeline = PRESETS["road"](site, flight.origin, *size, lambda stage: None)
        began_s, pace = monotonic(), Pace(pipeline.longest_s)
        breaks, session, index = sorted(session_at_s), 0, 0
        begins: list[float] = []  # the picture times at which sessions begin
        with av.open(str(folder / "flight.mp4")) as container:
            stream = container.streams.video[0]
            info = stream_info(stream, session)
            assert stream.time_base is not None
            for packet in container.demux(stream):
                if packet.dts is None:
                    break
                sent_s = float(packet.dts * stream.time_base)
                if sent_s > seconds:
                    break
                if is_paced:
                    sleep(max(0.0, began_s + sent_s - monotonic()))
                if breaks and packet.is_keyframe and sent_s >= breaks[0]:
                    breaks.pop(0)
                    session += 1
                    begins.append(float(packet.pts * stream.time_base))
                    info = stream_info(stream, session)
                pictures = packet.decode()
                recorder.packet(packet, info, START_UTC + timedelta(seconds=sent_s))
                for picture in pictures:
                    t_s = float(picture.time or 0.0)
                    if not pace.takes(t_s):
                        continue
                    of_session = sum(t_s >= begin for begin in begins)
                    frame = frame_of(index, t_s, picture, 0)
                    index += 1
                    told = flight.telemetry_at(t_s)
                    observation = pipeline.step(frame, told)
                    answers.append(observation)
                    utc = datetime.now(UTC) if is_paced else START_UTC + timedelta(seconds=t_s)
                    health = Health(frames_processed=len(answers), warnings=("a trial",))
                    published = Published(
                        len(answers), utc, frame, observation, health, told, of_session, t_s
                    )
                    recorder.telemetry(told, utc, "test")
                    recorder.offer(published)
                    seen(published)
    return answers


def stream_info(stream: av.VideoStream, session: int) -> StreamInfo:
    """Describe a stream as the capture does: by a copy that outlives its container."""
    keeper = av.open(io.BytesIO(), "w", format="mpegts")
    assert stream.time_base is not None
    return StreamInfo(
        session=session,
        index=stream.index,
        kind="video",
        codec=stream.codec_context.name,
        time_base=stream.time_base,
        template=keeper.add_stream_from_template(stream),
    )


def without_frame(published: Published, number: int) -> Published:
    """Return an answer as it is given while the stream is lost."""
    return dataclasses.replace(published, number=number, frame=None, telemetry=None, pts_s=None)
