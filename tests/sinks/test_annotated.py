"""annotated.mp4 keeps the frames' times, any size works, and a killed run leaves a video."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import av
import numpy as np
import pytest
import synthetic

from queuetail.errors import InputError
from queuetail.sinks.annotated import TICKS_PER_S, AnnotatedVideo, output_size
from queuetail.sinks.labels import WHITE, Labels
from queuetail.sinks.overlay import END, Overlay
from queuetail.types import EndOfQueue, QueueState, QueueStatus


def decoded(path: Path) -> list[av.VideoFrame]:
    with av.open(path) as container:
        return list(container.decode(video=0))


def test_times_are_the_frames_own(tmp_path: Path) -> None:
    times_s = [0.0, 0.04, 0.08, 0.2, 0.20001, 1.5, 1.5333, 7.25]
    sink = AnnotatedVideo(synthetic.info(tmp_path))
    for i, t_s in enumerate(times_s):
        sink.write(synthetic.frame(i, t_s), synthetic.observation(i, t_s))
    sink.close()
    sink.close()
    pictures = decoded(tmp_path / "annotated.mp4")
    assert [p.pts for p in pictures] == [round(t * TICKS_PER_S) for t in times_s]
    assert [p.time for p in pictures] == pytest.approx(times_s, abs=1e-5)


@pytest.mark.parametrize("size", [(1, 1), (17, 9), (64, 48), (91, 333), (641, 361), (405, 720)])
def test_any_size(tmp_path: Path, size: tuple[int, int]) -> None:
    sink = AnnotatedVideo(synthetic.info(tmp_path, size))
    ground = synthetic.mapping((max(size[0], 2), max(size[1], 2)))
    state = QueueState("EB", QueueStatus.QUEUED, synthetic.eoq(590.0, ground))
    seen = synthetic.vehicles([590.0, 600.0], [0.0, 20.0], ground)
    for i in range(3):
        shown = synthetic.observation(i, i / 25, [state], seen, ground)
        sink.write(synthetic.frame(i, i / 25, size), shown)
    sink.close()
    pictures = decoded(tmp_path / "annotated.mp4")
    assert len(pictures) == 3
    assert (pictures[0].width, pictures[0].height) == output_size(*size)


def test_output_size() -> None:
    assert output_size(3840, 2160) == (1280, 720)
    assert output_size(1080, 1920) == (720, 1280)
    assert output_size(1280, 719) == (1280, 720)
    assert output_size(5000, 3) == (1280, 2)


def test_no_frame_leaves_no_video(tmp_path: Path) -> None:
    AnnotatedVideo(synthetic.info(tmp_path)).close()
    assert not (tmp_path / "annotated.mp4").exists()


def test_unwritable_folder_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"annotated\.mp4 cannot be written"):
        AnnotatedVideo(synthetic.info(tmp_path / "nowhere"))


def test_killed_run_leaves_a_playable_part(tmp_path: Path) -> None:
    sink = AnnotatedVideo(synthetic.info(tmp_path))
    noise = np.random.default_rng(1).integers(0, 255, (180, 320, 3), np.uint8)
    for i in range(260):
        shot = dataclasses.replace(synthetic.frame(i, i / 25), bgr=lambda w, h: noise)
        sink.write(shot, synthetic.observation(i, i / 25))
    shutil.copy(tmp_path / "annotated.mp4", tmp_path / "killed.mp4")
    sink.close()
    assert len(decoded(tmp_path / "killed.mp4")) >= 100


def test_bar_lies_across_the_road_at_the_end_of_the_queue() -> None:
    ground = synthetic.mapping()
    state = QueueState("EB", QueueStatus.QUEUED, synthetic.eoq(600.0, ground))
    image = np.zeros((180, 320, 3), np.uint8)
    shown = synthetic.observation(0, 0.0, [state], None, ground)
    Overlay((320, 180), (320, 180), "t").draw(image, shown)
    v, u = np.nonzero((image == END).all(axis=2))
    foot = state.eoq.px if state.eoq else (0.0, 0.0)
    assert abs(u[v < 175].mean() - foot[0]) < 3
    assert v.min() < foot[1] < v.max()


def test_nothing_finite_is_drawn_nowhere() -> None:
    ground = synthetic.mapping()
    seen = synthetic.vehicles([600.0, 1e9], [np.nan, np.inf], ground)
    bad = np.full((2, 4), np.nan)
    seen = dataclasses.replace(seen, tracks=dataclasses.replace(seen.tracks, boxes_px=bad))
    nan = float("nan")
    end = EndOfQueue(nan, nan, (nan, nan), (nan, nan), nan, nan, 1, nan, 1, nan)
    states = [QueueState("EB", s, end) for s in QueueStatus] + [
        QueueState("not there", QueueStatus.QUEUED, synthetic.eoq(600.0, ground))
    ]
    shown = synthetic.observation(0, 0.0, states, seen, ground)
    shown = dataclasses.replace(shown, detections_px=np.array([[np.inf, 0, 1, 1.0]]))
    Overlay((320, 180), (320, 180), "t").draw(np.zeros((180, 320, 3), np.uint8), shown)


def test_long_text_is_cut() -> None:
    labels = Labels()
    text = labels.fitted("a very long sentence that does not fit " * 4, 14, 200)
    assert text.endswith("…")
    assert labels.width(text, 14) <= 200
    assert labels.fitted("any", 14, 3) == ""
    labels.draw(np.zeros((5, 5, 3), np.uint8), "any", (-9, -9), 14, WHITE)
