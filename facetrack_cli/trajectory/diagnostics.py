"""What a tracker reports of a target beside its rows: scale, noise, posterior, ...

Likelihoods, state spaces and velocity predictions declare it in `diagnostics`, and give the values of each frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from facetrack_cli.core.geometry import corners
from facetrack_cli.core.types import Array, Whole

if TYPE_CHECKING:
    from facetrack_cli.trajectory.trajectory import Trajectory

SURE: Final = 0.9
"""The probability at which an identity counts as recognised (Zhou et al. 2003, figure 2c)."""
DOUBTFUL: Final = 0.5  # share of looks, and of rows that a calibrated confidence expects to be right: less is doubtful


@dataclass(frozen=True)
class Diagnostic:
    """A quantity that is reported of a target in every frame.

    `shape` () is a number, (n,) are n numbers, and None one number for each of some names. `decimals` are those in
    JSON, one for all or one for each number; `meaning` stands in plots. Raises ValueError for what cannot be.
    """

    name: str
    meaning: str = ""
    unit: str = ""
    shape: tuple[int, ...] | None = ()
    least: float = -math.inf
    most: float = math.inf
    decimals: int | tuple[int, ...] = 4

    def __post_init__(self) -> None:
        many = self.decimals if isinstance(self.decimals, tuple) else (self.decimals,)
        each = many is not self.decimals or self.shape == (len(many),)
        shaped = not self.shape or (len(self.shape) == 1 and self.shape[0] > 0)
        if not (self.name and shaped and each and min(many, default=-1) >= 0):
            raise ValueError(f"diagnostic {self.name!r} needs a name, and a shape of (), (n,) or None, and decimals")

    def record(self) -> dict[str, Any]:
        """What the header of a JSON trajectory says of it; JSON has no infinite bounds."""
        return {key: value for key, value in asdict(self).items() if value not in (-math.inf, math.inf)}


POSTERIOR: Final = Diagnostic("posterior", "probability of each identity", shape=None, least=0, most=1)
ENTROPY: Final = Diagnostic("entropy", "of the posterior", "nats", least=0)
SCALE: Final = Diagnostic("scale", "1 at the start", least=0)
ROLL: Final = Diagnostic("roll", "of a face in the plane of the image", "degrees", decimals=2)
NOISE: Final = Diagnostic("noise", "eta of eq. 13: noise of the motion, relative to its usual", least=0)
ERROR: Final = Diagnostic("error", "eps_t of eq. 13: error of the velocity prediction", least=0)
_AFFINE: Final = "deformation a1 to a4 since the start; centre in pixels"
# a1 to a4 to 5 decimals: of a box of 1,000 pixels that is a hundredth of one
AFFINE: Final = Diagnostic("affine", _AFFINE, shape=(6,), decimals=(5, 5, 5, 5, 3, 3))
NETWORK: Final = Diagnostic("network", "share of its points that the other senses bear out", least=0, most=1)
EVIDENCE: Final = Diagnostic("evidence", "log p(y_t | Y_{t-1}) of the frame, up to a constant of the recipe", "nats")
PRESENT: Final = Diagnostic("present", "probability that the hand is in the picture, blurred or not", least=0, most=1)
NAMED: Final = Diagnostic("named", "probability that the hand has its own name, and not the other's", least=0, most=1)
_KNOWN = (POSTERIOR, ENTROPY, SCALE, ROLL, NOISE, ERROR, NETWORK, EVIDENCE, AFFINE, PRESENT, NAMED)
KNOWN: Final[Mapping[str, Diagnostic]] = {one.name: one for one in _KNOWN}
"""Those of the shipped trackers, which docs/files.md describes."""


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """The diagnostics of one target over T frames, increasing: of each name an array (T,), (T, n) or (T, names).

    `labels` are the names that a value of shape None is for. What is not known is nan.
    """

    declared: tuple[Diagnostic, ...]
    frame: Whole
    values: Mapping[str, Array]
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def get(self, name: str) -> Array:
        """The values of a name, all of them nan where it is not reported."""
        return self.values[name] if name in self.values else np.full(len(self.frame), np.nan)

    def row(self, frame: int) -> int | None:
        """The index of a frame; None if it has none."""
        at = int(np.searchsorted(self.frame, frame))
        return at if at < len(self.frame) and self.frame[at] == frame else None

    def between(self, first: int, stop: int) -> Diagnostics:
        """Those of frames from `first` to before `stop`."""
        rows = slice(*np.searchsorted(self.frame, [first, stop]).tolist())
        return replace(self, frame=self.frame[rows], values={key: v[rows] for key, v in self.values.items()})

    @classmethod
    def of(cls, declared: Sequence[Diagnostic], frame: list[int], records: Sequence[Mapping[str, Any]]) -> Diagnostics:
        """From what each frame reports by name; ValueError(index of the frame, why) for what does not fit."""
        values: dict[str, Array] = {}
        labels: dict[str, tuple[str, ...]] = {}
        for kind in declared:
            readings = [each.get(kind.name) for each in records]
            if all(value is None for value in readings):
                continue
            if kind.shape is None:
                labels[kind.name] = tuple(dict.fromkeys(key for v in readings if isinstance(v, Mapping) for key in v))
            names = labels.get(kind.name, ())
            unknown = np.full(len(names) if kind.shape is None else kind.shape, math.nan)
            each = [unknown if v is None else _checked(kind, at, v, names) for at, v in enumerate(readings)]
            values[kind.name] = np.array(each, np.float64)
        return cls(tuple(declared), np.asarray(frame, np.int64), values, labels)

    @classmethod
    def joined(cls, parts: Sequence[Diagnostics]) -> Diagnostics:
        """Those of successive frames as one."""
        if len({(*piece.values, *piece.labels.items()) for piece in parts}) == 1:
            values = {key: np.concatenate([piece.values[key] for piece in parts]) for key in parts[0].values}
            return replace(parts[0], frame=np.concatenate([piece.frame for piece in parts]), values=values)
        # what is read from a file declares, in the tracker's order, only what is there
        longest = sorted(parts, key=lambda part: -len(part.declared))
        declared = {each.name: each for part in longest for each in part.declared}
        frames = [frame for piece in parts for frame in piece.frame.tolist()]
        return cls.of([*declared.values()], frames, [each for piece in parts for each in piece.records()])

    def records(self) -> list[dict[str, Any]]:
        """What is known in each frame, by name, as `of` takes it."""
        frames: list[dict[str, Any]] = [{} for _ in self.frame]
        for name, values in self.values.items():
            for record, value in zip(frames, values.tolist(), strict=True):
                record[name] = dict(zip(self.labels[name], value, strict=True)) if name in self.labels else value
        return frames


def outlines(rows: Trajectory) -> Array | None:
    """(R, 4, 2) corners that follow from the affine maps that targets report; nan, or None, where there is none."""
    outline = np.full((len(rows), 4, 2), np.nan)
    targets = np.array([target for target, _ in rows.names], dtype=np.str_)[rows.which]
    for target, reported in rows.diagnostics.items():
        if AFFINE.name in reported.values:
            at = np.flatnonzero((targets == target) & np.isin(rows.frame, reported.frame))
            affine = reported.values[AFFINE.name][np.searchsorted(reported.frame, rows.frame[at])]
            centre, size = np.stack([rows.x, rows.y], axis=1)[at], np.stack([rows.w, rows.h], axis=1)[at]
            outline[at] = corners(affine, centre, size)
    return outline if np.isfinite(outline).any() else None


def _checked(kind: Diagnostic, at: int, value: Any, labels: tuple[str, ...]) -> Any:
    """The numbers of a value, nan where there are none."""
    each: Iterable[Any] = (value,)
    fits, what = True, "a number"
    if kind.shape is None:
        fits, what = isinstance(value, Mapping) and "" not in value, "an object of names and numbers"
        each = value.values() if fits else ()
    elif kind.shape:
        fits = isinstance(value, Sequence | np.ndarray) and len(value) == kind.shape[0]
        each, what = value, f"a list of {kind.shape[0]} numbers"
    least, most = max(kind.least, -1e300), min(kind.most, 1e300)
    with suppress(OverflowError):  # an integer of hundreds of digits
        real = fits and all(isinstance(number, Real) and not isinstance(number, bool) for number in each)
        if real and all(number != number or least <= number <= most for number in map(float, each)):
            return np.float64(value) if kind.shape is not None else [float(value.get(key, math.nan)) for key in labels]
    raise ValueError(at, f"{kind.name} {value!r:.60} is not {what} from {kind.least:g} to {kind.most:g}")
