"""Parts of a table: some of its targets, lost rows blanked, one box around a target's parts; the times of its frames.

At a variable rate a frame's number does not tell when the frame is shown; the rows of the run do.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.core.types import BOX, Array, Whole
from facetrack_cli.trajectory.trajectory import MAX_ROWS, UNSEEN, Trajectory, aligned, header_value, joined, one_part

Around: TypeAlias = Literal["windows", "points"]
FRAME_S = 0.04  # how long a single frame lasts where nothing tells


def choose(table: Trajectory, select: str | None) -> Trajectory:
    """One target alone (`face`), or one part of it (`face/nose`); all for None. UsageError, with the names."""
    if select is None:
        return table
    parts = [part for part in table.parts if select in (part.target, part.name)]
    if not parts:
        names = [name for name in table.targets if name] + [part.name for part in table.parts]
        raise UsageError(f"{table.path}: has no {select!r}; choose among {', '.join(names)}")
    diagnostics = {name: part for name, part in table.diagnostics.items() if name == parts[0].target}
    return joined(parts, header=table.header, diagnostics=diagnostics, path=table.path)


def enclose(parts: Sequence[Trajectory], around: Around = "windows") -> Trajectory:
    """One box for each row of a target, as the series of a part `box`: the smallest upright box around its parts.

    A target of one part has that part's own box. Of several, `windows` encloses the windows that the tracker compares,
    `points` their centres alone, each as one pixel. Parts whose place is not known in a row are left out of it, and so
    are parts without windows where others have some; lost ones count, since their place is the estimate. `confidence`
    is the mean over the parts, `status` lost when all are that are not absent. InputError for windows without a size.
    """
    target = parts[0].target
    if len(parts) == 1:
        return parts[0].renamed(target, BOX)
    if around == "points":
        parts = [replace(p, w=np.ones(len(p)), h=np.ones(len(p))) for p in parts if p.part != BOX]
    parts = list(filter(has_windows, parts)) or parts
    for part in parts:
        check_sized(part, "enclose the points with --box points")
    frame, columns = aligned(parts, "x", "y", "w", "h", "confidence", "status", "by_hand")
    x, y, w, h, confidence, status, by_hand = columns.values()
    left, top = x - (w - 1) / 2, y - (h - 1) / 2
    edges = np.where(np.isfinite(left + top + w + h), [left, top, left + w, top + h], np.nan)
    left, top = np.fmin.reduce(edges[:2], axis=2)
    w, h = np.fmax.reduce(edges[2:], axis=2) - (left, top)
    place = {"x": left + (w - 1) / 2, "y": top + (h - 1) / 2, "w": w, "h": h, "confidence": mean(confidence)}
    together = []
    for row in status.tolist():  # what the parts agree on that are not absent, else that their target is there
        states = set(filter(None, row))
        of_tracker = bool(states & {"tracked", "init", "lost"})
        states -= {"absent"} if of_tracker else set()
        states = {"hidden"} if states == {*UNSEEN} else states
        together.append(states.pop() if len(states) == 1 else "tracked" if of_tracker else "visible" if states else "")
    about = {"status": together, "by_hand": by_hand.any(axis=1), "time_s": joined(parts).times}
    return one_part(target, BOX, frame, **place, **about)


def check_sized(part: Trajectory, remedy: str) -> None:
    """InputError for a place without a size."""
    if (sizeless := part.frame[np.isfinite(part.x) & ~np.isfinite(part.w + part.h)]).size:
        raise InputError(f"{part.name}: frame {sizeless[0]} has no w and h; {remedy}")


def has_windows(part: Trajectory) -> bool:
    """Whether it has a width and a height: no window follows the eyes of a face."""
    return bool(np.isfinite(part.w + part.h).any())


def mean(values: Array) -> Array:
    """The mean over the last axis of what is known; nan where nothing is."""
    return np.asarray(np.ma.masked_invalid(values).mean(axis=-1).filled(np.nan))


class Clock:
    """The clip's clock: times as in the rows, between in proportion, beyond or without at the nominal rate `fps`."""

    def __init__(self, table: Trajectory | None, fps: float) -> None:
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
    frames, timed = np.arange(last + 1), np.isfinite(table.times)
    at, time_s = table.frames[timed], table.times[timed]
    fps = header_value(table, "source", "fps")
    periods = [1 / fps] if isinstance(fps, int | float) and fps > 0 else []
    steps = np.diff(time_s) / np.diff(at)
    step = float(np.median(steps)) if steps.size else 0.0
    if step > 0 and (line := float(np.polyfit(at, time_s, 1)[0])) > 0:
        usual = [n / round(n / line) for n in (1, 1.001) if round(n / line)]  # 24, 25, 30, 30 / 1.001, ...
        periods += [*usual, line]
    # containers may keep whole milliseconds, our rows four decimals
    rounded = 1.1e-3 if table.header.get("variable_fps") is False else 1.1e-4
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
    for at in np.flatnonzero(np.diff(time_s) <= 0)[:1] + 1:
        raise InputError(f"frame {frames[at]} is at {time_s[at]:g} s, not after frame {frames[at - 1]}; correct time_s")
    steps = np.diff(time_s) / np.diff(frames)
    usual = float(np.median(steps)) if steps.size else FRAME_S
    after = np.append(time_s[1:], time_s[-1] + usual)
    after = np.where(np.append(np.diff(frames) > 1, False), np.minimum(after, time_s + usual), after)
    milliseconds = [np.rint(np.maximum(t, 0) * 1000).astype(np.int64).tolist() for t in (time_s, after)]
    return [dict(zip(frames.tolist(), times, strict=True)) for times in milliseconds]
