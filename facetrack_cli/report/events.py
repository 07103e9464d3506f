"""What happened in a run, in source frames: when each part was lost and tracked again, and the frames that show it."""

import math
from bisect import bisect
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.header import SeamHeader
from facetrack_cli.trajectory.trajectory import Trajectory

Kind: TypeAlias = Literal[
    "start", "corrected", "seam", "lost", "hidden", "back", "opening", "smile", "blink", "worst", "end"
]
"""Why a frame is shown, in the order in which the reasons of one frame stand."""
MAX_KEY_FRAMES: Final = 12
_OF_EPISODES: Final = 2 / 3  # of the frames beside start, worst and end, where there are too many events


class Stretch(NamedTuple):
    """Frames `first` to `last`, both included."""

    first: int
    last: int


class LostSpan(NamedTuple):
    """A part lost in `first` to `last`; `back`: where it is tracked again, if so; `by_hand`: a correction ended it."""

    name: str
    first: int
    last: int
    back: int | None
    frames: int
    seconds: float
    lowest: float
    by_hand: bool


class CorrectedFrame(NamedTuple):
    """A frame that is corrected by hand: the parts `given` in it, and those from then on `absent`."""

    frame: int
    given: tuple[str, ...]
    absent: tuple[str, ...]


@dataclass(frozen=True)
class PartHistory:
    """One part; confidences are nan where unknown, `worst` is the frame of the lowest; `judged`: it has a status."""

    name: str
    rows: int
    spans: tuple[LostSpan, ...]
    mean: float
    lowest: float
    worst: int
    last_status: str
    judged: bool
    absences: tuple[Stretch, ...]
    hidings: tuple[LostSpan, ...]
    frames_absent: int
    vanishes: bool


class Event(NamedTuple):
    """Why a frame is shown: the spans that begin or end in it, its correction, chunks that meet, what is measured."""

    kind: Kind
    spans: tuple[LostSpan, ...] = ()
    corrected: CorrectedFrame | None = None
    seam: SeamHeader | None = None
    words: str = ""


class KeyFrame(NamedTuple):
    frame: int
    events: tuple[Event, ...]


@dataclass(frozen=True)
class RunHistory:
    """A whole run: its parts, the `episodes` in which any is lost, the frame of the lowest mean confidence of those in
    which none is, and the `seams` of a clip that was tracked in chunks.
    """

    parts: tuple[PartHistory, ...]
    episodes: tuple[Stretch, ...]
    frames_lost: int
    worst: int | None
    corrections: tuple[CorrectedFrame, ...]
    seams: tuple[SeamHeader, ...] = ()
    peaks: tuple[tuple[int, Event], ...] = ()

    @property
    def spans(self) -> list[LostSpan]:
        """Of all parts, in the order in which they begin."""
        return sorted((s for part in self.parts for s in part.spans), key=lambda s: (s.first, s.name))

    def ending(self, status: str) -> list[str]:
        """The parts with this status at the end."""
        return [part.name for part in self.parts if part.last_status == status]

    @property
    def events(self) -> dict[tuple[int, Kind], Event]:
        """The events after the start, by frame and kind."""
        spans: dict[tuple[int, Kind], list[LostSpan]] = defaultdict(list)
        for span in self.spans:
            spans[span.first, "lost"].append(span)
            if span.back is not None and not span.by_hand:
                spans[span.back, "back"].append(span)
        for span in sorted(hiding for part in self.parts for hiding in part.hidings):
            spans[span.first, "hidden"].append(span)
        events = {(frame, kind): Event(kind, tuple(each)) for (frame, kind), each in spans.items()}
        events |= {(seam.frame, "seam"): Event("seam", seam=seam) for seam in self.seams if not seam.agrees}
        return events | {(one.frame, "corrected"): Event("corrected", corrected=one) for one in self.corrections}


def history_of(table: Trajectory, clock: Clock, seams: tuple[SeamHeader, ...] = ()) -> RunHistory:
    """What happened, from the rows of a trajectory; `seams` are where chunks of its clip meet."""
    several, boxes = len(table.targets) > 1, all(part == BOX for _, part in table.names)
    parts = tuple(
        _part(one, (one.target if boxes else one.name) if several else one.part, clock) for one in table.parts
    )
    place = np.searchsorted(clock.frames, table.frame)
    any_lost = np.zeros(len(clock.frames), dtype=np.bool_)
    any_lost[place[table.status == "lost"]] = True
    sure = np.isfinite(table.confidence) & (table.status != "init")
    known = np.bincount(place[sure], minlength=len(clock.frames))
    total = np.bincount(place[sure], table.confidence[sure], len(clock.frames))
    # as the run says it: frames in which a part is lost are shown as such
    there = (known > 0) & ~any_lost
    mean = np.round(np.divide(total, known, out=np.full(len(total), np.inf), where=there), 12)
    episodes = tuple(Stretch(int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost))
    worst = int(clock.frames[np.argmin(mean)]) if there.any() else None
    corrected: dict[int, tuple[list[str], list[str]]] = {}
    for one, part in zip(table.parts, parts, strict=True):
        for at in np.flatnonzero(one.corrected).tolist():
            given, absent = corrected.setdefault(int(one.frame[at]), ([], []))
            (absent if one.status[at] == "absent" else given).append(part.name)
    fixes = tuple(CorrectedFrame(at, tuple(given), tuple(absent)) for at, (given, absent) in sorted(corrected.items()))
    return RunHistory(parts, episodes, int(any_lost.sum()), worst, fixes, seams, tuple(_peaks(table)))


def _peaks(table: Trajectory) -> Iterator[tuple[int, Event]]:
    """Where the mouth of the first face is open widest, and wide, and its eyes shut in a blink, as the spread tells."""
    kinds: tuple[tuple[Kind, str, int], ...] = (
        ("opening", "mouth_opening", 1), ("smile", "mouth_width", 1), ("blink", "eye_opening", -1),
    )  # fmt: skip
    for kind, name, sign in kinds:
        for one in [found[name] for found in table.measures.values() if name in found][:1]:
            sure = sign * one.value - np.nan_to_num(one.std)
            if np.isfinite(sure).any() and (kind != "blink" or any(event.value == kind for event in table.events)):
                row = int(np.nanargmax(sure))
                words = f"{name.replace('_', ' ')} {one.value[row]:.2f} ± {one.std[row]:.2f} {one.unit}"
                yield int(one.frame[row]), Event(kind, words=words)


def _part(one: Trajectory, name: str, clock: Clock) -> PartHistory:
    sure, frames, status = one.confidence, one.frame.tolist(), one.status
    unseen: dict[str, list[LostSpan]] = {"lost": [], "hidden": []}
    for kind, (a, b) in ((one, span) for one in unseen for span in spans(status == one)):
        ends = b < len(frames)
        stop = clock.at(frames[b]) if ends else clock.after(frames[b - 1])
        back = frames[b] if ends and status[b] != "absent" else None
        seconds, by_hand = stop - clock.at(frames[a]), ends and bool(one.corrected[b])
        unseen[kind].append(LostSpan(name, frames[a], frames[b - 1], back, b - a, seconds, _least(sure[a:b]), by_hand))
    known = np.isfinite(sure)
    tracked = sure[(status != "init") & known]
    return PartHistory(
        name=name,
        rows=len(one),
        spans=tuple(unseen["lost"]),
        hidings=tuple(unseen["hidden"]),
        mean=float(tracked.mean()) if len(tracked) else math.nan,
        lowest=_least(sure),
        worst=frames[np.nanargmin(sure)] if known.any() else frames[0],
        last_status=str(status[-1]),
        judged=bool((status != "init").any() or known.any()),
        absences=tuple(Stretch(frames[a], frames[b - 1]) for a, b in spans(status == "absent")),
        frames_absent=int((status == "absent").sum()),
        vanishes=bool(one.vanished.any()),
    )


def _least(values: Array) -> float:
    return float(np.fmin.reduce(values, initial=math.nan))


def key_frames(history: RunHistory, first: int, last: int, most: int = MAX_KEY_FRAMES) -> list[KeyFrame]:
    """At most `most` frames: the first, the last, that of the lowest mean confidence, the peaks, and of events. Of
    too many events, where the longest episodes begin and end, then, one by one, that furthest in time from all taken.
    """
    found = history.events
    events = sorted({frame for frame, _ in found})
    worst = [] if history.worst is None else [(history.worst, Event("worst"))]
    fixed = [(first, Event("start")), *worst, *history.peaks, (last, Event("end"))]
    found |= {(frame, event.kind): event for frame, event in fixed}
    taken = {frame for frame, _ in fixed}
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
    """The frames taken, and the events furthest from them and from each other."""
    frames = np.array(events, dtype=np.int64)
    away = np.min(np.abs(frames[:, None] - np.array(sorted(taken))), axis=1)
    while len(taken) < most and away.max() > 0:
        pick = int(np.argmax(away))
        taken.add(int(frames[pick]))
        away = np.minimum(away, np.abs(frames - frames[pick]))
    return taken
