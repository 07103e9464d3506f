"""The whole state of a run, kept in its folder now and then: the same run again goes on from there.

What it gives is byte for byte what a run that was never ended gives: rows, and the decoded frames of the video. So the
video is always encoded in pieces of `PIECE_FRAMES`, and a checkpoint falls between two of them. Trackers of OpenCV do
not give their state away, and with a lag rows wait in memory: those runs begin anew.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, OutputError
from facetrack_cli.core.files import check_plain
from facetrack_cli.core.npz import Arrays, Kind, Stored, flatten, restore
from facetrack_cli.run_folder.lease import sweep

FOLDER: Final = ".checkpoint"
KIND: Final = Kind("facetrack-checkpoint", 1, "checkpoint of a run", "facetrack run")
PIECE_FRAMES = 250  # of a piece of the video
EVERY_S, EVERY_FRAMES = 30.0, 1000  # between two checkpoints, whichever is less
STATE: Final = "state.npz"
Steps: TypeAlias = Sequence[Callable[[], None]]  # that bring files to the disk, before a checkpoint relies on them


class Checkpoints:
    """The checkpoints of the run into `out` that `key` tells from all others; a thread of their own writes them.

    `video`: whether the run writes a video.
    """

    def __init__(self, out: Path, key: str, *, video: bool) -> None:
        self.folder, self._key, self._video = out / FOLDER, key, video
        check_plain(self.folder, self.folder / STATE)
        self._worker = ThreadPoolExecutor(1, "checkpoint")
        self._ready: tuple[Arrays, Steps] | None = None
        self._last_s, self._last_frames = time.monotonic(), 0

    def find(self) -> Any:
        """The last state of this very run; None if none can be read."""

        def make(stored: Stored) -> Any:
            if stored.text("key") != self._key:
                return None
            self._last_frames = int(stored.file["frames"])
            return restore("run", stored.file)

        if (self.folder / STATE).is_file():
            sweep(self.folder)
            with contextlib.suppress(InputError):  # a file that is damaged
                return KIND.read(self.folder / STATE, make)
        return None

    def is_due(self, frames: int) -> bool:
        """Whether the run is to be marked after so many frames."""
        if self._video and frames % PIECE_FRAMES:
            return False
        return frames - self._last_frames >= EVERY_FRAMES or time.monotonic() - self._last_s >= EVERY_S

    def mark(self, frames: int, state: Any, steps: Steps) -> None:
        """Keep the `state` after so many frames, once there is one more, since after the last nothing is kept.

        The `steps` come before.
        """
        self._last_s, self._last_frames = time.monotonic(), frames
        self._ready = {"frames": np.array(frames), **flatten("run", state)}, steps

    def release(self) -> None:
        """Keep what is marked."""
        if self._ready is not None:
            self._worker.submit(self._keep, *self._ready)
            self._ready = None

    def _keep(self, arrays: Arrays, steps: Steps) -> None:
        # whoever writes what could not be finished says so; without a checkpoint the run goes on all the same
        with contextlib.suppress(OutputError, OSError):
            self.folder.mkdir(exist_ok=True)
            for step in steps:
                step()
            KIND.write(self.folder / STATE, {"key": np.array(self._key), **arrays})

    def end(self) -> None:
        """Wait until all is kept."""
        self._worker.shutdown()


def remove_checkpoints(out: Path) -> None:
    """Remove the checkpoints of a run that is done, or is begun anew."""
    shutil.rmtree(out / FOLDER, ignore_errors=True)
