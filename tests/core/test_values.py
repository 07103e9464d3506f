"""Reduced images; spans of masks and their unions, against slow twins; words for what is missing, also of OpenCV."""

import itertools
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.core import geometry
from facetrack_cli.core.errors import UsageError, check_opencv, needed
from facetrack_cli.core.numbers import spans, union
from facetrack_cli.core.types import Frame, Planes, factor_for
from facetrack_cli.trackers.face import detectors


def naive_blocks(picture, factor):
    """Area means of whole blocks, halved again and again as bytes, each step rounded half up."""
    while factor > 1:
        h, w = picture.shape[0] // 2, picture.shape[1] // 2
        blocks = picture[: 2 * h, : 2 * w].reshape(h, 2, w, 2, 3).astype(int)
        picture, factor = (blocks.sum(axis=(1, 3)) + 2) // 4, factor // 2
    return picture


anywhere = st.tuples(st.floats(-90, 190), st.floats(-90, 150), st.floats(0, 120), st.floats(0, 90))


@given(calls=st.lists(st.tuples(st.booleans(), st.sampled_from([1, 2, 4, 8]), anywhere), min_size=1, max_size=8))
def test_a_part_is_that_of_the_whole_picture_whatever_was_asked_before(calls):
    picture = np.random.default_rng(1).integers(0, 256, (61, 98, 3), dtype=np.uint8)
    frame = Frame(0, 0.0, picture)
    for grey, factor, (x, y, w, h) in calls:
        seen, left, top = (frame.grey if grey else frame.reduced)(factor, (x, y, x + w, y + h))
        whole = Frame(0, 0.0, picture).reduced(factor, (0, 0, 98, 61))[0]
        np.testing.assert_allclose(whole, naive_blocks(picture, factor), atol=1)
        whole = cv2.cvtColor(whole, cv2.COLOR_BGR2GRAY) if grey else whole
        i, j = top // factor, left // factor
        assert left % factor == top % factor == 0
        np.testing.assert_array_equal(seen, whole[i : i + seen.shape[0], j : j + seen.shape[1]])
        # all of the extent that there is
        rows, columns = whole.shape[:2]
        assert j <= min(max(x // factor, 0), columns - 1) and i <= min(max(y // factor, 0), rows - 1)
        assert j + seen.shape[1] > min(max((x + w) // factor, 0), columns - 1)
        assert i + seen.shape[0] > min(max((y + h) // factor, 0), rows - 1)
    assert frame.bgr is picture


@pytest.mark.parametrize("shape", [(1, 1, 3), (3, 2, 3), (2, 9, 3)])
def test_a_picture_smaller_than_a_block_is_one_block(shape):
    small, _, _ = Frame(0, 0.0, np.full(shape, 77, np.uint8)).reduced(8, (0, 0, 1, 1))
    assert small.size and np.all(small == 77)


@pytest.mark.parametrize(
    ("longest", "most", "factor"),
    [(100.0, None, 1), (5.0, 64, 1), (64.0, 64, 1), (64.5, 64, 2), (128.0, 64, 2), (129.0, 64, 4), (3840.0, 15, 256)],
)
def test_the_factor_is_the_least_power_of_two_that_brings_a_length_below_its_bound(longest, most, factor):
    assert factor_for(longest, most) == factor


@given(
    calls=st.lists(st.tuples(anywhere, st.sampled_from([1, 2, 4])), min_size=1, max_size=4),
    width=st.integers(1, 70),
    height=st.integers(1, 50),
    matrix=st.booleans(),
)
def test_a_part_of_planes_has_the_colours_and_the_grey_of_the_whole(calls, width, height, matrix):
    pixels = np.random.default_rng(2).integers(0, 256, (3 * height, 2 * width), dtype=np.uint8)
    ours = np.array([[1.0, 0.1015625, 0.19140625], [0.0, 0.9921875, -0.109375], [0.0, -0.0703125, 0.984375]])
    planes = Planes.of(pixels)._replace(ours=ours if matrix else None)
    frame, same, whole = Frame(0, 0.0, planes), Frame(0, 0.0, planes), Frame(0, 0.0, Frame(0, 0.0, planes).pixels)
    assert matrix or np.array_equal(whole.pixels, pixels)
    for (x, y, w, h), factor in calls:
        part, left, top = frame.reduced(1, (x, y, x + w, y + h))
        assert np.array_equal(part, whole.bgr[top : top + part.shape[0], left : left + part.shape[1]])
        right, bottom = left + part.shape[1] - 1, top + part.shape[0] - 1
        assert left <= max(x, 0) or x > 2 * width - 1
        assert top <= max(y, 0) or y > 2 * height - 1
        assert right >= min(x + w, 2 * width - 1) and bottom >= min(y + h, 2 * height - 1)
        everything = same.planes(factor, (0, 0, 2 * width, 2 * height))
        for (some, left, top, own), (all_, *_) in zip(
            frame.planes(factor, (x, y, x + w, y + h)), everything, strict=True
        ):
            i, j = top // own, left // own
            assert np.array_equal(some, all_[i : i + some.shape[0], j : j + some.shape[1]])
        (some, left, top), (all_, *_) = (
            one.grey(factor, extent)
            for one, extent in ((frame, (x, y, x + w, y + h)), (same, (0, 0, 2 * width, 2 * height)))
        )
        i, j = top // factor, left // factor
        assert np.array_equal(some, all_[i : i + some.shape[0], j : j + some.shape[1]])
        assert factor > 1 or np.array_equal(all_, whole.grey(1, (0, 0, 2 * width, 2 * height))[0])


def naive_spans(mask, apart):
    found = []
    for row, holds in enumerate(mask):
        if holds and found and found[-1][1] == row and not apart[row]:
            found[-1] = (found[-1][0], row + 1)
        elif holds:
            found.append((row, row + 1))
    return found


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=12))
def test_spans_are_half_open_runs_of_true(rows):
    mask, apart = ([row[k] for row in rows] for k in (0, 1))
    array = np.array(mask, np.bool_)
    assert spans(array) == naive_spans(mask, [False] * len(mask))
    assert spans(array, np.array(apart[1:], np.bool_)) == naive_spans(mask, apart)


@given(st.lists(st.tuples(st.integers(0, 20), st.integers(1, 6)), max_size=8), st.integers(0, 3))
def test_a_union_covers_the_same_and_closes_gaps(found, gap):
    joined = union([(begin, begin + length) for begin, length in found], gap)
    covered = {place for begin, length in found for place in range(begin, begin + length)}
    assert covered <= {place for begin, end in joined for place in range(begin, end)}
    assert all(later[0] - earlier[1] > gap for earlier, later in itertools.pairwise(joined))
    assert gap or covered == {place for begin, end in joined for place in range(begin, end)}


def test_a_missing_module_is_named_as_it_is_installed():
    with (
        pytest.raises(UsageError, match=r"^HDF5 files need PyTables, which is not installed: pip install"),
        needed("HDF5 files", "x"),
    ):
        raise ModuleNotFoundError(name="tables")


# --- another OpenCV than 4 or 5
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
