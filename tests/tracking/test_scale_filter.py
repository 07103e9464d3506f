"""The filter of scale, and the colours of target and surroundings."""

import math

import cv2
import numpy as np
import pytest

from facetrack_cli.trackers.box.features import ColourModel, ScaleTrainer, shrunk
from tests.support.images import grey, smooth

CENTRE = np.array([80.3, 59.6])
STEP = 1.02


def texture(seed=0):
    return np.clip(smooth(seed, 120, 160), 0, 255).astype(np.uint8)


def trainer(size=(32.0, 40.0), count=33, step=STEP):
    return ScaleTrainer(size, count, step)


@pytest.mark.parametrize("k", [0.92, 1.04])
def test_the_peak_is_at_the_scale(k):
    one, picture = trainer(), texture()
    known = one.learn(None, one.read(grey(picture), CENTRE, 1.0), 1.0)
    to = np.array([[k, 0, (1 - k) * CENTRE[0]], [0, k, (1 - k) * CENTRE[1]]])
    zoomed = cv2.warpAffine(picture, to, (160, 120), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    response = one.respond(known, one.read(grey(zoomed), CENTRE, 1.0))
    assert one.log_scales[int(response.argmax())] == pytest.approx(math.log(k), abs=1.01 * math.log(STEP))


@pytest.mark.parametrize("steps", [-2, 0, 1])
def test_a_moved_spectrum_peaks_where_the_scale_moved_to(steps):
    one, picture = trainer(), texture()
    x = one.read(grey(picture), CENTRE, 1.0)
    response = one.respond(one.learn(None, x, 1.0), one.moved(x, steps * math.log(STEP)))
    assert response.argmax() == 16 - steps, "as a window read at a larger scale, in which the target is smaller"


def test_the_response_is_dssts_equation_6():
    one = trainer(count=9)
    x, z = (one.read(grey(texture(seed)), CENTRE, 1.0) for seed in (0, 1))
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
