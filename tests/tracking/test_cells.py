"""The kernels of the correlation filter against their plain twins, and what they make of flat and tiny images."""

import os
import subprocess
import sys

import cv2
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.trackers.box import box_kernels as cells
from tests.twins import cells as naive

seeds = st.integers(0, 10_000)


def test_chroma_has_the_levels_of_opencv():
    image = np.random.default_rng(0).integers(0, 256, (500, 700, 3), np.uint8)
    image[:2, :256] = np.arange(256)[:, None]
    out = np.full((2, 500, 700), np.nan, np.float32)
    cells.chroma(image, out)
    off = 60 * np.moveaxis(out, 0, 2) + 128 - cv2.cvtColor(image, cv2.COLOR_BGR2LAB)[..., 1:]
    assert np.mean(np.abs(off) > 0.01) < 1e-3 and np.abs(off).max() < 1.01  # another cubic root may round otherwise


def test_colours_are_what_their_plain_twin_says():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (12, 9, 3), np.uint8)
    target, around = (np.maximum(rng.normal(0, 1, (2, cells.COLOURS)), 0)).astype(np.float32)
    bins, p = np.empty(108, np.int64), np.empty(108, np.float32)
    cells.colours(image, target, around, bins, p)
    for ours, theirs in zip((bins, p), naive.colours(image, target, around), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-6)


@given(seed=seeds, rate=st.floats(0, 1))
def test_a_tally_moves_a_histogram_as_its_plain_twin_does(seed, rate):
    rng = np.random.default_rng(seed)
    histogram, bins, part = rng.random(9, np.float32), rng.integers(0, 9, 20), rng.permutation(20)[:7]
    cells.tally(histogram, bins, part, np.float32(rate), out := np.empty(9, np.float32))
    np.testing.assert_allclose(out, naive.tally(histogram, bins.tolist(), part, rate), atol=1e-6)


@given(seed=seeds, most=st.integers(1, 5), levels=st.integers(2, 50))
def test_the_highest_places_are_those_of_their_plain_twin(seed, most, levels):
    response = np.random.default_rng(seed).integers(0, levels, (9, 7)).astype(np.float32)
    count = cells.highest(response, np.float32(1.0), out := np.empty((most, 3)))
    tops = naive.highest(response, 1.0)[:most]
    assert count == len(tops)
    for (column, row, height), (i, j) in zip(out, tops, strict=False):
        assert abs(column - j) <= 0.5 and abs(row - i) <= 0.5 and height >= response[i, j]


def singles(rng, *shape):
    return rng.standard_normal(shape).astype(np.float32)


@given(seed=seeds, rows=st.integers(1, 5), columns=st.integers(1, 5), cell=st.sampled_from([2, 3, 4, 8]))
def test_gradients_are_what_their_plain_twin_says(seed, rows, columns, cell):
    grey = np.random.default_rng(seed).random((rows * cell, columns * cell), np.float32)
    cells.gradients(grey, cell, out := np.full((cells.CHANNELS, rows, columns), np.nan, np.float32))
    np.testing.assert_allclose(out, naive.gradients(grey.astype(float), cell), atol=2e-5)


@given(
    seed=seeds,
    x=st.floats(-10, 50),
    y=st.floats(-10, 40),
    sides=st.lists(st.tuples(st.floats(2, 60), st.floats(2, 60)), min_size=1, max_size=3),
    rows=st.integers(1, 3),
    columns=st.integers(1, 3),
)
def test_gradients_of_scales_are_those_of_windows_read_bilinearly(seed, x, y, sides, rows, columns):
    image = np.random.default_rng(seed).integers(0, 256, (31, 43), np.uint8)
    out = np.full((len(sides), cells.CHANNELS, rows, columns), np.nan, np.float32)
    cells.gradients_of_scales(image, x, y, np.array(sides), 4, out)
    assert np.isfinite(out).all()
    whole = [naive.window(image, x, y, *both, (4 * rows, 4 * columns)) for both in sides]
    theirs = np.array([naive.gradients(one, 4) for one in whole])
    # a direction halfway between two bins may fall into either
    assert np.mean(np.abs(out - theirs) > 1e-3) < 0.1


@given(seed=seeds, count=st.integers(1, 6), features=st.integers(1, 9), places=st.integers(1, 12))
def test_project_is_what_its_plain_twin_says(seed, count, features, places):
    rng = np.random.default_rng(seed)
    components, of, taper = singles(rng, count, features), singles(rng, features, places), singles(rng, places)
    out = np.full((count, places), np.nan, np.float32)
    cells.project(components, of, taper, out)
    np.testing.assert_allclose(out, naive.project(components, of, taper), atol=1e-4)


@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 7), st.integers(1, 7)),
    places=st.lists(st.tuples(st.floats(-4, 12), st.floats(-4, 12)), min_size=1, max_size=8),
)
def test_read_cubic_is_what_its_plain_twin_says(seed, shape, places):
    values = np.random.default_rng(seed).standard_normal(shape)
    x, y = (np.array(column) for column in zip(*places, strict=True))
    out = np.full(len(x), np.nan)
    cells.read_cubic(values, x, y, out)
    np.testing.assert_allclose(out, [naive.read_cubic(values, *at) for at in places], atol=1e-9)


def test_the_threads_of_blas_change_no_component():
    learns = """
import sys, numpy as np
from facetrack_cli.core.types import Frame
from facetrack_cli.trackers.box.features import Features
image = np.random.default_rng(0).integers(0, 256, (120, 120, 3), np.uint8)
sys.stdout.buffer.write(Features.learn(Frame(0, 0.0, image), np.array([60.0, 60.0]), 100.0, 32, 8).components.tobytes())
"""
    components = {
        subprocess.run(
            [sys.executable, "-c", learns],
            env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
            stdout=subprocess.PIPE,
            check=True,
        ).stdout
        for threads in ("1", "2", "3")
    }
    assert len(components) == 1 and len(components.pop()) == 4 * 8 * 34
