"""What a correlation filter sees of a frame: windows resampled to a fixed size, and their channels.

Channels are histograms of oriented gradients (Felzenszwalb et al. 2010), grey, and a and b of CIELAB where the clip has
colours, reduced to the principal components of the first frame (as Danelljan et al. 2014, fDSST, and 2017, ECO).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.types import Array, Frame, Image, factor_for
from facetrack_cli.core.warp import warp_affine
from facetrack_cli.trackers.box.cell_kernels import CHANNELS, gradients, project

Single: TypeAlias = NDArray[np.float32]
CELL = 4  # pixels of a resampled window
_CHROMA = 60.0  # levels of a and b that count as much as the whole range of grey
_COLOURS = 2.0  # grey levels by which channels differ on average in a clip with colours


def resample(
    frame: Frame, centre: Array, sides: tuple[float, float], shape: tuple[int, int], *, colour: bool = False
) -> Image:
    """The window of `sides` (w, h) pixels around `centre` as an image of `shape` (w, h), in grey or BGR.

    Beyond the frame the nearest pixel is read. Windows of more pixels are read from the frame reduced by area means.
    """
    step = max(side / n for side, n in zip(sides, shape, strict=True))
    factor = factor_for(max(step, 1e-6), 2.0) if step >= 2.0 else 1
    x, y = centre.tolist()
    half = tuple(side / 2 + 2 * factor for side in sides)
    read = frame.reduced if colour else frame.grey
    image, left, top = read(factor, (x - half[0], y - half[1], x + half[0], y + half[1]))
    u, v = ((at - edge - 0.5 * (factor - 1)) / factor for at, edge in ((x, left), (y, top)))
    a, b = (side / n / factor for side, n in zip(sides, shape, strict=True))
    to = np.array([[a, 0.0, u - a * (shape[0] - 1) / 2], [0.0, b, v - b * (shape[1] - 1) / 2]])
    return np.asarray(warp_affine(image, to, shape, cv2.BORDER_REPLICATE, inverse=True), np.uint8)


def cells_of(grey: Image, out: Single) -> None:
    """The gradients of an image (H, W) into `out` (31, H / 4, W / 4)."""
    gradients(np.multiply(grey, np.float32(1 / 255), dtype=np.float32), CELL, out)


def has_colours(image: Image) -> bool:
    return float(np.abs(image[..., 0].astype(np.int16) - image[..., 2]).mean()) > _COLOURS


def spectrum(x: Single) -> Single:
    """The Fourier transform (2, C, F) of x (C, G, G): real and imaginary parts of the F = G (G / 2 + 1) frequencies."""
    found = np.fft.rfft(x)
    found = np.fft.fft(found, axis=1, out=found).reshape(len(x), -1)
    both = np.empty((2, *found.shape), np.float32)
    both[0], both[1] = found.real, found.imag
    return both


def inverse(v: Single, cells: int) -> Single:
    """`spectrum` undone: (2, C, F) -> (C, G, G)."""
    whole: Any = joined(v).reshape(-1, cells, cells // 2 + 1)
    return np.fft.irfft(np.fft.ifft(whole, axis=1, out=whole), cells).astype(np.float32, copy=False)


def joined(v: Single) -> NDArray[np.complex64]:
    """Real and imaginary parts (2, ...) as complex numbers (...)."""
    found = np.empty(v.shape[1:], np.complex64)
    found.real, found.imag = v
    return found


@dataclass(frozen=True, eq=False)
class Features:
    """How windows of `cells` x `cells` cells become channels: `components` (C, L) of L features, tapered by `taper`."""

    cells: int
    colour: bool
    components: Single
    taper: Single  # (G * G,), with the scale that gives the first window a mean energy of 1 a cell

    @classmethod
    def learn(cls, frame: Frame, centre: Array, side: float, cells: int, count: int) -> Features:
        """The `count` principal components of the window of the first frame."""
        image = resample(frame, centre, (side, side), (CELL * cells, CELL * cells), colour=True)
        colour = has_colours(image)
        hann = np.hanning(cells + 2)[1:-1].astype(np.float32)
        taper = np.outer(hann, hann).ravel()
        features = _features(image, cells, colour=colour) * np.sqrt(taper)
        _, vectors = np.linalg.eigh((features @ features.T).astype(np.float64))
        kept = np.ascontiguousarray(vectors[:, ::-1][:, :count].T.astype(np.float32))
        kept *= np.sign(kept[np.arange(len(kept)), np.abs(kept).argmax(axis=1)])[:, None]  # LAPACK leaves it open
        plain = cls(cells, colour, kept, taper)
        energy = float(np.mean(np.sum(plain._project(_features(image, cells, colour=colour)) ** 2, axis=0)))
        return cls(cells, colour, kept, taper / np.float32(np.sqrt(max(energy, 1e-12))))

    def read(self, frame: Frame, centre: Array, side: float) -> tuple[Single, Image]:
        """The channels' spectrum (2, C, F) of the window of `side` pixels around `centre`, and the window itself."""
        n = CELL * self.cells
        image = resample(frame, centre, (side, side), (n, n), colour=self.colour)
        channels = self._project(_features(image, self.cells, colour=self.colour))
        return spectrum(channels.reshape(-1, self.cells, self.cells)), image

    def _project(self, features: Single) -> Single:
        out = np.empty((len(self.components), features.shape[1]), np.float32)
        project(self.components, features, self.taper, out)
        return out


def _features(image: Image, cells: int, *, colour: bool) -> Single:
    """(L, G * G): the features of an image (4 G, 4 G), or (4 G, 4 G, 3)."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    out = np.empty((CHANNELS + 1 + 2 * colour, cells, cells), np.float32)
    cells_of(np.asarray(grey, np.uint8), out[:CHANNELS])
    small = (cells, cells)
    out[CHANNELS] = cv2.resize(grey, small, interpolation=cv2.INTER_AREA) * np.float32(1 / 255) - np.float32(0.5)
    if colour:
        lab = cv2.cvtColor(cv2.resize(image, small, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2LAB)
        out[CHANNELS + 1 :] = np.moveaxis((lab[..., 1:].astype(np.float32) - 128) / np.float32(_CHROMA), 2, 0)
    return out.reshape(len(out), -1)
