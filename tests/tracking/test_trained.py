"""The correlation filter on a tiny grid: its normal equations, its memory, and the peaks."""

import numpy as np
import pytest

from facetrack_cli.trackers.box.features import UPSAMPLED, Trainer, inverse, moved, peaks, spectrum
from tests.twins import cells as naive

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
