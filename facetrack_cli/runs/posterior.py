"""What a run's filters knew in every frame, kept in its folder for the smoother: `posterior.npz`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.files import discard, publish, writing
from facetrack_cli.core.npz import Kind, Stored, write_arrays
from facetrack_cli.core.numbers import dumps
from facetrack_cli.engine.protocols import Linear
from facetrack_cli.engine.smoothing import Belief
from facetrack_cli.recipe.model import Recipe
from facetrack_cli.run_folder.manifest import check_belongs
from facetrack_cli.trackers.skin.settings import Cloud
from facetrack_cli.trackers.smoothed import Beliefs
from facetrack_cli.trajectory.trajectory import FrameResult, Trajectory

KIND: Final = Kind("facetrack-posterior", 1, "posterior of a run", "facetrack run --smooth")
_BLOCK_FRAMES: Final = 500  # that are written together
_NAMES: Final = ("mean", "cov", "matrix", "offset", "noise", "doubt")


def check_smoothing(recipe: Recipe) -> None:
    """UsageError for a recipe whose trackers have no posterior to smooth."""
    if not recipe.filters:
        raise UsageError(f"{recipe.name} is one of OpenCV's trackers, which have no posterior to smooth; take another")
    if all(isinstance(one.target, Cloud) for one in recipe.filters.values()):
        raise UsageError(f"{recipe.name}: the particles of a cloud are the target itself, no posterior to smooth")


class WriterState(NamedTuple):
    """Where a posterior that is written stands: frames still to be written, their number, the blocks on the disk."""

    kept: list[list[tuple[int, tuple[Belief, ...]]]]
    frames: int
    blocks: int


class PosteriorWriter:
    """Writes the beliefs of every frame, in blocks into `folder`, at the end into the temporary file of `path`.

    They take less than 1 kB a frame and part. Raises OutputError.
    """

    def __init__(
        self, path: Path, folder: Path, targets: Sequence[str], corrections: Any, after: WriterState | None = None
    ) -> None:
        """Of these `targets`; `corrections` as the trajectory's header has them. It goes on `after` a state."""
        self.path, self._folder = path, folder
        self._head = {"targets": np.array(targets), "corrections": np.array(dumps(corrections))}
        self.state = after or WriterState([[] for _ in targets], 0, 0)

    def add(self, result: FrameResult) -> None:
        for kept, target in zip(self.state.kept, result.targets, strict=True):
            if target.beliefs is not None and (found := target.beliefs()):
                kept.append((result.frame.index, found))
        self.state = self.state._replace(frames=self.state.frames + 1)
        if self.state.frames == _BLOCK_FRAMES:
            self._flush()

    def _flush(self) -> None:
        arrays: dict[str, Any] = {}
        number = self.state.blocks
        for i, kept in enumerate(self.state.kept):
            arrays[f"{number}/{i}/frame"] = np.array([frame for frame, _ in kept], "<i8")
            for j, those in enumerate(zip(*(found for _, found in kept), strict=True)):
                flat = [(one.mean, one.cov, *one.motion, one.doubt) for one in those]
                for name, values in zip(_NAMES, zip(*flat, strict=True), strict=True):
                    arrays[f"{number}/{i}/{j}/{name}"] = np.stack(values).astype("<f8")
                if named := [one.named for one in those if one.named is not None]:
                    arrays[f"{number}/{i}/{j}/named"] = np.stack(named).astype("<f8")
            kept.clear()
        block = _block_file(self._folder, number)
        with writing(self.path):
            block.parent.mkdir(exist_ok=True)
            write_arrays(block, arrays)
            publish(block)
        self.state = WriterState(self.state.kept, 0, number + 1)

    def close(self) -> None:
        if self.state.frames:
            self._flush()
        blocks = [_block_file(self._folder, number) for number in range(self.state.blocks)]
        write_arrays(self.path, {**KIND.head, **self._head}, blocks)

    def discard(self) -> None:
        discard(self.path)


def has_blocks(folder: Path, state: WriterState) -> bool:
    """Whether the blocks that a writer wrote up to a state are there."""
    return all(_block_file(folder, number).is_file() for number in range(state.blocks))


def _block_file(folder: Path, number: int) -> Path:
    return folder / f"posterior-{number:05}.npz"


def read_posterior(path: Path, rows: Trajectory) -> dict[str, Beliefs]:
    """The beliefs of each target in every frame of its run's `rows`. InputError for a file that is not theirs."""

    def make(stored: Stored) -> dict[str, Beliefs]:
        targets = stored.texts("targets")
        if targets != rows.targets:
            raise ValueError(f"is of {', '.join(targets)}, and the run follows {', '.join(rows.targets)}")
        found: dict[str, dict[int, tuple[Belief, ...]]] = {name: {} for name in targets}
        block = 0
        while f"{block}/0/frame" in stored:
            for i, name in enumerate(targets):
                found[name] |= _block(stored, f"{block}/{i}")
            block += 1
        corrections = stored.text("corrections")
        if corrections != dumps(rows.header["init"].get("corrections", [])):
            again = "run again with --init and --smooth"
            raise InputError(f"{path}: was kept before the run was corrected; {again}")
        frames = rows.frames.tolist()
        if any(set(known) - set(frames) for known in found.values()) or not any(found.values()):
            raise ValueError("has other frames than the run")
        for name, known in found.items():
            parts = len(rows.of_target(name))
            if any(sum(len(one.mean) for one in those) != parts for those in known.values()):
                raise ValueError(f"has not the {parts} parts of {name}")
            placed = [one.frame[np.isfinite(one.x)] for one in rows.of_target(name)]
            if known and not set(np.concatenate(placed).tolist()) <= set(known):
                raise ValueError(f"lacks frames of {name}")
        return {name: [known.get(frame, ()) for frame in frames] for name, known in found.items()}

    check_belongs(path)
    return KIND.read(path, make)


def _block(stored: Stored, above: str) -> Mapping[int, tuple[Belief, ...]]:
    frames = stored.whole(f"{above}/frame")
    groups: list[list[Belief]] = []
    while f"{above}/{len(groups)}/mean" in stored:
        mean, cov, matrix, offset, noise, doubt = (
            stored.reals(f"{above}/{len(groups)}/{name}", 2 + n)
            for name, n in zip(_NAMES, (1, 2, 2, 1, 2, 0), strict=True)
        )
        (frame_count, k, d), every = mean.shape, (cov, matrix, noise)
        if any(one.shape != (frame_count, k, d, d) for one in every) or offset.shape != mean.shape:
            raise ValueError(f"{above}: the arrays do not go together")
        if not all(np.isfinite(one).all() for one in (mean, offset, *every)) or doubt.shape != (frame_count, k):
            raise ValueError(f"{above}: has numbers that are none")
        key = f"{above}/{len(groups)}/named"
        named = stored.reals(key, 2) if key in stored else [None] * frame_count
        each = zip(mean, cov, map(Linear, matrix, offset, noise), doubt > 0, named, strict=True)
        groups.append([Belief(*one) for one in each])
    return dict(zip(frames, zip(*groups, strict=True), strict=True)) if groups else {}
