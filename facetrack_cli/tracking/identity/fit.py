"""A gallery learned from pictures: its three spaces, p_f and the threshold of "none of them" (see `gallery.py`).

Persons are held out in folds, and everything that is a scale, rho, p_f and the threshold, is learned from those whom
the spaces have not seen. Differences between persons, of which there are as many as patches times persons, are never
written out: sums tell their moments.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.tracking.identity.calibration import equal_errors, fit_logistic
from facetrack_cli.tracking.identity.gallery import MOST_FRONTAL, Gallery, name_problem
from facetrack_cli.tracking.identity.samples import Pictures, off_the_mark
from facetrack_cli.tracking.identity.subspaces import (
    Fitted,
    Residual,
    common_basis,
    fit_moments,
    fit_subspace,
    folds_by,
)

Mask: TypeAlias = NDArray[np.bool_]
MOST_ERRORS = 0.25  # beyond them the user is told; half is chance


def fit_gallery(
    patches: NDArray[np.floating[Any]],
    persons: Sequence[str],
    shape: tuple[int, int],
    *,
    pictures: Sequence[int] | None = None,
    negatives: NDArray[np.floating[Any]] | None = None,
    energy: float = 0.9,
    most_frontal: float = MOST_FRONTAL,
    residual: Residual = "held_out",
    proportion: float | None = None,
) -> Gallery:
    """The gallery of patches (n, d), zero mean and unit variance, each of a person; persons in order of their names.

    `pictures` (n,) says which picture a patch was cut from: the first of each is the picture, all further ones are
    copies of it that were cut a little off. Without it each patch is a picture. `negatives` (m, d): patches cut off the
    mark (displaced, turned, scaled); without them they are made of the patches. `energy` is the share of the variance
    that a subspace keeps, `most_frontal` the upper bound of p_f, `residual` how rho is found (`subspaces.py`),
    `proportion` the width of the faces' boxes over their height.
    Raises InputError for fewer than two persons, and where no two patches are of one person.
    """
    x = np.asarray(patches, np.float64)
    if x.ndim != 2 or x.shape[1] != shape[0] * shape[1] or len(x) != len(persons):
        raise ValueError(f"patches of {x.shape} of {len(persons)} persons, and a template of {shape}")
    for name in sorted(set(persons)):
        if problem := name_problem(name):
            raise InputError(f"{problem}; give the folder another name")
    names, who = np.unique(np.array(persons, str), return_inverse=True)
    if len(names) < 2:
        raise InputError(
            f"a gallery of {len(names)} person{'' if len(names) == 1 else 's'} tells nobody apart: how people differ "
            "is learned from two or more; add another person"
        )
    of = np.unique(np.arange(len(x)) if pictures is None else np.asarray(pictures), return_inverse=True)[1]
    shown = Pictures(x, who, of)
    own, own_of = shown.to_own()
    if not len(own):
        raise InputError(
            "there is one picture of each person, and how one face changes with light, expression and pose cannot be "
            "learned from it; add a second picture of somebody, or copies that are cut a little off"
        )

    # persons that are held out together; where that leaves nothing to learn from, pictures are
    folds = folds_by(who)
    fold = np.argmax(folds, axis=0)
    person_fold = np.array([fold[who == p][0] for p in range(len(names))])
    settings = _Settings(energy, residual, common_basis(x))
    frontal = fit_subspace(x, folds, energy=energy, residual=residual, basis=settings.basis)
    intra = _fit_own(own, [fold[own_of] == k for k in range(len(folds))], of[own_of], settings)
    extra = _fit_others(shown, folds, [person_fold == k for k in range(len(folds))], settings)

    wrong = off_the_mark(x[shown.first], shape) if negatives is None else np.asarray(negatives, np.float64)
    right_q = np.concatenate([space.log_density(x[mask]) for space, mask in zip(frontal.without, folds, strict=True)])
    wrong_q = np.mean([space.log_density(wrong) for space in frontal.without], axis=0)
    threshold, errors = equal_errors(*_genuine_and_strangers(intra, extra, shown, own, fold, own_of))
    counts = tuple(int((shown.first & (who == p)).sum()) for p in range(len(names)))
    return Gallery(
        tuple(map(str, names)), shown.faces.astype(np.float32), (int(shape[0]), int(shape[1])),
        frontal.whole, intra.whole, extra.whole, fit_logistic(right_q, wrong_q), threshold, errors, counts,
        most_frontal, _notes(names.tolist(), counts, errors), proportion,
    )  # fmt: skip


class _Settings(NamedTuple):
    energy: float
    residual: Residual
    basis: Array | None


def _fit_own(x: Array, folds: Sequence[Mask], of: NDArray[np.intp], settings: _Settings) -> Fitted:
    """The space of differences x by `folds` of persons; rho from pictures `of` (n,) held out where no person can be."""
    able = any(mask.any() and not mask.all() for mask in folds)
    energy, residual, basis = settings
    fitted = fit_subspace(
        x, folds if able else folds_by(of), energy=energy, centred=True, residual=residual, basis=basis
    )
    return fitted if able else Fitted(fitted.whole, (fitted.whole,) * len(folds))


def _fit_others(shown: Pictures, folds: Sequence[Mask], persons: Sequence[Mask], settings: _Settings) -> Fitted:
    """As `_fit_own`, of differences to others: of `folds` of patches (n,) and of `persons` (P,) neither is asked."""
    energy, residual, basis = settings
    others = shown.to_others(basis)
    everybody, anyone = np.ones(len(shown.x), bool), np.ones(len(persons[0]), bool)
    able = len(anyone) > 2  # without one of two nobody is left to differ from
    without = (
        [others.moments(~mask, ~those) for mask, those in zip(folds, persons, strict=True)]
        if able
        else [others.moments(~mask, anyone) for mask in folds_by(shown.of)]
    )
    fitted = fit_moments(
        others.moments(everybody, anyone), without, shown.x.shape[1],
        energy=energy, centred=True, residual=residual, basis=basis,
    )  # fmt: skip
    return fitted if able else Fitted(fitted.whole, (fitted.whole,) * len(folds))


def _genuine_and_strangers(
    intra: Fitted, extra: Fitted, shown: Pictures, own: Array, fold: NDArray[np.intp], own_of: NDArray[np.intp]
) -> tuple[Array, Array]:
    """Log ratios (eq. 16) by spaces that have not seen the person: of patches to their person (m,), and the largest to
    another one (n,).
    """
    genuine, best = np.empty(len(own)), np.empty(len(shown.x))
    faces = shown.faces
    for k, (within, between) in enumerate(zip(intra.without, extra.without, strict=True)):
        mine = fold[own_of] == k
        genuine[mine] = within.log_density(own[mine]) - between.log_density(own[mine])
        mine = fold == k
        x, who = shown.x[mine], shown.who[mine]
        ratios = within.log_densities(x, faces) - between.log_densities(x, faces)
        ratios[np.arange(len(x)), who] = -np.inf
        best[mine] = ratios.max(axis=1)
    return genuine, best


def _notes(names: Sequence[str], counts: Sequence[int], errors: float) -> tuple[str, ...]:
    """What cannot be learned, for the user."""
    found = []
    single = [name for name, count in zip(names, counts, strict=True) if count == 1]
    if single:
        each, their = (" each", "their faces change") if len(single) > 1 else ("", "this face changes")
        found.append(
            f"{', '.join(single)}: one picture{each}: how {their} with light, expression and pose cannot be learned "
            "from it; add further pictures"
        )
    if errors > MOST_ERRORS:
        found.append(
            f"by these pictures people are hardly told apart: {100 * errors:.0f} % of either error for somebody who is "
            "not among those learned from; look whether each is in one folder alone, and add people and pictures"
        )
    return tuple(found)
