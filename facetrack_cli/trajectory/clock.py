"""When frames are shown, by the rows of a run: at a variable rate a frame's number does not tell its time."""

from __future__ import annotations

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import DECIMALS, MAX_ROWS, Trajectory, header_value

FRAME_S = 0.04  # how long a single frame lasts where nothing tells


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

    def frame(self, seconds: float) -> int:
        """The frame that is shown nearest to a time."""
        beyond = seconds - min(max(seconds, float(self.times[0])), float(self.times[-1]))
        return round(float(np.interp(seconds, self.times, self.frames)) + beyond * self.fps)

    @property
    def duration(self) -> float:
        """Seconds from the run's first frame to the end of its last."""
        return self.at(int(self.frames[-1]) + 1) - float(self.times[0])

    def points(self, most: int = 500) -> list[tuple[int, float]]:
        """Some frames with their times, between which others lie about in proportion."""
        at = np.unique(np.linspace(0, len(self.frames) - 1, most).round().astype(np.int64))
        return list(zip(self.frames[at].tolist(), self.times[at].round(4).tolist(), strict=True))


def every_frame(table: Trajectory) -> tuple[Whole, Array]:
    """The frames from 0 to the table's last one, (T,), and when each is shown, in seconds; nan if no row says when.

    Files round times, and readers ask for a constant rate: times of one are computed anew from it. Otherwise frames
    without a row lie evenly between their neighbours. InputError for a table of more than MAX_ROWS frames.
    """
    if (last := int(table.frames[-1])) >= MAX_ROWS:
        raise InputError(f"frame {last} is too far on for a row a frame; correct the column frame")
    frames, known = np.arange(last + 1), np.isfinite(table.times)
    at, time_s = table.frames[known], table.times[known]
    fps = header_value(table, "source", "fps")
    periods = [1 / fps] if isinstance(fps, int | float) and fps > 0 else []
    steps = np.diff(time_s) / np.diff(at)
    step = float(np.median(steps)) if steps.size else 0.0
    if step > 0 and (line := float(np.polyfit(at, time_s, 1)[0])) > 0:
        usual = [n / round(n / line) for n in (1, 1.001) if round(n / line)]  # 24, 25, 30, 30 / 1.001, ...
        periods += [*usual, line]
    # containers may keep whole milliseconds
    rounded = 1.1e-3 if table.header.get("variable_fps") is False else 1.1 * 10.0 ** -DECIMALS["time_s"]
    for period in periods if len(at) else ():
        begins = time_s - at * period
        if np.ptp(begins) <= rounded:
            begin = (begins.min() + begins.max()) / 2
            return frames, frames * period + (begin if abs(begin) > rounded else 0.0)
    times = np.interp(frames, at, time_s) if len(at) else np.full(len(frames), np.nan)
    if step > 0:
        times += step * (np.minimum(frames - at[0], 0) + np.maximum(frames - at[-1], 0))
    return frames, times


def frame_milliseconds(table: Trajectory) -> list[dict[int, int]]:
    """When each frame begins and when the next one does, in milliseconds, by frame."""
    frames, time_s = table.frames, table.times
    if (unknown := frames[~np.isfinite(time_s)]).size:
        raise InputError(f"frame {unknown[0]} has no time_s, and annotations need times; fill that column")
    if (back := np.flatnonzero(np.diff(time_s) <= 0)).size:
        (earlier, later), (first, second) = frames[back[0] :][:2], time_s[back[0] :][:2]
        raise InputError(f"frame {later} is at {second:g} s, not after frame {earlier} at {first:g} s; correct time_s")
    steps = np.diff(time_s) / np.diff(frames)
    usual = float(np.median(steps)) if steps.size else FRAME_S
    after = np.append(time_s[1:], time_s[-1] + usual)
    after = np.where(np.append(np.diff(frames) > 1, False), np.minimum(after, time_s + usual), after)
    milliseconds = [np.rint(np.maximum(t, 0) * 1000).astype(np.int64).tolist() for t in (time_s, after)]
    return [dict(zip(frames.tolist(), times, strict=True)) for times in milliseconds]
