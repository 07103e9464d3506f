"""Seconds of frames, by the rows of a run: at a variable rate a frame's number does not tell its time."""

from __future__ import annotations

import numpy as np

from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory


class Clock:
    """The clip's clock: times as in the rows, between them in proportion, beyond them at the nominal rate `fps`."""

    def __init__(self, table: Trajectory | None, fps: float) -> None:
        """Without a table, all times are at the nominal rate."""
        self.fps, self._period = fps, 1 / fps
        self.frames: Whole = np.zeros(1, np.int64) if table is None or not len(table) else table.frames
        times = np.zeros(1) if table is None or not len(table) else table.times
        times = np.where(np.isfinite(times), times, self.frames * self._period)
        self.times: Array = np.maximum.accumulate(times)  # also of a file that tells nonsense

    def at(self, frame: int) -> float:
        """When a frame is shown."""
        beyond = frame - min(max(frame, int(self.frames[0])), int(self.frames[-1]))
        return float(np.interp(frame, self.frames, self.times)) + beyond * self._period

    def after(self, frame: int) -> float:
        """When a frame ends and the next one begins."""
        return self.at(frame + 1)

    def frame(self, seconds: float) -> int:
        """The frame that is shown nearest to a time."""
        beyond = seconds - min(max(seconds, float(self.times[0])), float(self.times[-1]))
        return round(float(np.interp(seconds, self.times, self.frames)) + beyond * self.fps)

    @property
    def duration(self) -> float:
        """Seconds from the run's first frame to the end of its last."""
        return self.after(int(self.frames[-1])) - float(self.times[0])

    def points(self, most: int = 500) -> list[tuple[int, float]]:
        """Some frames with their times, between which others lie about in proportion."""
        at = np.unique(np.linspace(0, len(self.frames) - 1, most).round().astype(np.int64))
        return list(zip(self.frames[at].tolist(), self.times[at].round(4).tolist(), strict=True))
