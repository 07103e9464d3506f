"""The whole state of a run, kept in its folder now and then: the same run again goes on from there.

What it gives is byte for byte what a run that was never ended gives: rows, and the decoded frames of the video. So the
video is always encoded in pieces of `PIECE` frames, and a checkpoint falls between two of them. Trackers of OpenCV do
not give their state away, and with a lag rows wait in memory: those runs begin anew.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import Place
from facetrack_cli.core.npz import Kind, Stored
from facetrack_cli.core.sets import sweep
from facetrack_cli.core.snapshot import Arrays, flatten, restore
from facetrack_cli.runs.posterior import WriterState
from facetrack_cli.runs.verdict import Watch
from facetrack_cli.tracking import loop
from facetrack_cli.trajectory.writers import Format
from facetrack_cli.video.writer import Cut

FOLDER: Final = ".checkpoint"
KIND: Final = Kind("facetrack-checkpoint", 1, "checkpoint of a run", "facetrack run")
PIECE: Final = 250  # frames of a piece of the video
EVERY_S, EVERY_FRAMES = 30.0, 1000  # between two checkpoints, whichever is less
_FILE: Final = "state.npz"
_Part: TypeAlias = tuple[str, Arrays]


class Run(NamedTuple):
    """Where a run stands once the frame before `frame` is tracked.

    `tables` are the places reached in them by their formats, `posterior` that in posterior.npz.
    """

    frame: int
    frames: int
    lost: dict[str, int]
    evidence: dict[str, float]
    notes: tuple[str, ...]
    at: loop.TrackState
    tables: Mapping[Format, Place]
    posterior: WriterState | None
    watch: Watch | None


class Painted(NamedTuple):
    """Where its video stands: its pieces, and what the overlay remembers."""

    cut: Cut
    overlay: Any


@dataclass(frozen=True)
class Found:
    """A checkpoint to go on from; `painted` is None of a run without a video."""

    run: Run
    painted: Painted | None


class Checkpoints:
    """Those of the run into `out` that `key` tells from all others; kept in a thread of their own.

    `video`: whether it writes a video.
    """

    def __init__(self, out: Path, key: str, *, video: bool) -> None:
        self.folder, self._key, self._video = out / FOLDER, key, video
        self._worker = ThreadPoolExecutor(1, "checkpoint")
        self._marked: dict[int, tuple[_Part, Callable[[], None]]] = {}
        self._ready: list[tuple[Mapping[str, _Part], Callable[[], None]]] = []
        self._last, self._frames = time.monotonic(), 0

    def find(self) -> Found | None:
        """The last one of this very run; None if there is none that can be read."""
        path = self.folder / _FILE

        def make(stored: Stored) -> Found | None:
            if stored.text("key") != self._key:
                return None
            run = _read(stored, "run")
            painted = _read(stored, "painted") if "painted" in stored else None
            if not isinstance(run, Run) or not isinstance(painted, Painted | None):
                raise ValueError("is of something else")
            return Found(run, painted) if (painted is not None) == self._video else None

        if not self.folder.is_dir():
            return None
        sweep(self.folder)
        with contextlib.suppress(InputError):  # one that is damaged
            if path.is_file() and (found := KIND.read(path, make)) is not None:
                self._frames = found.run.frames
                return found
        return None

    def kept(self, name: str) -> Path:
        """A file of that name beside the checkpoint, whose folder is made. OSError."""
        self.folder.mkdir(exist_ok=True)
        return self.folder / name

    def due(self, frames: int) -> bool:
        """Whether the run is to be marked after so many frames."""
        if self._video and frames % PIECE:
            return False
        return frames - self._frames >= EVERY_FRAMES or time.monotonic() - self._last >= EVERY_S

    def mark(self, run: Run, sync: Callable[[], None]) -> None:
        """Keep where the run stands: at once, or, with a video, when that has come as far. `sync` ends its tables."""
        self._last, self._frames = time.monotonic(), run.frames
        part = flatten(run)
        if self._video:
            self._marked[run.frames] = part, sync
        else:
            self._ready.append(({"run": part}, sync))

    def painted(self, video: Callable[[], tuple[Cut, Callable[[], None]]], frames: int, overlay: Any) -> None:
        """After so many frames of video: cut it, and keep where it stands if the run is marked there."""
        cut, finish = video()
        self._worker.submit(self._keep, {}, finish)
        if frames in self._marked:
            run, sync = self._marked.pop(frames)
            self._ready.append(({"run": run, "painted": flatten(Painted(cut, overlay))}, sync))

    def release(self, *, video: bool = False) -> None:
        """Keep what is marked, now that there is one more frame (`video`: painted): after the last one nothing is."""
        if self._ready and video == self._video:
            self._worker.submit(self._keep, *self._ready.pop())

    def _keep(self, parts: Mapping[str, _Part], finish: Callable[[], None]) -> None:
        # whoever writes what could not be finished says so; without a checkpoint the run goes on all the same
        with contextlib.suppress(OutputError, OSError):
            self.folder.mkdir(exist_ok=True)
            finish()
            if parts:
                arrays: Arrays = {"key": np.array(self._key)}
                for name, (text, those) in parts.items():
                    arrays |= {name: np.array(text), **{f"{name}/{key}": one for key, one in those.items()}}
                KIND.write(self.folder / _FILE, arrays)

    def end(self) -> None:
        """Wait until all is kept."""
        self._worker.shutdown()


def forget(out: Path) -> None:
    """Remove the checkpoints of a run that is done, or is begun anew."""
    shutil.rmtree(out / FOLDER, ignore_errors=True)


def _read(stored: Stored, name: str) -> Any:
    prefix = f"{name}/"
    names = [key for key in stored.file.files if key.startswith(prefix)]
    return restore(stored.text(name), {key.removeprefix(prefix): stored.file[key] for key in names})
