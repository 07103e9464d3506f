"""What happened in a run: when each part was lost and found again, and which frames show it best.

Frames are source frames; a lost span runs from the frame in which a part was called lost up to, not including, the
frame in which it was tracked again, corrected by hand, or marked as absent.
"""

from __future__ import annotations

import math
from bisect import bisect
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.trajectory import Trajectory

Kind: TypeAlias = Literal["start", "corrected", "lost", "back", "worst", "end"]
"""Why a frame is shown, in the order in which the reasons of one frame stand."""
MOST_FRAMES: Final = 12
_OF_EPISODES: Final = 2 / 3  # of the frames beside start, worst and end, where there are too many events


class Clock:
    """Frames to seconds on the clip's clock: as the rows say, at the nominal rate where they say nothing."""

    def __init__(self, table: Trajectory, fps: float) -> None:
        self.frames: Whole = table.frames
        self._period = 1 / fps
        times = table.times
        self.times: Array = np.where(np.isfinite(times), times, self.frames * self._period)

    def at(self, frame: int) -> float:
        """Seconds from the clip's first frame to this one, which must be a frame of the run."""
        return float(self.times[np.searchsorted(self.frames, frame)])

    def after(self, frame: int) -> float:
        """When this frame ends: when the run's next one begins."""
        place = int(np.searchsorted(self.frames, frame)) + 1
        return float(self.times[place]) if place < len(self.times) else float(self.times[-1]) + self._period

    @property
    def duration(self) -> float:
        """Seconds from the run's first frame to the end of its last."""
        return self.after(int(self.frames[-1])) - float(self.times[0])


class Stretch(NamedTuple):
    """Frames `first` to `last`, both included."""

    first: int
    last: int


class LostSpan(NamedTuple):
    """One part lost once: from frame `first` to frame `last`; tracked again in `back`, None if never.

    `lowest` is its least confidence in the span, nan if there is none. `by_hand`: a correction ended it, by giving the
    part in `back`, or by marking it as absent.
    """

    name: str
    first: int
    last: int
    back: int | None
    frames: int
    seconds: float
    lowest: float
    by_hand: bool


class CorrectedFrame(NamedTuple):
    """A frame that was corrected by hand: the parts `given` in it, and those from then on `absent`."""

    frame: int
    given: tuple[str, ...]
    absent: tuple[str, ...]


@dataclass(frozen=True)
class PartHistory:
    """What happened to one part. `worst` is the frame of its lowest confidence; confidences are nan where unknown.

    `judged` is whether the tracker reports its status after the first frame, or would: it has a confidence.
    `absences` are the stretches in which it is absent, `frames_absent` their number of frames.
    """

    name: str
    rows: int
    spans: tuple[LostSpan, ...]
    mean: float
    lowest: float
    worst: int
    last_status: str
    judged: bool
    absences: tuple[Stretch, ...]
    frames_absent: int


class Event(NamedTuple):
    """Why a frame is shown, and what it is about: the spans that begin or end, or the correction."""

    kind: Kind
    spans: tuple[LostSpan, ...] = ()
    corrected: CorrectedFrame | None = None


class KeyFrame(NamedTuple):
    frame: int
    events: tuple[Event, ...]


@dataclass(frozen=True)
class RunHistory:
    """A whole run: its parts, the stretches in which any was lost, the frame of the lowest confidence."""

    parts: tuple[PartHistory, ...]
    episodes: tuple[Stretch, ...]
    frames_lost: int
    worst: int | None
    corrections: tuple[CorrectedFrame, ...]

    @property
    def spans(self) -> list[LostSpan]:
        """Of all parts, in the order in which they began."""
        return sorted((s for part in self.parts for s in part.spans), key=lambda s: (s.first, s.name))

    def ending(self, status: str) -> list[str]:
        """The parts that have this status in their last frame."""
        return [part.name for part in self.parts if part.last_status == status]

    @property
    def events(self) -> dict[tuple[int, Kind], Event]:
        """What happened after the start, by frame and kind: lost, tracked again, corrected by hand."""
        found: dict[tuple[int, Kind], Event] = {}
        for span in self.spans:
            ends: list[tuple[int | None, Kind]] = [(span.first, "lost"), (None if span.by_hand else span.back, "back")]
            for frame, kind in ends:
                if frame is not None:
                    before = found.get((frame, kind), Event(kind))
                    found[frame, kind] = Event(kind, (*before.spans, span))
        return found | {(one.frame, "corrected"): Event("corrected", corrected=one) for one in self.corrections}


def history_of(table: Trajectory, clock: Clock) -> RunHistory:
    """What happened, from the rows of a trajectory."""
    several = len(table.targets) > 1
    parts = [_part(one, one.name if several else one.part, clock) for one in table.parts]
    place = np.searchsorted(clock.frames, table.frame)
    any_lost = np.zeros(len(clock.frames), dtype=np.bool_)
    any_lost[place[table.status == "lost"]] = True
    sure = np.isfinite(table.confidence) & (table.status != "init")
    known = np.bincount(place[sure], minlength=len(clock.frames))
    total = np.bincount(place[sure], table.confidence[sure], len(clock.frames))
    mean = np.divide(total, known, out=np.full(len(total), np.inf), where=known > 0)
    return RunHistory(
        parts=tuple(parts),
        episodes=tuple(Stretch(int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost)),
        frames_lost=int(any_lost.sum()),
        worst=int(clock.frames[np.argmin(mean)]) if known.any() else None,
        corrections=_corrections(table, [part.name for part in parts]),
    )


def _corrections(table: Trajectory, names: Sequence[str]) -> tuple[CorrectedFrame, ...]:
    found: dict[int, tuple[list[str], list[str]]] = {}
    for one, name in zip(table.parts, names, strict=True):
        for at in np.flatnonzero(one.corrected).tolist():
            given, absent = found.setdefault(int(one.frame[at]), ([], []))
            (absent if one.status[at] == "absent" else given).append(name)
    return tuple(CorrectedFrame(frame, tuple(given), tuple(absent)) for frame, (given, absent) in sorted(found.items()))


def _part(one: Trajectory, name: str, clock: Clock) -> PartHistory:
    sure, frames, status = one.confidence, one.frame.tolist(), one.status
    lost = []
    for a, b in spans(status == "lost"):
        ends = b < len(frames)
        stop = clock.at(frames[b]) if ends else clock.after(frames[b - 1])
        back = frames[b] if ends and status[b] != "absent" else None
        seconds, by_hand = stop - clock.at(frames[a]), ends and bool(one.corrected[b])
        lost.append(LostSpan(name, frames[a], frames[b - 1], back, b - a, seconds, _least(sure[a:b]), by_hand))
    known = np.isfinite(sure)
    tracked = sure[(status != "init") & known]
    return PartHistory(
        name=name,
        rows=len(one),
        spans=tuple(lost),
        mean=float(tracked.mean()) if len(tracked) else math.nan,
        lowest=_least(sure),
        worst=frames[np.nanargmin(sure)] if known.any() else frames[0],
        last_status=str(status[-1]),
        judged=bool((status != "init").any() or known.any()),
        absences=tuple(Stretch(frames[a], frames[b - 1]) for a, b in spans(status == "absent")),
        frames_absent=int((status == "absent").sum()),
    )


def _least(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else math.nan


def key_frames(history: RunHistory, first: int, last: int, most: int = MOST_FRAMES) -> list[KeyFrame]:
    """The frames to show, at most `most`, in their order.

    Always the first, the last, and the one whose parts have the lowest confidence on average; and, if they are few
    enough, every frame in which a part was called lost, was tracked again or was corrected by hand. Otherwise, of the
    longest stretches in which any part was lost, the frames where they begin and end; then, one by one, the event
    furthest in time from all those taken.
    """
    found = history.events
    events = sorted({frame for frame, _ in found})
    fixed: list[tuple[int | None, Kind]] = [(first, "start"), (history.worst, "worst"), (last, "end")]
    found |= {(frame, kind): Event(kind) for frame, kind in fixed if frame is not None}
    taken = {frame for frame, _ in fixed if frame is not None}
    if len(taken.union(events)) <= most:
        taken.update(events)
    else:
        room = len(taken) + round((most - len(taken)) * _OF_EPISODES)
        for begin, end in sorted(history.episodes, key=lambda e: (e.first - e.last, e.first)):
            after = bisect(events, end)  # where the last part came back
            if len(both := taken | {begin, *events[after : after + 1]}) <= room:
                taken = both
        taken = _spread(taken, events, most)
    kinds: tuple[Kind, ...] = get_args(Kind)
    return [KeyFrame(at, tuple(found[at, kind] for kind in kinds if (at, kind) in found)) for at in sorted(taken)]


def _spread(taken: set[int], events: Sequence[int], most: int) -> set[int]:
    """Those taken, and the events furthest from them and from each other."""
    frames = np.array(events, dtype=np.int64)
    away = np.min(np.abs(frames[:, None] - np.array(sorted(taken))), axis=1)
    while len(taken) < most and away.max() > 0:
        pick = int(np.argmax(away))
        taken.add(int(frames[pick]))
        away = np.minimum(away, np.abs(frames - frames[pick]))
    return taken
