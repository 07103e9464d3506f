"""The parts of the correlation filter: kernels, equations on a tiny grid, scale, colours, and the height of peaks."""

import math
import os
import subprocess
import sys

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from facetrack_cli.trackers.box import box_kernels as cells
from facetrack_cli.trackers.box.correlation_filter import Heights, ResponseView, Usual, evidence
from facetrack_cli.trackers.box.features import (
    UPSAMPLED,
    ColourModel,
    ScaleTrainer,
    Trainer,
    inverse,
    moved,
    peaks,
    shrunk,
    spectrum,
)
from tests.support.images import grey, smooth
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
    values = singles(np.random.default_rng(seed), *shape)
    x, y = (np.array(column) for column in zip(*places, strict=True))
    out = np.full(len(x), np.nan)
    cells.read_cubic(values, x, y, out)
    np.testing.assert_allclose(out, [naive.read_cubic(values.astype(float), *at) for at in places], atol=1e-9)


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
        for threads in ("1", "3")
    }
    assert len(components) == 1 and len(components.pop()) == 4 * 8 * 34


# --- normal equations, the memory, and the peaks

G, C = 8, 2
BOX = (3.0, 2.0)


def channels(seed, cells=G, count=C, *, taper=True):
    """Random channels (C, G, G) with a mean energy of 1 a cell."""
    x = np.random.default_rng(seed).standard_normal((count, cells, cells))
    if taper:
        hann = np.hanning(cells + 2)[1:-1]
        x *= np.outer(hann, hann)
    return (x / np.sqrt(np.mean(np.sum(x**2, axis=0)))).astype(np.float32)


def trainer(cells=G, **changes):
    return Trainer(**{"cells": cells, "box": BOX, "sigma": 0.8, **changes})


def wanted(sigma=0.8, cells=G):
    """y (G, G), with place 0 at [0, 0]."""
    d = np.minimum(np.arange(cells), cells - np.arange(cells))
    return np.exp(-0.5 * np.add.outer(d**2, d**2) / sigma**2)


def shifted(x):
    """(G G, C G G): the row of c are the channels moved by -c, so that it times f is the response at c."""
    return np.array(
        [np.roll(x, (-i, -j), axis=(1, 2)).ravel() for i in range(x.shape[1]) for j in range(x.shape[2])], dtype=float
    )


@pytest.mark.parametrize("by", [(0, 0), (2, -3), (-1, 4)])
def test_a_moved_spectrum_is_that_of_the_moved_channels(by):
    x = channels(0, 8, 3, taper=False)
    np.testing.assert_allclose(
        moved(spectrum(x), np.array(by, float), 8), spectrum(np.roll(x, (-by[1], -by[0]), axis=(1, 2))), atol=1e-4
    )
    there_and_back = moved(moved(spectrum(channels(1)), np.array([0.3, -0.4]), G), np.array([-0.3, 0.4]), G)
    few = spectrum(channels(1)).reshape(2, C, G, -1)[:, :, :, : G // 2]
    kept = [row for row in range(G) if row != G // 2]  # all but the highest frequency
    np.testing.assert_allclose(there_and_back.reshape(2, C, G, -1)[:, :, kept, : G // 2], few[:, :, kept], atol=1e-4)


def test_a_memory_of_many_windows_is_their_weighted_sum():
    one, rate = trainer(steps=60), 0.1
    windows = [channels(seed) for seed in range(12)]
    known = one.begin(spectrum(windows[0]))
    for x in windows[1:]:
        known = one.learn(known, spectrum(x), rate)
    weights = [(1 - rate) ** 11, *(rate * (1 - rate) ** (11 - k) for k in range(1, 12))]
    assert sum(weights) == pytest.approx(1.0)
    z = [naive.complexes(spectrum(x)) for x in windows]
    whole = sum(pi * np.einsum("if,jf->fij", a, a.conj()) for pi, a in zip(weights, z, strict=True))
    np.testing.assert_allclose(naive.matrices(known.matrices, C), whole, atol=1e-4 * np.abs(whole).max())
    y = np.fft.rfft2(wanted()).ravel()
    right = sum(pi * a * y.conj() for pi, a in zip(weights, z, strict=True))
    walled = spectrum(inverse(known.filters, G) * one.wall)
    np.testing.assert_allclose(known.walled, walled, atol=1e-4 * np.abs(walled).max())
    left = right - naive.multiply(whole, known.filters) - naive.complexes(walled)
    np.testing.assert_allclose(naive.complexes(known.residual), left, atol=1e-4 * np.abs(right).max())
    # the filters by the full linear system of sum_k pi_k |B_k f - y|^2 + |w f|^2, w squared
    rows = [shifted(x) for x in windows]
    left = sum(pi * b.T @ b for pi, b in zip(weights, rows, strict=True))
    right = sum(pi * b.T @ wanted().ravel() for pi, b in zip(weights, rows, strict=True))
    exact = np.linalg.solve(left + np.diag(np.tile(one.wall.astype(float).ravel(), C)), right).reshape(C, G, G)
    np.testing.assert_allclose(inverse(known.filters, G), exact, atol=0.01 * np.abs(exact).max())


def test_the_response_is_the_correlation_with_the_filters():
    one, x = trainer(), channels(5)
    filters = one.begin(spectrum(x)).filters
    other = channels(6)
    plain = (shifted(other) @ inverse(filters, G).ravel().astype(float)).reshape(G, G)
    found = np.fft.ifftshift(one.respond(spectrum(other), filters)[0])[::UPSAMPLED, ::UPSAMPLED]
    # between the cells the highest frequency is left out
    few = np.fft.fft2(plain)
    few[G // 2], few[:, G // 2] = 0, 0
    np.testing.assert_allclose(found, np.fft.ifft2(few).real, atol=1e-4)


@pytest.mark.parametrize("at", [(11.0, 12.0), (11.3, 12.45), (10.52, 13.4)])
def test_the_vertex_of_a_parabola_is_exact(at):
    y, x = np.mgrid[:24, :24]
    response = (3 - 0.01 * (x - at[0]) ** 2 - 0.02 * (y - at[1]) ** 2).astype(np.float32)
    np.testing.assert_allclose(peaks(response, 0.5, 3), [(*at, 3.0)], atol=1e-3)


def test_peaks_come_by_their_height():
    y, x = np.mgrid[:24, :24]
    tops = (5, 6, 0.6), (17, 5, 1.0), (12, 18, 0.8), (20, 20, 0.3)
    response = sum(h * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 8) for u, v, h in tops).astype(np.float32)
    found = peaks(response, 0.5, 9)
    np.testing.assert_allclose(found[:, :2], [(17, 5), (12, 18), (5, 6)], atol=0.05)
    assert list(found[:, 2]) == sorted(found[:, 2], reverse=True)
    np.testing.assert_allclose(peaks(response, 0.5, 2), found[:2])
    assert len(peaks(response, 0.1, 9)) == 4


def test_a_peak_on_the_border_is_the_last_resort():
    response = np.add.outer(np.zeros(8), np.arange(8.0)).astype(np.float32)
    np.testing.assert_array_equal(peaks(response, 0.5, 3), [(7, 0, 7)])


# --- scale, and the colours of target and surroundings

CENTRE = np.array([80.3, 59.6])
STEP = 1.02
SCALES = (32.0, 40.0), 33, STEP


@pytest.mark.parametrize("k", [0.92, 1.04])
def test_the_peak_is_at_the_scale(k):
    one, picture = ScaleTrainer(*SCALES), smooth(0)
    known = one.learn(None, one.read(grey(picture), CENTRE, 1.0), 1.0)
    to = np.array([[k, 0, (1 - k) * CENTRE[0]], [0, k, (1 - k) * CENTRE[1]]])
    zoomed = cv2.warpAffine(picture, to, (160, 120), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    response = one.respond(known, one.read(grey(zoomed), CENTRE, 1.0))
    assert one.log_scales[int(response.argmax())] == pytest.approx(math.log(k), abs=1.01 * math.log(STEP))


@pytest.mark.parametrize("steps", [-2, 0, 1])
def test_a_moved_spectrum_peaks_where_the_scale_moved_to(steps):
    one, picture = ScaleTrainer(*SCALES), smooth(0)
    x = one.read(grey(picture), CENTRE, 1.0)
    response = one.respond(one.learn(None, x, 1.0), one.moved(x, steps * math.log(STEP)))
    assert response.argmax() == 16 - steps, "as a window read at a larger scale, in which the target is smaller"


def test_the_response_is_dssts_equation_6():
    one = ScaleTrainer((32.0, 40.0), 9, STEP)
    x, z = (one.read(grey(smooth(seed)), CENTRE, 1.0) for seed in (0, 1))
    signal, other = (np.fft.irfft(of, n=9, axis=0).astype(float) for of in (x, z))
    n = np.arange(9)
    y = np.exp(-0.5 * (np.minimum(n, 9 - n) / (9 / 16)) ** 2)
    # filters h with h * x = y, as a ridge regression of circular shifts: sum_d conj(A) Z / (B + lambda)
    whole = [np.fft.fft(of, axis=0) for of in (signal, other)]
    a, b = np.fft.fft(y).conj()[:, None] * whole[0], np.sum(np.abs(whole[0]) ** 2, axis=1)
    exact = np.fft.ifft(np.sum(a.conj() * whole[1], axis=1) / (b + 0.01)).real
    found = one.respond(one.learn(None, x, 1.0), z)
    np.testing.assert_allclose(found, np.roll(exact, 4), atol=1e-3)


SIDE = 160


def square(inside, outside, noise=0.0, seed=0, side=SIDE, at=(0, 0)):
    """A shrunk window of `side` pixels, in whose middle, moved by `at`, is a square of a fifth of its side."""
    image = np.full((side, side, 3), outside, float)
    half, middle = side // 10, side // 2
    x, y = middle + at[0], middle + at[1]
    image[y - half : y + half, x - half : x + half] = inside
    image += noise * np.random.default_rng(seed).normal(0, 1, image.shape)
    return shrunk(np.clip(image, 0, 255).astype(np.uint8))


RED, GREEN = (20, 30, 210), (40, 160, 50)


@pytest.mark.parametrize("noise", [0.0, 12.0])
@pytest.mark.parametrize("samples", [32, 64])
@pytest.mark.parametrize("at", [(0, 0), (30, -20)])
def test_a_red_square_on_green_is_told_and_found(noise, samples, at):
    model = ColourModel((0.2, 0.2))
    known = model.learn(None, square(RED, GREEN, noise), 1.0)
    assert known.tells > 0.7
    score = model.respond(known, square(RED, GREEN, noise, 1, at=at), samples)
    assert score.shape == (samples, samples)
    assert score.min() >= 0 and score.max() <= 1 + 1e-6
    row, column = np.argwhere(score > score.max() - 0.02).mean(axis=0)
    np.testing.assert_allclose([column, row], [samples / 2 + k * samples / SIDE for k in at], atol=0.03 * samples + 1)
    assert score.max() > 0.7 > 0.2 > np.median(score)


@pytest.mark.parametrize("noise", [0.0, 12.0])
def test_where_colours_are_alike_they_say_nothing(noise):
    model = ColourModel((0.2, 0.2))
    known = model.learn(None, square(GREEN, GREEN, noise), 1.0)
    assert model.respond(known, square(GREEN, GREEN, noise, 1), 64) is None


# --- how high peaks are: moments against sums, and the evidence against densities, written out


def log_density(x, of):
    """Of Student's distribution with 3 degrees of freedom, at x, but for a constant."""
    return -2 * math.log(1 + ((x - of.mean) / of.std) ** 2 / 3) - math.log(of.std)


SEEN, OTHER, BOUND = Heights(0.6, 0.09, 40.0), Heights(0.15, 0.05, 10.0), 4.0


@pytest.mark.parametrize("height", [0.1, 0.2, 0.31, 0.37, 0.5, 0.7])
def test_evidence_is_the_log_ratio_of_two_densities_of_student(height):
    # flat beyond the mean on the side away from the other density
    ratio = log_density(min(height, SEEN.mean), SEEN) - log_density(max(height, OTHER.mean), OTHER)
    assert evidence(SEEN, OTHER, height, 100.0) == pytest.approx(ratio)
    assert evidence(SEEN, OTHER, height, BOUND) == pytest.approx(np.clip(ratio, -BOUND, BOUND))


def test_running_moments_are_those_of_the_peaks():
    rng = np.random.default_rng(0)
    peaks, learned = 0.5 + 0.08 * rng.standard_normal(2000), Heights(0.8, 0.1, 10.0)
    for peak in peaks:
        learned = learned.learn(float(peak), 1.0)
    assert learned.mean == pytest.approx(0.5, abs=0.04) and learned.std == pytest.approx(0.08, rel=0.25)
    assert learned.learn(0.1, 0.0) == learned, "nothing is learned of a target that is hidden"


def test_few_bad_frames_do_not_move_the_mean():
    learned = SEEN.learn(0.0, 1.0)
    assert SEEN.mean - learned.mean == pytest.approx(2 * SEEN.std / 41)


def test_the_standard_deviation_is_bounded_by_shares_of_the_mean():
    assert Heights(0.5, 0.0, 50).spread == pytest.approx(0.05) and Heights(0.5, 9.0, 50).spread == pytest.approx(0.1)
    assert Heights(0.0, 0.0, 50).spread > 0


def test_peaks_elsewhere_are_learned_where_the_target_is_hidden():
    usual, peaks = Usual(SEEN, SEEN, OTHER, OTHER), ((0.2, 0.2), 0.3)
    hidden, shown = usual.learn(*peaks, 0.0), usual.learn(*peaks, 1.0)
    assert hidden.now == SEEN and hidden.elsewhere.mean > OTHER.mean
    assert shown.now.mean < SEEN.mean and shown.elsewhere == OTHER
    assert hidden.others == shown.others == OTHER


@pytest.mark.parametrize("at", [(0, 0), (9, 14), (30, 20)])
def test_heights_of_a_view_are_the_highest_within_a_cell(at):
    rng = np.random.default_rng(1)
    now, first = rng.random((2, 40, 40), np.float32)
    column, row = at
    found = ResponseView(np.zeros(2), now, now, now, now, first).heights(np.array([column + 0.3, row - 0.3, 1.0]))
    near = [(i, j) for i in range(40) for j in range(40) if abs(i - row) <= UPSAMPLED and abs(j - column) <= UPSAMPLED]
    assert found == (float(max(now[i, j] for i, j in near)), float(max(first[i, j] for i, j in near)))
    assert not math.isnan(found[0])
