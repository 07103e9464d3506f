"""What a tracker that adapts told of its targets, as arrays: who it is, and how scale, noise and error went.

    table = read_trajectory(Path("out/trajectory.json"))
    face = table.told[0]
    face.names, face.posterior       # (P,) and (T, P)

Axes: T frames of one target, increasing; P names. A number that is not known is nan, a text "".
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array
from facetrack_cli.trajectory.writers import KEYS, NUMBERS

SURE = 0.9  # the level that the paper's figure 2(c) looks at


@dataclass(frozen=True, eq=False)
class ToldSeries:
    """What is told of one target over time: `posterior` (T, P) over `names`, `affine` (T, 6), all others (T,).

    `identity` is the most likely name, `entropy` in nats, `scale` 1 at the start, `noise` eta and `error` eps_t
    (Zhou et al. 2003, eq. 13), `affine` a1 to a4 and the centre in pixels. A CSV has `identity` and its probability.
    """

    target: str
    frame: NDArray[np.int64]
    identity: NDArray[np.str_]
    identity_prob: Array
    names: tuple[str, ...]
    posterior: Array
    entropy: Array
    scale: Array
    noise: Array
    error: Array
    affine: Array

    def beliefs(self) -> tuple[tuple[str, ...], Array]:
        """(P,) names and (T, P) their probabilities: the posterior, or where it was not kept that of the identity."""
        if self.names:
            return self.names, self.posterior
        names = tuple(dict.fromkeys(name for name in self.identity.tolist() if name))
        who = self.identity[:, None] == np.array(names, dtype=np.str_)[None]
        return names, np.where(who, self.identity_prob[:, None], np.nan)

    def passed(self, name: str, level: float = SURE) -> int | None:
        """The first frame in which `name` has a probability above `level`; None if there is none."""
        names, probabilities = self.beliefs()
        if name not in names:
            return None
        above = np.flatnonzero(probabilities[:, names.index(name)] > level)
        return int(self.frame[above[0]]) if above.size else None


def from_records(path: Path, frames: Sequence[Any]) -> tuple[ToldSeries, ...]:
    """What the frames of a JSON trajectory tell, targets in the order in which they come; () if nothing.

    Raises InputError, with frame and target, for what is not as facetrack writes it. Records that are no frames at all
    are left to `formats.table`, which says so.
    """
    found: dict[str, dict[int, Mapping[str, Any]]] = {}
    try:
        for record in frames:
            for target in record["targets"]:
                if target["parts"] and not _MEMBERS.isdisjoint(target):
                    name, frame = target["target"], record["frame"]
                    if not isinstance(name, str) or not isinstance(frame, int) or not 0 <= frame < 10**18:
                        return ()
                    found.setdefault(name, {}).setdefault(frame, target)
    except (KeyError, TypeError, AttributeError):
        return ()
    return tuple(_of_target(path, name, dict(sorted(told.items()))) for name, told in found.items())


_MEMBERS = KEYS | {"identity", "identity_prob"}


def _of_target(path: Path, target: str, told: Mapping[int, Mapping[str, Any]]) -> ToldSeries:
    frame = np.array(list(told), dtype=np.int64)

    def wrong(at: int, key: str, why: str) -> InputError:
        return InputError(f"{path}: frame {frame[at]}, {target}: {key} {why}; correct it, or leave it out")

    def column(key: str, most: float = math.inf) -> Array:
        values = np.full(len(frame), np.nan)
        for at, one in enumerate(told.values()):
            value = one.get(key)
            if value is not None:
                values[at] = number = _number(value)
                if not 0 <= number <= most or math.isinf(number):
                    raise wrong(at, key, f"{value!r} is no {'probability' if most == 1 else 'number from 0 up'}")
        return values

    identity = [one.get("identity") for one in told.values()]
    for at, name in enumerate(identity):
        if name is not None and not isinstance(name, str):
            raise wrong(at, "identity", f"{name!r} is no name")
    affine = np.full((len(frame), 6), np.nan)
    for at, one in enumerate(told.values()):
        value = one.get("affine")
        if value is not None:
            numbers = [_number(v) for v in value] if isinstance(value, list) else []
            if len(numbers) != 6 or not all(map(math.isfinite, numbers)):
                raise wrong(at, "affine", "is no list of six numbers, a1 to a4 and the centre")
            affine[at] = numbers
    names, posterior, why = _posterior([one.get("posterior") for one in told.values()])
    if why:
        raise wrong(len(posterior), "posterior", why)
    return ToldSeries(
        target=target,
        frame=frame,
        identity=np.array([name or "" for name in identity], dtype=np.str_),
        identity_prob=column("identity_prob", most=1.0),
        names=names,
        posterior=posterior,
        affine=affine,
        **{key: column(key) for key in NUMBERS},
    )


def _posterior(found: Sequence[Any]) -> tuple[tuple[str, ...], Array, str]:
    """Names in the order in which they come, and (T, P); or the good rows and what is wrong with the next."""
    places: dict[str, int] = {}
    for one in found:
        if isinstance(one, dict) and one.keys() != places.keys():
            for name in one:
                places.setdefault(name, len(places))
    values = np.full((len(found), len(places)), np.nan)
    for at, one in enumerate(found):
        if one is None:
            continue
        if not isinstance(one, dict):
            return (), values[:at], "is no object of names and their probabilities"
        for name, value in one.items():
            number = _number(value)
            if not 0 <= number <= 1 or not name:
                return (), values[:at], f"of {name!r} {value!r} is no probability"
            values[at, places[name]] = number
    return tuple(places), values, ""


def _number(value: Any) -> float:
    """The number that JSON has, or nan for what is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return math.inf


def from_columns(
    path: Path, targets: Iterable[str], frame: NDArray[np.int64], identity: NDArray[np.str_], prob: Array
) -> tuple[ToldSeries, ...]:
    """Who each target is, from rows (R,) in any order, of which those of one frame say the same; () if none says so.

    Raises InputError for a probability that is none.
    """
    if not (identity != "").any() and not np.isfinite(prob).any():
        return ()
    with np.errstate(invalid="ignore"):
        outside = np.flatnonzero((prob < 0) | (prob > 1))
    of = np.array(list(targets), dtype=np.str_)
    if outside.size:
        at = int(outside[0])
        raise InputError(
            f"{path}: frame {frame[at]}, {of[at]}: identity_prob {prob[at]:.15g} is no probability; "
            "correct it, or leave it empty"
        )
    found = []
    for target in dict.fromkeys(of.tolist()):
        rows = np.flatnonzero(of == target)
        frames, first = np.unique(frame[rows], return_index=True)
        who, sure = identity[rows][first], prob[rows][first]
        if not (who != "").any() and not np.isfinite(sure).any():
            continue
        blank = np.full(len(frames), np.nan)
        numbers = dict.fromkeys(NUMBERS, blank)
        few = np.empty((len(frames), 0))
        found.append(
            ToldSeries(target, frames, who, sure, (), few, affine=np.full((len(frames), 6), np.nan), **numbers)
        )
    return tuple(found)
