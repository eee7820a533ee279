"""Video capture: true times, any container and pixel format, luma untouched, damage said."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest

import clips
from clips import cut, index_of, picture, turn, write_clip, write_sound
from queuetail.errors import InputError
from queuetail.types import Frame
from queuetail.video import VideoFile
from queuetail.video.capture import frame_of

FASTSTART = {"movflags": "+faststart"}
EIGHT_SECONDS = range(0, 8000, 40)


def read(path: Path) -> tuple[list[Frame], VideoFile]:
    with VideoFile(path) as video:
        return list(video.frames()), video


def times(frames: list[Frame]) -> list[float]:
    return [round(f.t_s, 3) for f in frames]


@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv", "ts", "nut"])
def test_times_are_the_files_own(tmp_path: Path, suffix: str) -> None:
    """Variable frame rate, and a first picture 5 s after the file's time zero."""
    shown = [5000, 5033, 5100, 5101, 5300, 6000]
    frames, video = read(write_clip(tmp_path / f"clip.{suffix}", shown))
    assert times(frames) == pytest.approx([0, 0.033, 0.1, 0.101, 0.3, 1.0], abs=0.0011)
    assert [f.index for f in frames] == list(range(6))
    assert [index_of(f.luma) for f in frames] == list(range(6))
    assert video.notes == []
    assert video.info.duration_s == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "flv", "mov"])
def test_b_frames_come_in_order_of_time(tmp_path: Path, suffix: str) -> None:
    path = write_clip(tmp_path / f"clip.{suffix}", codec="libx264", options={"bf": "3"})
    frames, video = read(path)
    assert [index_of(f.luma) for f in frames] == list(range(20))
    assert times(frames) == [round(0.04 * k, 3) for k in range(20)]
    assert video.notes == []


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
def test_b_frames_in_avi_come_in_order(
    tmp_path: Path, codec: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """AVI stores no times at all: the demuxer's guesses for H.264 are out of order."""
    monkeypatch.setattr(clips, "MILLISECONDS", Fraction(1, 25))
    frames, video = read(
        write_clip(tmp_path / "b.avi", range(20), codec=codec, options={"bf": "2"})
    )
    assert [index_of(f.luma) for f in frames] == pytest.approx(list(range(20)), abs=1)
    assert times(frames) == [round(0.04 * k, 3) for k in range(20)]
    assert video.notes == []


def test_a_stream_without_times_gets_its_nominal_rate_and_says_so(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip.h264", codec="libx264", container_format="h264")
    frames, video = read(path)
    assert times(frames) == [round(0.04 * k, 3) for k in range(20)]
    assert len(video.notes) == 1
    assert "20 frames carry no time; 25 frames/s was assumed" in video.notes[0]


@pytest.mark.parametrize(
    ("suffix", "codec", "pixel_format", "size"),
    [
        ("mkv", "libx264", "yuv420p10le", (64, 48)),
        ("mkv", "libx264", "yuv444p", (64, 48)),
        ("mkv", "libx264", "yuv422p", (64, 48)),
        ("mkv", "libx265", "yuv420p10le", (64, 64)),
        ("mkv", "ffv1", "yuv444p10le", (64, 48)),
        ("mkv", "ffv1", "bgr0", (64, 48)),
        ("mkv", "ffv1", "gray", (64, 48)),
        ("mov", "png", "rgb24", (64, 48)),
        ("mov", "prores", "yuv422p10le", (64, 48)),
        ("avi", "mjpeg", "yuvj420p", (64, 48)),
        ("mkv", "rawvideo", "nv12", (64, 48)),
        ("webm", "libvpx-vp9", "yuv420p", (64, 48)),
        ("mkv", "ffv1", "yuv420p", (63, 47)),
        ("mp4", "mpeg4", "yuv420p", (63, 47)),
        ("mkv", "ffv1", "yuv420p", (1, 1)),
        ("mkv", "ffv1", "bgra", (17, 3)),
    ],
)
def test_any_pixel_format_and_size(
    tmp_path: Path, suffix: str, codec: str, pixel_format: str, size: tuple[int, int]
) -> None:
    options = {"x265-params": "log-level=none"} if codec == "libx265" else {}
    path = tmp_path / f"clip.{suffix}"
    write_clip(
        path, (0, 40, 80), codec=codec, pixel_format=pixel_format, size=size, options=options
    )
    frames, video = read(path)
    assert (video.info.width_px, video.info.height_px) == size
    assert len(frames) == 3
    for frame in frames:
        assert frame.size == size
        assert frame.luma.dtype == np.uint8
        assert frame.luma.shape == size[::-1]
        colour = frame.bgr(*size)
        assert colour.shape == (*size[::-1], 3)
        expected = picture(frame.index, *size)[-1, -1].astype(int)
        assert np.abs(colour[-1, -1].astype(int) - expected).max() <= 8
    brightness = [float(f.luma[-1, -1]) for f in frames]
    assert brightness == sorted(brightness)


def test_luma_is_the_decoders_own_plane(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip.mp4")
    with av.open(str(path)) as container:
        expected = next(container.decode(video=0)).to_ndarray()[:48]
    frames, _ = read(path)
    np.testing.assert_array_equal(frames[0].luma, expected)
    base = frames[0].luma
    while isinstance(base.base, np.ndarray):
        base = base.base
    assert isinstance(base.base, memoryview)  # the plane's memory, not a copy of it


@pytest.mark.parametrize(
    ("pixel_format", "shape"),
    [
        *(("yuv420p", (24, 32)), ("yuv422p", (48, 32)), ("yuv444p", (48, 64))),
        *(("yuv420p10le", (24, 32)), ("bgra", (24, 32)), ("gray", None)),
    ],
)
def test_chroma_comes_beside_luma(
    tmp_path: Path, pixel_format: str, shape: tuple[int, int] | None
) -> None:
    path = write_clip(tmp_path / "clip.mkv", codec="ffv1", pixel_format=pixel_format)
    frames, _ = read(path)
    assert [plane.shape for plane in frames[0].chroma] == ([] if shape is None else [shape] * 2)
    for plane in frames[0].chroma:
        assert abs(float(plane.mean()) - 128) < 20  # the pictures are nearly grey


def test_interleaved_chroma_is_taken_apart() -> None:
    coded = av.VideoFrame.from_ndarray(picture(0), format="bgr24").reformat(format="nv12")
    planar = coded.reformat(format="yuv420p")
    chroma = frame_of(0, 0.0, coded, 0).chroma
    for ours, plane in zip(chroma, planar.planes[1:], strict=True):
        rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
        np.testing.assert_array_equal(ours, rows[: plane.height, : plane.width])


def test_chroma_turns_with_the_picture(tmp_path: Path) -> None:
    frames, _ = read(turn(write_clip(tmp_path / "clip.mp4"), 90))
    assert [plane.shape for plane in frames[0].chroma] == [(32, 24)] * 2


def test_frames_outlive_the_file_and_each_other(tmp_path: Path) -> None:
    frames, _ = read(write_clip(tmp_path / "clip.mp4", noise=True))
    before = [f.luma.copy() for f in frames]
    colours = [f.bgr(32, 24) for f in frames]
    for frame, luma, colour in zip(frames, before, colours, strict=True):
        np.testing.assert_array_equal(frame.luma, luma)
        np.testing.assert_array_equal(frame.bgr(32, 24), colour)


def test_colour_comes_scaled_to_the_size_asked_for(tmp_path: Path) -> None:
    frames, _ = read(write_clip(tmp_path / "clip.mp4", size=(128, 96)))
    small = frames[0].bgr(32, 24)
    assert small.shape == (24, 32, 3)
    assert small.flags.c_contiguous
    assert small[1, 1].min() > 240  # the bright corner
    assert small[-2, -2].max() < 60


@pytest.mark.parametrize(
    ("clockwise_deg", "size", "bright"),
    [(90, (48, 64), (0, -1)), (180, (64, 48), (-1, -1)), (270, (48, 64), (-1, 0))],
)
def test_rotation_metadata_is_obeyed(
    tmp_path: Path, clockwise_deg: int, size: tuple[int, int], bright: tuple[int, int]
) -> None:
    """The coded picture's bright top left corner moves as a viewer turns the picture."""
    frames, video = read(turn(write_clip(tmp_path / "clip.mp4"), clockwise_deg))
    assert (video.info.width_px, video.info.height_px) == size
    frame = frames[0]
    colour = frame.bgr(*size)
    assert frame.size == size
    assert colour.shape == (*size[::-1], 3)
    corners = {(y, x): int(frame.luma[y, x]) for y in (0, -1) for x in (0, -1)}
    assert max(corners, key=lambda c: corners[c]) == bright
    assert colour[bright].min() > 240
    assert sorted(corners.values())[-2] < 100
    assert frame.bgr(size[0] // 2, size[1] // 2).shape == (size[1] // 2, size[0] // 2, 3)


def test_a_change_of_size_in_mid_stream_is_scaled_and_said(tmp_path: Path) -> None:
    first = write_clip(tmp_path / "a.ts", range(0, 400, 40)).read_bytes()
    second = write_clip(tmp_path / "b.ts", range(400, 800, 40), size=(96, 64)).read_bytes()
    path = tmp_path / "both.ts"
    path.write_bytes(first + second)
    frames, video = read(path)
    assert {f.luma.shape for f in frames} == {(48, 64)}
    assert any("of another size were scaled" in n for n in video.notes)


@pytest.mark.parametrize(
    ("suffix", "codec", "options"),
    [
        ("mkv", "mpeg4", {}),
        ("mkv", "libx264", {}),
        ("ts", "mpeg4", {}),
        ("avi", "mpeg4", {}),
        ("mp4", "mpeg4", FASTSTART),
        ("mp4", "libx264", FASTSTART),
        ("mov", "mpeg4", FASTSTART),
    ],
)
def test_of_a_truncated_file_the_readable_part_is_given_and_it_is_said(
    tmp_path: Path, suffix: str, codec: str, options: dict[str, str]
) -> None:
    path = tmp_path / f"clip.{suffix}"
    write_clip(path, EIGHT_SECONDS, codec=codec, noise=True, container_options=options)
    frames, video = read(cut(path, 0.503))
    assert 2.5 < frames[-1].t_s < 6.6
    assert len(frames) > 60
    said = [n for n in video.notes if "is truncated" in n]
    assert len(said) == 1
    assert str(path) in said[0]
    assert f"{frames[-1].t_s:.1f} s were readable and processed" in said[0]


def test_whole_files_are_not_called_truncated(tmp_path: Path) -> None:
    """Nor is one whose sound outlasts its pictures, or whose last picture stays for long."""
    for suffix in ("mp4", "mkv", "ts", "avi", "mov"):
        assert read(write_clip(tmp_path / f"clip.{suffix}"))[1].notes == []
    path = tmp_path / "sound.mkv"
    with av.open(str(path), "w") as container:
        picture_stream = container.add_stream("mpeg4", rate=25)
        picture_stream.width, picture_stream.height = 64, 48
        sound_stream = container.add_stream("aac", rate=16_000)
        for index in range(10):
            frame = av.VideoFrame.from_ndarray(picture(index), format="rgb24")
            container.mux(picture_stream.encode(frame))
        container.mux(picture_stream.encode())
        for start in range(0, 48_000, 1024):
            sound = av.AudioFrame.from_ndarray(
                np.zeros((1, 1024), np.float32), format="fltp", layout="mono"
            )
            sound.sample_rate, sound.pts = 16_000, start
            container.mux(sound_stream.encode(sound))
        container.mux(sound_stream.encode())
    frames, video = read(path)
    assert len(frames) == 10
    assert video.notes == []


def test_damaged_packets_are_skipped_and_said(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "clip.mkv", EIGHT_SECONDS, codec="libx264", noise=True)
    data = bytearray(path.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 4000] = bytes(range(250)) * 16
    path.write_bytes(data)
    frames, video = read(path)
    assert len(frames) > 100
    assert frames[-1].t_s > 4
    assert all(b.t_s > a.t_s for a, b in pairwise(frames))
    assert video.notes


def sound_with_a_cover(path: Path) -> Path:
    with av.open(str(path), "w") as container:
        cover = container.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 64, 48, "yuvj420p"
        cover.disposition = av.stream.Disposition.attached_pic
        sound_stream = container.add_stream("aac", rate=16_000)
        frame = av.VideoFrame.from_ndarray(picture(0), format="rgb24")
        packets = [*cover.encode(frame.reformat(format="yuvj420p")), *cover.encode()]
        for start in range(0, 16_000, 1024):
            sound = av.AudioFrame.from_ndarray(
                np.zeros((1, 1024), np.float32), format="fltp", layout="mono"
            )
            sound.sample_rate, sound.pts = 16_000, start
            packets += sound_stream.encode(sound)
        container.mux([*packets, *sound_stream.encode()])
    return path


def _bad_inputs(folder: Path) -> dict[str, tuple[Path, str]]:
    text = folder / "notes.txt"
    text.write_text("This is no video.\n" * 200)
    renamed = folder / "notes.mp4"
    renamed.write_text("This is no video.\n" * 200)
    empty = folder / "empty.mp4"
    empty.touch()
    noise = folder / "noise.bin"
    noise.write_bytes(bytes(range(256)) * 40)
    no_index = cut(write_clip(folder / "noindex.mp4", EIGHT_SECONDS, noise=True), 0.5)
    header_only = write_clip(folder / "header.mkv", noise=True)
    header_only.write_bytes(header_only.read_bytes()[:700])
    return {
        "missing": (folder / "none.mp4", "there is no such file"),
        "below a file": (text / "none.mp4", "there is no such file"),
        "too long a name": (folder / ("x" * 400), "cannot be read"),
        "folder": (folder, "is a folder, not a video file"),
        "empty": (empty, "is empty (0 bytes)"),
        "text": (text, "is not a video"),
        "text named mp4": (renamed, "is not a video"),
        "bytes": (noise, "is not a video"),
        "no index": (no_index, "cut off before its index"),
        "header only": (header_only, "no picture could be decoded"),
        "sound": (write_sound(folder / "sound.m4a"), "has no video stream (it holds audio)"),
        "cover": (sound_with_a_cover(folder / "cover.mp4"), "has no video stream"),
    }


def test_what_is_no_video_gets_one_sentence(tmp_path: Path) -> None:
    for case, (path, says) in _bad_inputs(tmp_path).items():
        with pytest.raises(InputError) as raised:
            VideoFile(path)
        message = str(raised.value)
        assert says in message, case
        assert message.startswith(str(path)), case
        assert "\n" not in message, case


def test_subtitles_are_no_video(flagger: Path) -> None:
    with pytest.raises(InputError, match=r"has no video stream \(it holds subtitle"):
        VideoFile(flagger / "flight.srt")


def test_the_bundled_flight(flagger: Path) -> None:
    with VideoFile(flagger / "flight.mp4") as video:
        assert (video.info.width_px, video.info.height_px) == (1280, 720)
        assert video.info.duration_s == pytest.approx(80.0, abs=0.1)
        frame = next(video.frames())
        assert frame.t_s == 0.0
        assert frame.luma.shape == (720, 1280)
