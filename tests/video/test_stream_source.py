"""Which source an address means, and the sentence where it means none."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from queuetail.errors import InputError
from queuetail.video import stream_process
from queuetail.video.stream import LiveVideo
from queuetail.video.stream_source import PASSWORD_VARIABLE, Kind, parse_source


@pytest.mark.parametrize(
    ("text", "kind", "listens"),
    [
        ("rtsp://10.0.0.5/live", Kind.RTSP, False),
        ("rtsps://10.0.0.5:322/live", Kind.RTSP, False),
        ("udp://0.0.0.0:5600", Kind.UDP, True),
        ("udp://239.1.1.1:5600", Kind.UDP, True),
        ("tcp://10.0.0.5:5600", Kind.TCP, False),
        ("tcp://0.0.0.0:5600", Kind.TCP, True),
        ("rtmp://0.0.0.0:1935/live/drone", Kind.RTMP, True),
        ("rtmp://127.0.0.1:1935/live/drone?listen", Kind.RTMP, True),
        ("rtmp://server/live/drone", Kind.RTMP, False),
        ("https://server/live.m3u8", Kind.HTTP, False),
        ("srt://10.0.0.5:9000", Kind.SRT, False),
        ("srt://0.0.0.0:9000?mode=listener", Kind.SRT, True),
    ],
)
def test_addresses(text: str, kind: Kind, listens: bool) -> None:
    source = parse_source(text)
    assert (source.kind, source.is_listening) == (kind, listens)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("ftp://10.0.0.5/live", "'ftp' is no kind of stream; known are rtsp://"),
        ("udp://10.0.0.5", "not complete; write udp://0.0.0.0:PORT"),
        ("srt://:9000x", "not complete; write srt://HOST:PORT"),
        ("rtsp://pilot:secret@10.0.0.5/live", PASSWORD_VARIABLE),
        ("/dev/video97", "there is no such device"),
        ("/dev/video97?brightness=3", "a device has no option 'brightness'"),
        ("flight9.mp4", "is no file, no device and no address"),
        ("/tmp", "is a folder"),
        ("", "VIDEO is empty"),
        ("rtsp://:554/live", "not complete; write rtsp://HOST:554/PATH"),
        ("/dev/null", "/dev/null is no camera"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(text: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence) as caught:
        parse_source(text)
    assert "secret" not in str(caught.value)


def test_a_recording_is_played_only_when_that_is_meant(flagger: Path) -> None:
    flight = str(flagger / "flight.mp4")
    with pytest.raises(InputError, match="use 'queuetail run', or --realtime"):
        parse_source(flight)
    assert parse_source(flight, realtime=True, loop=True).is_looping
    with pytest.raises(InputError, match="no end to loop at"):
        parse_source("udp://0.0.0.0:5600", loop=True)


def test_a_name_that_is_no_utf_8_can_be_written(tmp_path: Path) -> None:
    path = tmp_path / os.fsdecode(b"caf\xe9.mp4")
    path.touch()
    source = parse_source(str(path), realtime=True)
    assert source.name == "caf�.mp4"
    assert Path(source.address) == path


def test_the_password_comes_from_the_environment_and_is_never_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv(PASSWORD_VARIABLE, "p@ss/word")
    source = parse_source("rtsp://pilot@10.0.0.5:8554/live")
    assert source.address == "rtsp://pilot:p%40ss%2Fword@10.0.0.5:8554/live"
    assert source.name == "rtsp://pilot@10.0.0.5:8554/live"


def test_srt_without_ffmpeg_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_process.shutil, "which", lambda name: None)
    with pytest.raises(InputError, match="SRT needs the program ffmpeg"):
        LiveVideo(parse_source("srt://127.0.0.1:9000"), lambda captured: None)
