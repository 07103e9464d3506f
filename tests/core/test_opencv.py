"""Another OpenCV than 4 or 5 is told in one line, before anything asks what it has not."""

import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from facetrack_cli.core import geometry
from facetrack_cli.core.errors import UsageError, check_opencv
from facetrack_cli.trackers.face import detectors


def test_another_version_is_refused_with_its_packages():
    for version in ("6.0.0", "3.4.20", "of nothing"):
        with pytest.raises(UsageError, match=f"cv2 is {version}: .* pip install 'opencv-python-headless"):
            check_opencv(version)


@pytest.mark.one_in(4)
@pytest.mark.parametrize("command", ["run clip.mp4", "report out", "people out", "fix out"])
def test_every_command_beside_opencv_6_ends_in_one_line(tmp_path, command):
    (tmp_path / "cv2").mkdir()
    (tmp_path / "cv2" / "__init__.py").write_text('__version__ = "6.0.0"\n')
    (tmp_path / "clip.mp4").write_bytes(b"x")
    done = subprocess.run(
        [sys.executable, "-m", "facetrack_cli", *command.split()],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(Path(__file__).parents[2])])},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.startswith("facetrack: error: OpenCV 4 or 5 is needed, and cv2 is 6.0.0")


@pytest.mark.parametrize("missing", ["class", "files"])
def test_haar_beside_an_opencv_without_it_ends_in_one_line_with_the_remedy(tmp_path, monkeypatch, missing):
    if missing == "class":
        monkeypatch.delattr(cv2, "CascadeClassifier", raising=False)
    else:  # as in contrib 5
        monkeypatch.setattr(detectors, "_file", lambda name: tmp_path / name)
    detectors.has_cascades.cache_clear()
    try:
        with pytest.raises(UsageError, match=r"^the installed OpenCV .* has no Haar cascades; pip install .*detect"):
            detectors.check_cascades()
    finally:
        detectors.has_cascades.cache_clear()


def both(monkeypatch, see):
    """What is seen as by OpenCV 4, and as by OpenCV 5."""
    for rounds in (True, False):
        monkeypatch.setattr(geometry, "_ROUNDS", rounds)
        yield see()


@pytest.mark.skipif(not cv2.__version__.startswith("4."), reason="compares with OpenCV 4")
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("inverse", [False, True])
def test_a_warp_reads_where_opencv_4_reads(monkeypatch, channels, inverse):
    rng = np.random.default_rng(channels)
    image = rng.integers(0, 256, (61, 83, channels)).astype(np.uint8)
    for border in (cv2.BORDER_CONSTANT, cv2.BORDER_REPLICATE):
        for _ in range(20):
            linear = np.eye(2) * rng.uniform(0.3, 3) + rng.normal(0, 0.4, (2, 2))
            matrix = np.column_stack([linear, rng.normal(0, 30, 2)])
            warp = partial(geometry.warp_affine, image, matrix, (70, 50), border, inverse=inverse)
            assert np.array_equal(*both(monkeypatch, warp))
    x, y = (rng.uniform(-5, side + 5, (40, 30)).astype(np.float32) for side in (83, 61))
    read = partial(geometry.remap, image.astype(np.float32), x, y, cv2.BORDER_REPLICATE)
    assert np.array_equal(*both(monkeypatch, read))
