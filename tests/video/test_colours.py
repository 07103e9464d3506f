"""Colours are those of the file: its matrix and its range, in what is read and in what is written."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.video.seek import Frames
from facetrack_cli.video.source import open_source
from facetrack_cli.video.writer import VideoWriter
from tests.support import media

COLOURS = [
    (0, 0, 255),
    (0, 255, 0),
    (255, 0, 0),
    (255, 255, 255),
    (90, 130, 200),
    (40, 60, 20),
    (128, 128, 128),
    (0, 0, 0),
]


def patches(size: tuple[int, int] = (128, 64)) -> np.ndarray:
    image = np.zeros((size[1], size[0], 3), np.uint8)
    for i, colour in enumerate(COLOURS):
        image[:, i * size[0] // 8 : (i + 1) * size[0] // 8] = colour
    return image


def middles(image: np.ndarray) -> np.ndarray:
    width = image.shape[1] // 8
    return np.array([np.median(image[:, i * width + 4 : (i + 1) * width - 4], axis=(0, 1)) for i in range(8)])


def coded(path: Path, matrix: str, full: bool, form: str) -> Path:
    span = "pc" if full else "tv"
    way = f"scale=out_color_matrix={matrix}:out_range={span},format={form}"
    tags = f"setparams=colorspace={matrix}:range={span}"
    options = ("-vf", f"{way},{tags}", "-c:v", "libx264", "-crf", "1", "-pix_fmt", form)
    return media.write_video(path, frames=[patches()] * 4, options=options)


@pytest.mark.parametrize("matrix", ["bt709", "bt470bg", "smpte170m", "bt2020nc", "smpte240m"])
@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("form", ["yuv420p", "yuv444p"])
def test_colours_are_those_that_the_file_says(tmp_path: Path, matrix: str, full: bool, form: str) -> None:
    path = coded(tmp_path / "clip.mkv", matrix, full, form)
    with open_source(path) as source, Frames(path) as frames:
        first = next(iter(source))
        np.testing.assert_allclose(middles(first.bgr), COLOURS, atol=6)
        np.testing.assert_allclose(middles(frames.read(2).bgr), COLOURS, atol=6)
        grey = cv2.cvtColor(first.bgr, cv2.COLOR_BGR2GRAY)
        np.testing.assert_allclose(first.grey(1, (0, 0, 127, 63))[0], grey[: grey.shape[0]], atol=6)
        with VideoWriter(tmp_path / "out.mp4", source.size, source.fps) as video:
            video.write(first.bgr, 0.0)
    with open_source(tmp_path / "out.mp4") as written:
        np.testing.assert_allclose(middles(next(iter(written)).bgr), COLOURS, atol=8)


@pytest.mark.parametrize("size", [(128, 64), (1280, 720)])
def test_what_a_large_video_writes_is_read_with_its_colours(tmp_path: Path, size: tuple[int, int]) -> None:
    with VideoWriter(tmp_path / "out.mp4", size, 25) as video:
        video.write(patches(size), 0.0)
    with open_source(tmp_path / "out.mp4") as source:
        np.testing.assert_allclose(middles(next(iter(source)).bgr), COLOURS, atol=6)


def test_a_file_that_says_nothing_is_read_as_opencv_reads_it(tmp_path: Path) -> None:
    way = "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p,setparams=colorspace=unknown:range=unknown"
    path = media.write_video(
        tmp_path / "clip.mp4", frames=[patches((1280, 720))] * 2, options=("-vf", way, "-c:v", "libx264", "-crf", "1")
    )
    got, theirs = cv2.VideoCapture(str(path)).read()
    with open_source(path) as source:
        ours = middles(next(iter(source)).bgr)
    assert got
    np.testing.assert_allclose(ours, middles(theirs), atol=4)
