"""What happened in a run: when each part was lost and found again, and which frames show it best.

Frames are source frames; a lost span runs from the frame in which a part was called lost up to, not including, the
frame in which it was tracked again, put right by hand, or said to be absent.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias

import numpy as np

from facetrack_cli.core.spans import spans
from facetrack_cli.core.types import Array, Whole
from facetrack_cli.trajectory.table import Series, Table

Kind: TypeAlias = Literal["start", "corrected", "lost", "back", "worst", "end"]


MOST_PICTURES: Final = 12


_HAPPENED: Final[tuple[Kind, ...]] = ("corrected", "lost", "back")


_OF_EPISODES: Final = 2 / 3  # of the pictures beside start, worst and end, where there are too many events


class Clock:
    """Frames to seconds on the clip's clock: as the rows say, at the nominal rate where they say nothing."""

    def __init__(self, table: Table, fps: float) -> None:
        self.frames: Whole = table.frames
        self._period = 1 / fps
        told = np.full(len(self.frames), np.nan)
        for series in table.series:
            told[np.searchsorted(self.frames, series.frame)] = series.time_s
        self.times: Array = np.where(np.isfinite(told), told, self.frames * self._period)

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


class LostSpan(NamedTuple):
    """One part lost once: from frame `first` to frame `last`; tracked again in `back`, None if never.

    `lowest` is its least confidence in the span, nan if there is none. `by_hand`: a correction ended it, by giving the
    part in `back`, or by saying that it is absent.
    """

    name: str
    first: int
    last: int
    back: int | None
    frames: int
    seconds: float
    lowest: float
    by_hand: bool = False


class Corrected(NamedTuple):
    """A frame in which parts were put right by hand: those `given`, and those from then on `absent`."""

    frame: int
    given: tuple[str, ...]
    absent: tuple[str, ...]


@dataclass(frozen=True)
class PartStory:
    """How one part fared. `worst` is the frame of its lowest confidence; confidences are nan where there are none.

    `told` is whether the tracker says anything of its status after the first frame, or would: it has a confidence.
    `absences` are the stretches (first, last) in which it is not to be seen, `frames_absent` how many frames that is.
    """

    name: str
    rows: int
    spans: tuple[LostSpan, ...]
    mean: float
    lowest: float
    worst: int
    last_status: str
    told: bool
    absences: tuple[tuple[int, int], ...] = ()
    frames_absent: int = 0

    @property
    def frames_lost(self) -> int:
        return sum(span.frames for span in self.spans)

    @property
    def seconds_lost(self) -> float:
        return sum(span.seconds for span in self.spans)

    @property
    def longest(self) -> float:
        return max((span.seconds for span in self.spans), default=0.0)


class Event(NamedTuple):
    """Why a frame is worth a picture, and the parts that it is about: their spans for lost and back."""

    kind: Kind
    spans: tuple[LostSpan, ...] = ()
    corrected: Corrected | None = None


class KeyFrame(NamedTuple):
    frame: int
    events: tuple[Event, ...]


@dataclass(frozen=True)
class Story:
    """A whole run: its parts, the frames in which any was lost as stretches (first, last), and the worst frame."""

    parts: tuple[PartStory, ...]
    episodes: tuple[tuple[int, int], ...]
    frames_lost: int
    worst: int | None
    corrections: tuple[Corrected, ...] = ()

    @property
    def spans(self) -> list[LostSpan]:
        """Of all parts, in the order in which they began."""
        return sorted((s for part in self.parts for s in part.spans), key=lambda s: (s.first, s.name))

    @property
    def lost_at_end(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts if part.last_status == "lost")

    @property
    def absent_at_end(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts if part.last_status == "absent")

    @property
    def events(self) -> dict[tuple[int, Kind], Event]:
        """What happened after the start, by frame and kind: lost, tracked again, put right by hand."""
        found: dict[tuple[int, Kind], list[LostSpan]] = {}
        for span in self.spans:
            found.setdefault((span.first, "lost"), []).append(span)
            if span.back is not None and not span.by_hand:
                found.setdefault((span.back, "back"), []).append(span)
        events = {(frame, kind): Event(kind, tuple(spans)) for (frame, kind), spans in found.items()}
        return events | {(one.frame, "corrected"): Event("corrected", corrected=one) for one in self.corrections}


def tell(table: Table, clock: Clock) -> Story:
    """Read the run off its rows."""
    several = len(table.targets) > 1
    parts = tuple(_part(s, s.name if several else s.part, clock) for s in table.series)
    any_lost = np.zeros(len(clock.frames), dtype=np.bool_)
    total, known = np.zeros(len(clock.frames)), np.zeros(len(clock.frames))
    for series in table.series:
        place = np.searchsorted(clock.frames, series.frame)
        any_lost[place] |= series.status == "lost"
        sure = np.isfinite(series.confidence) & (series.status != "init")
        total[place] += np.where(sure, series.confidence, 0.0)
        known[place] += sure
    mean = np.divide(total, known, out=np.full(len(total), np.inf), where=known > 0)
    episodes = tuple((int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost))
    worst = int(clock.frames[np.argmin(mean)]) if (known > 0).any() else None
    names = [part.name for part in parts]
    return Story(parts, episodes, int(any_lost.sum()), worst, _corrections(table, names))


def _corrections(table: Table, names: Sequence[str]) -> tuple[Corrected, ...]:
    found: dict[int, tuple[list[str], list[str]]] = {}
    for series, name in zip(table.series, names, strict=True):
        for at in np.flatnonzero(series.corrected).tolist():
            given, absent = found.setdefault(int(series.frame[at]), ([], []))
            (absent if series.status[at] == "absent" else given).append(name)
    return tuple(Corrected(frame, tuple(given), tuple(absent)) for frame, (given, absent) in sorted(found.items()))


def _part(series: Series, name: str, clock: Clock) -> PartStory:
    sure, frames = series.confidence, series.frame
    losses = []
    for a, b in spans(series.status == "lost"):
        first, last = int(frames[a]), int(frames[b - 1])
        back = int(frames[b]) if b < len(frames) else None
        end = clock.at(back) if back is not None else clock.after(last)
        by_hand = back is not None and bool(series.corrected[b])
        back = None if back is not None and series.status[b] == "absent" else back
        losses.append(LostSpan(name, first, last, back, b - a, end - clock.at(first), _least(sure[a:b]), by_hand))
    tracked = sure[(series.status != "init") & np.isfinite(sure)]
    worst = int(frames[np.nanargmin(sure)]) if np.isfinite(sure).any() else int(frames[0])
    told = bool((series.status != "init").any() or np.isfinite(sure).any())
    mean = float(tracked.mean()) if len(tracked) else math.nan
    gone = series.status == "absent"
    return PartStory(
        name=name,
        rows=len(series),
        spans=tuple(losses),
        mean=mean,
        lowest=_least(sure),
        worst=worst,
        last_status=str(series.status[-1]),
        told=told,
        absences=tuple((int(frames[a]), int(frames[b - 1])) for a, b in spans(gone)),
        frames_absent=int(gone.sum()),
    )


def _least(values: Array) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if len(known) else math.nan


def key_frames(story: Story, first: int, last: int, most: int = MOST_PICTURES) -> list[KeyFrame]:
    """The frames to show, at most `most`, in their order.

    Always the first, the last, and the one whose parts have the lowest confidence on average; and, if they are few
    enough, every frame in which a part was called lost, was tracked again or was put right by hand. Otherwise, of the
    longest stretches in which any part was lost, the frames where they begin and end; then, one by one, the event
    furthest in time from all those taken.
    """
    found = story.events
    events = sorted({frame for frame, _ in found})
    taken = {first, last, *([] if story.worst is None else [story.worst])}
    if len(taken.union(events)) <= most:
        taken.update(events)
    else:
        room = len(taken) + round((most - len(taken)) * _OF_EPISODES)
        for pair in _ends(story.episodes, events):
            if len(taken | pair) <= room:
                taken |= pair
        taken = _spread(taken, events, most)
    fixed: list[tuple[int | None, Kind]] = [(first, "start"), (story.worst, "worst"), (last, "end")]
    shown = []
    for frame in sorted(taken):
        why = [Event(kind) for at, kind in fixed[:1] if at == frame]
        why += [found[frame, kind] for kind in _HAPPENED if (frame, kind) in found]
        why += [Event(kind) for at, kind in fixed[1:] if at == frame]
        shown.append(KeyFrame(frame, tuple(why)))
    return shown


def _ends(episodes: Sequence[tuple[int, int]], events: Sequence[int]) -> Iterable[set[int]]:
    """Where each stretch began and where its last part came back, longest first."""
    for first, last in sorted(episodes, key=lambda e: (e[0] - e[1], e[0])):
        after = int(np.searchsorted(events, last, side="right"))
        yield {first, *events[after : after + 1]}


def _spread(taken: set[int], events: Sequence[int], most: int) -> set[int]:
    frames = np.array(events, dtype=np.int64)
    away = np.min(np.abs(frames[:, None] - np.array(sorted(taken))), axis=1)
    while len(taken) < most and away.max() > 0:
        pick = int(np.argmax(away))
        taken.add(int(frames[pick]))
        away = np.minimum(away, np.abs(frames - frames[pick]))
    return taken
