"""Make a video of one aerial picture, as a hovering drone would film it: a queue that stands.

python benchmarks/still_film.py PICTURE OUT.mp4

The picture sways by a pixel and has a camera's noise; nothing in it moves.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from queuetail.types import Image

RATE_HZ = 15
SWAY, RETURN, TURN_DEG = 0.16, 0.03, 0.01  # pixels and share per picture: a slow random walk
NOISE_LEVELS = 2.0


def film(picture: Image, seconds: float, seed: int = 0) -> Iterator[Image]:
    """Yield the pictures (h, w, 3) of a film; the first one does not sway."""
    rng, (height, width) = np.random.default_rng(seed), picture.shape[:2]
    aside, turn_deg = np.zeros(2), 0.0
    for _ in range(round(seconds * RATE_HZ)):
        M = cv2.getRotationMatrix2D((width / 2, height / 2), turn_deg, 1.0)
        M[:, 2] += aside
        seen = cv2.warpAffine(picture, M, (width, height), borderMode=cv2.BORDER_REFLECT)
        noise = rng.normal(0.0, NOISE_LEVELS, (height, width, 1))
        yield np.clip(seen + noise, 0, 255).astype(np.uint8)
        aside = (1 - RETURN) * aside + rng.normal(0.0, SWAY, 2)
        turn_deg = (1 - RETURN) * turn_deg + rng.normal(0.0, TURN_DEG)


def write(picture: Image, out: Path, seconds: float) -> None:
    """Write the film as H.264."""
    height, width = (n - n % 2 for n in picture.shape[:2])
    with av.open(str(out), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(RATE_HZ))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": "20"}
        for seen in film(picture[:height, :width], seconds):
            shown = av.VideoFrame.from_ndarray(np.ascontiguousarray(seen), format="bgr24")
            container.mux(stream.encode(shown))
        container.mux(stream.encode())


def read(path: Path, width: int | None) -> Image:
    """Return a picture (h, w, 3), scaled to a width; raises ValueError where it is none."""
    picture = cv2.imread(str(path))
    if picture is None:
        raise ValueError(f"{path} is no picture that can be read")
    if width is not None:
        height = round(picture.shape[0] * width / picture.shape[1])
        picture = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(picture, np.uint8)


def main() -> None:
    """Do as the module says."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("picture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--width", type=int, help="of the film, in pixels; default: the picture's")
    a = parser.parse_args()
    try:
        write(read(a.picture, a.width), a.out, a.seconds)
    except (ValueError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
