"""Who is who: Zhou, Chellappa & Moghaddam (ICME 2003), sections 3.2 and 3.3.

Three probabilistic subspaces (eq. 14, `subspaces.py`) over patches y of zero mean and unit variance:

    frontal   the patches of the gallery                                       p_f = most s(a log Q_FFS(y) + b), eq. 15
    intra     differences between pictures of one person, both signs           p_n = Q_IPS(y - I_n) / Q_EPS(y - I_n)
    extra     differences between pictures of different persons, both signs    eq. 16

What we take the paper to mean. Eq. 15 is a density and enters eq. 5 as a probability: s is a logistic function of
log Q, fitted to frontal faces that the subspace has not seen and to patches cut off the mark, and `most` keeps a frame
from deciding alone. Eq. 16 is a ratio of densities, of which only ratios between identities matter: it enters
normalised over them, for each patch.

I_n is one picture in the paper. Of several it is their mean, brought back to unit variance, and a difference is that of
a picture to what the other pictures of its person, or those of another person, make up; of two pictures that is their
difference, as published.

"none of them" is one more identity, whose log ratio is a threshold: where as many pictures of the gallery would be
taken for nobody as pictures of strangers for somebody.
"""

from __future__ import annotations

import os
import unicodedata
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from facetrack_cli.calibration import equal_errors, fit_logistic, logistic
from facetrack_cli.errors import InputError, OutputError
from facetrack_cli.resampling import logsumexp
from facetrack_cli.subspaces import Patches, Residual, Subspace, fit_subspace, folds_by
from facetrack_cli.types import Array

FORMAT = "facetrack-gallery"
VERSION = 1
NONE: Final = "none"  # what the posterior calls nobody of the gallery
MOST_FRONTAL = 0.95
_SPACES = ("frontal", "intra", "extra")


@dataclass(frozen=True, eq=False)
class Gallery:
    """Who is known, and how faces differ. P persons, patches of d = rows * cols points, flattened by rows.

    `faces` (P, d) are the I_n. `calibration` is (slope, offset) of p_f over log Q_FFS; `threshold` the log ratio of
    "none of them", and `errors` the share of either error there, on the gallery. `counts` (P,) pictures of each.
    Raises ValueError for anything else.
    """

    names: tuple[str, ...]
    faces: Patches
    shape: tuple[int, int]
    frontal: Subspace
    intra: Subspace
    extra: Subspace
    calibration: tuple[float, float]
    most_frontal: float
    threshold: float
    errors: float
    counts: tuple[int, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        p, d = len(self.names), self.shape[0] * self.shape[1]
        if p < 2 or len(set(self.names)) != p:
            raise ValueError("a gallery needs two persons or more, each named once")
        for name in self.names:
            if problem := name_problem(name):
                raise ValueError(problem)
        if min(self.shape) < 1 or self.faces.shape != (p, d):
            raise ValueError(f"faces of {self.faces.shape} where ({p}, {d}) belongs")
        if any(space.d != d for space in (self.frontal, self.intra, self.extra)):
            raise ValueError(f"a subspace is not of {d} points")
        if len(self.counts) != p or min(self.counts) < 1:
            raise ValueError("each person has one picture or more")
        numbers = (*self.calibration, self.most_frontal, self.threshold, self.errors)
        if not (np.isfinite(self.faces).all() and np.isfinite(numbers).all()):
            raise ValueError("a number is not finite")
        if np.abs(self.faces).max() > 2 * np.sqrt(d):
            raise ValueError("a face is not of unit variance")
        if self.calibration[0] < 0.0 or not 0.0 <= self.most_frontal <= 1.0:
            raise ValueError("p_f would not be a probability that grows with the density")

    def log_scores(self, patches: Patches, *, sharpness: float = 1.0, none: bool = False) -> tuple[Array, Array]:
        """p_f (N,) and log p_n (N, P) of patches (N, d), the latter with logsumexp 0 over the identities.

        With `none` a column more, of nobody. `sharpness` multiplies the log of eq. 16 (1 as published). A patch of
        zeros, where there was nothing to see, has p_f 0.
        """
        matrix, offsets = self._projection
        known = self._known
        y = np.asarray(patches, np.float32)
        projected = (y @ matrix).astype(np.float64) - offsets
        own = np.einsum("nd,nd->n", y, y).astype(np.float64)
        s_f, s_i, s_e = (len(space.values) for space in (self.frontal, self.intra, self.extra))
        q_f, q_i, q_e = projected[:, :s_f], projected[:, s_f : s_f + s_i], projected[:, s_f + s_i : s_f + s_i + s_e]
        with_mean, with_faces = projected[:, -1], projected[:, s_f + s_i + s_e : -1]

        norm = own - 2 * with_mean + known["mean"]
        frontal = self.calibration[0] * self._log_q(self.frontal, norm, q_f[:, None])[:, 0] + self.calibration[1]
        p_f = np.where(own > 0.0, self.most_frontal * logistic(frontal, 1.0, 0.0), 0.0)

        norms = own[:, None] - 2 * with_faces + known["faces"]
        log_ratio = self._log_q(self.intra, norms, q_i[:, None] - known["intra"])
        log_ratio -= self._log_q(self.extra, norms, q_e[:, None] - known["extra"])
        if none:
            log_ratio = np.concatenate([log_ratio, np.full((len(y), 1), self.threshold)], axis=1)
        log_ratio *= sharpness
        return p_f, log_ratio - logsumexp(log_ratio, axis=1)[:, None]

    def log_ratios(self, patches: Patches) -> Array:
        """(N, P): log of eq. 16 as it is."""
        return np.stack(
            [self.intra.log_density(patches - face) - self.extra.log_density(patches - face) for face in self.faces], 1
        )

    @staticmethod
    def _log_q(space: Subspace, norm: Array, q: Array) -> Array:
        """log Q from |x - mean|^2 (N,) or (N, P), and q (N, P, s)."""
        squares = q**2
        error = np.maximum(norm.reshape(len(q), -1) - squares.sum(2), 0.0) if len(space.values) < space.d else 0.0
        return np.asarray(space.log_constant - 0.5 * (squares @ (1.0 / space.values) + error / space.rho))

    @cached_property
    def _projection(self) -> tuple[Patches, Array]:
        """All that a patch is multiplied with, (d, s_f + s_i + s_e + P + 1), and what is taken off the products."""
        spaces = (self.frontal, self.intra, self.extra)
        rows = np.concatenate([*(space.vectors for space in spaces), self.faces, self.frontal.mean[None]])
        offsets = np.concatenate(
            [*(space.vectors.astype(np.float64) @ space.mean for space in spaces), np.zeros(len(self.faces) + 1)]
        )
        return np.ascontiguousarray(rows.T, np.float32), offsets

    @cached_property
    def _known(self) -> Mapping[str, Array]:
        faces, mean = self.faces.astype(np.float64), self.frontal.mean.astype(np.float64)
        return {
            "mean": np.array(mean @ mean),
            "faces": (faces**2).sum(1),
            "intra": faces @ self.intra.vectors.T,
            "extra": faces @ self.extra.vectors.T,
        }

    def save(self, path: Path) -> None:
        """Writes an .npz of plain arrays, whole or not at all; equal galleries give equal bytes. Raises OutputError."""
        arrays: dict[str, NDArray[np.generic]] = {
            "format": np.array(FORMAT),
            "version": np.array(VERSION, "<i8"),
            "names": np.array(self.names),
            "faces": np.ascontiguousarray(self.faces, "<f4"),
            "shape": np.array(self.shape, "<i8"),
            "calibration": np.array(self.calibration, "<f8"),
            "most_frontal": np.array(self.most_frontal, "<f8"),
            "threshold": np.array(self.threshold, "<f8"),
            "errors": np.array(self.errors, "<f8"),
            "counts": np.array(self.counts, "<i8"),
            "notes": np.array(self.notes, f"<U{max(map(len, self.notes), default=1)}"),
        }
        for name in _SPACES:
            space: Subspace = getattr(self, name)
            arrays[f"{name}_mean"] = np.ascontiguousarray(space.mean, "<f4")
            arrays[f"{name}_vectors"] = np.ascontiguousarray(space.vectors, "<f4")
            arrays[f"{name}_values"] = np.ascontiguousarray(space.values, "<f8")
            arrays[f"{name}_rho"] = np.array(space.rho, "<f8")
        temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            try:
                with temporary.open("wb") as file:
                    np.savez(file, **arrays)  # type: ignore[arg-type]
                temporary.replace(path)
            finally:
                temporary.unlink(missing_ok=True)
        except OSError as e:
            raise OutputError(f"{path}: cannot be written: {e.strerror or e}; name another file with -o") from e


def name_problem(name: str) -> str | None:
    """Why a person cannot be called this, or None."""
    if not name or any(unicodedata.category(letter) in ("Cc", "Cs") for letter in name):
        return f"{name!r} is no name: it is empty, or has letters that cannot be printed"
    return f"{NONE!r} stands for nobody of the gallery and is no name" if name == NONE else None


def load_gallery(path: Path) -> Gallery:
    """The gallery in a file that `save` wrote. Raises InputError for anything else; nothing in it is executed."""
    remedy = "make one with `facetrack gallery fit`"
    try:
        with path.open("rb") as raw:
            file = np.load(raw, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise InputError(f"{path}: is a bare array, not a gallery; {remedy}")
            found = {name: file[name] for name in ("format", "version") if name in file.files}
            if str(found.get("format")) != FORMAT:
                raise InputError(f"{path}: is not a gallery; {remedy}")
            if found.get("version") is None or found["version"].ravel()[0] != VERSION:
                raise InputError(
                    f"{path}: is a gallery of format version {found.get('version')}, and this facetrack reads "
                    f"version {VERSION}; fit it again with `facetrack gallery fit`"
                )
            return _from_arrays(file)
    except FileNotFoundError as e:
        raise InputError(f"{path}: there is no such gallery; {remedy}") from e
    except OSError as e:
        raise InputError(
            f"{path}: cannot be read: {e.strerror or e}; name a gallery, as `facetrack gallery fit` writes it"
        ) from e
    except KeyError as e:
        raise InputError(f"{path}: the gallery lacks an array: {e.args[0]}; {remedy}") from e
    except ValueError as e:
        reason = "it is no .npz of plain arrays" if "pickle" in str(e) else " ".join(str(e).split())
        raise InputError(f"{path}: is not a usable gallery: {reason}; {remedy}") from e
    except (TypeError, IndexError, EOFError, MemoryError, RuntimeError, zipfile.BadZipFile, zlib.error) as e:
        raise InputError(f"{path}: is not a usable gallery: it is no .npz of plain arrays; {remedy}") from e


def _from_arrays(file: np.lib.npyio.NpzFile) -> Gallery:
    def array(key: str, dtype: type, ndim: int) -> NDArray[np.generic]:
        found = file[key]
        if found.ndim != ndim or (dtype is np.str_) != (found.dtype.kind == "U") or found.dtype.kind not in "Uif":
            raise ValueError(f"{key} is an array of {found.dtype} and {found.ndim} axes")
        return np.asarray(found, dtype)

    def number(key: str) -> float:
        return float(array(key, np.float64, 0))  # type: ignore[arg-type]

    spaces = [
        Subspace(
            np.asarray(array(f"{name}_mean", np.float32, 1), np.float32),
            np.asarray(array(f"{name}_vectors", np.float32, 2), np.float32),
            np.asarray(array(f"{name}_values", np.float64, 1), np.float64),
            number(f"{name}_rho"),
        )
        for name in _SPACES
    ]
    shape, calibration = array("shape", np.int64, 1).tolist(), array("calibration", np.float64, 1).tolist()
    if len(shape) != 2 or len(calibration) != 2:
        raise ValueError("a shape and a calibration are two numbers each")
    return Gallery(
        tuple(map(str, array("names", np.str_, 1))),
        np.asarray(array("faces", np.float32, 2), np.float32),
        (shape[0], shape[1]),
        *spaces,
        calibration=(calibration[0], calibration[1]),
        most_frontal=number("most_frontal"),
        threshold=number("threshold"),
        errors=number("errors"),
        counts=tuple(array("counts", np.int64, 1).tolist()),
        notes=tuple(map(str, array("notes", np.str_, 1))),
    )


def fit_gallery(
    patches: NDArray[np.floating],
    persons: Sequence[str],
    shape: tuple[int, int],
    *,
    pictures: Sequence[int] | None = None,
    negatives: NDArray[np.floating] | None = None,
    energy: float = 0.9,
    most_frontal: float = MOST_FRONTAL,
    residual: Residual = "held_out",
) -> Gallery:
    """The gallery of patches (n, d), zero mean and unit variance, each of a person; persons in order of their names.

    `pictures` (n,) says which picture a patch was cut from: the first of each is the picture, all further ones are
    copies of it that were cut a little off. Without it each patch is a picture. `negatives` (m, d): patches cut off the
    mark (displaced, turned, scaled); without them they are made of the patches. `energy` is the share of the variance
    that a subspace keeps, `most_frontal` the upper bound of p_f. Raises InputError for fewer than two persons, and
    where no two patches are of one person.
    """
    x = np.asarray(patches, np.float64)
    if x.ndim != 2 or x.shape[1] != shape[0] * shape[1] or len(x) != len(persons):
        raise ValueError(f"patches of {x.shape}, {len(persons)} persons, {shape} points")
    for name in persons:
        if problem := name_problem(name):
            raise InputError(f"{problem}; rename it")
    names, who = np.unique(np.array(persons), return_inverse=True)
    if len(names) < 2:
        raise InputError(
            f"a gallery of {len(names)} person{'' if len(names) == 1 else 's'} cannot tell anybody apart: "
            "how faces of different people differ is learned from two persons or more; add another person"
        )
    picture = np.unique(np.arange(len(x)) if pictures is None else np.asarray(pictures), return_inverse=True)[1]
    original = np.zeros(len(x), bool)
    original[np.unique(picture, return_index=True)[1]] = True
    counts = tuple(int((original & (who == p)).sum()) for p in range(len(names)))
    faces = np.stack([_stand_in(x[original & (who == p)]) for p in range(len(names))])

    intra_x, intra_of = _to_own(x, who, picture, original, faces)
    if not len(intra_x):
        raise InputError(
            "there is one picture of each person: how one face changes with light, expression and pose cannot be "
            "learned from it; add a second picture of at least one person"
        )
    people = np.arange(len(names))
    extra_x = np.concatenate([x[who == p][:, None] - faces[people != p] for p in people]).reshape(-1, x.shape[1])
    extra_of = np.concatenate(
        [np.stack([np.full((int((who == p).sum()), len(names) - 1), p),
                   np.broadcast_to(people[people != p], (int((who == p).sum()), len(names) - 1))], -1) for p in people]
    ).reshape(-1, 2)  # fmt: skip

    folds = folds_by(who)
    of_fold = [np.unique(who[fold]) for fold in folds]
    frontal = fit_subspace(x, folds, energy=energy, residual=residual)
    own = folds_by(who[intra_of]) or folds_by(picture[intra_of])
    intra = fit_subspace(intra_x, own, energy=energy, centred=True, residual=residual)
    held = [np.isin(extra_of, some).any(1) for some in of_fold]
    held = [mask for mask in held if not mask.all()]
    extra = fit_subspace(extra_x, held, energy=energy, centred=True, residual=residual)

    wrong = _off_the_mark(x[original], shape) if negatives is None else np.asarray(negatives, np.float64)
    right_q = np.concatenate([part.log_density(x[fold]) for part, fold in zip(frontal.without, folds, strict=True)])
    wrong_q = np.mean([part.log_density(wrong) for part in frontal.without], axis=0)

    def log_ratio(difference: Array) -> Array:
        return intra.whole.log_density(difference) - extra.whole.log_density(difference)

    genuine = log_ratio(intra_x)
    best = log_ratio(extra_x).reshape(len(x), -1).max(1)
    threshold, errors = equal_errors(genuine, best)
    return Gallery(
        tuple(map(str, names)),
        faces.astype(np.float32),
        (int(shape[0]), int(shape[1])),
        frontal.whole,
        intra.whole,
        extra.whole,
        calibration=fit_logistic(right_q, wrong_q),
        most_frontal=most_frontal,
        threshold=threshold,
        errors=errors,
        counts=counts,
        notes=_notes(names.tolist(), counts),
    )


def _stand_in(pictures: Array) -> Array:
    """(d,): what stands for a person, the mean of the pictures (k, d), of unit variance again."""
    mean = pictures.mean(0)
    if len(pictures) == 1:
        return np.asarray(mean)
    spread = float(mean.std())
    return np.asarray((mean - mean.mean()) / spread if spread > 1e-6 else pictures[0])


def _to_own(
    x: Array, who: NDArray[np.intp], picture: NDArray[np.intp], original: NDArray[np.bool_], faces: Array
) -> tuple[Array, NDArray[np.intp]]:
    """Differences of patches to what stands for their person without the picture they are from, and whose they are.

    Where there is no other picture, those of its copies to the picture.
    """
    rows, index = [], []
    for k in np.unique(picture):
        mine = np.flatnonzero(picture == k)
        others = original & (who == who[mine[0]]) & (picture != k)
        if not others.any():
            mine = mine[~original[mine]]
        stands = _stand_in(x[others]) if others.any() else faces[who[picture == k][0]]
        rows.append(x[mine] - stands)
        index.append(mine)
    return np.concatenate(rows), np.concatenate(index)


def _off_the_mark(x: Array, shape: tuple[int, int]) -> Array:
    """Patches (n, d), each displaced, turned and scaled, as one picture of its own each time."""
    rows, cols = shape
    out = []
    for picture in x.astype(np.float32).reshape(-1, rows, cols):
        for dx, dy, angle, scale in (
            (0.2, 0, 0, 1), (-0.2, 0, 0, 1), (0, 0.2, 0, 1), (0, -0.2, 0, 1), (0, 0, 25, 1), (0, 0, -25, 1), (0, 0, 0, 0.7),
        ):  # fmt: skip
            m = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), angle, scale)
            m[:, 2] += dx * cols, dy * rows
            moved = cv2.warpAffine(picture, m, (cols, rows), borderMode=cv2.BORDER_REPLICATE)
            moved = moved - moved.mean()
            out.append((moved / max(float(moved.std()), 1e-6)).ravel())
    return np.array(out, np.float64)


def _notes(names: Sequence[str], counts: Sequence[int]) -> tuple[str, ...]:
    single = [name for name, count in zip(names, counts, strict=True) if count == 1]
    if not single:
        return ()
    said = f"{', '.join(single)}: one picture{' each' if len(single) > 1 else ''}: how "
    said += "their faces change" if len(single) > 1 else "this face changes"
    return (f"{said} with light, expression and pose cannot be learned from it; add further pictures",)
