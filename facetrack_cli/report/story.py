"""What happened in a run: when each part was lost, hidden or absent, the frames that show it, and why.

Frames are source frames.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX
from facetrack_cli.recipe.load import fitted
from facetrack_cli.trajectory.diagnostics import DOUBTFUL
from facetrack_cli.trajectory.reader import Header, SeamHeader
from facetrack_cli.trajectory.trajectory import Trajectory
from facetrack_cli.trajectory.views import Clock

MAX_KEY_FRAMES: Final = 12
_HEADINGS: Final = {
    "start": "Start", "corrected": "Corrected by hand", "seam": "Two chunks differ", "lost": "Called lost",
    "hidden": "Hidden", "back": "No longer called lost", "worst": "Lowest confidence", "end": "End",
}  # fmt: skip
"""Of each kind of reason to show a frame, in the order in which those of one frame stand."""
_DETECTORS: Final[Mapping[str, str]] = {"haar": "the Haar cascades", "yunet": "YuNet"}


class Stretch(NamedTuple):
    """Frames `first` to `last`, both included."""

    first: int
    last: int


class Span(NamedTuple):
    """A part lost, hidden or absent in frames `first` to `last`; `back`: where it is tracked again, if so; `by_hand`: a
    correction ended it; `lowest`: the lowest confidence, nan where there is none.
    """

    first: int
    last: int
    name: str
    back: int | None
    frames: int
    seconds: float
    by_hand: bool
    lowest: float


@dataclass(frozen=True)
class PartHistory:
    """One part: when it was lost, hidden and absent, its mean confidence after the start, its status at the end."""

    name: str
    rows: int
    mean: float
    last_status: str
    lost: tuple[Span, ...]
    hidden: tuple[Span, ...]
    absent: tuple[Span, ...]


@dataclass(frozen=True)
class RunHistory:
    """A whole run: its parts, the `episodes` in which any is lost, the frame of the lowest mean confidence of those in
    which none is, the frames with `corrections`, and the `seams` of a clip that was tracked in chunks.
    """

    parts: tuple[PartHistory, ...]
    episodes: tuple[Stretch, ...]
    frames_lost: int
    worst: int | None
    corrections: tuple[int, ...]
    seams: tuple[SeamHeader, ...] = ()

    @property
    def lost(self) -> list[Span]:
        """When parts were lost, in the order in which that begins."""
        return sorted(span for part in self.parts for span in part.lost)

    @property
    def hidden(self) -> list[Span]:
        return sorted(span for part in self.parts for span in part.hidden)

    @property
    def longest(self) -> list[Stretch]:
        """The three longest episodes, in their order."""
        return sorted(sorted(self.episodes, key=lambda episode: episode.first - episode.last)[:3])

    def ending(self, status: str) -> list[str]:
        """The parts with this status at the end."""
        return [part.name for part in self.parts if part.last_status == status]


def history_of(table: Trajectory, clock: Clock, seams: tuple[SeamHeader, ...] = ()) -> RunHistory:
    """What happened, from the rows of a trajectory; `seams` are where chunks of its clip meet."""
    several, boxes = len(table.targets) > 1, all(part == BOX for _, part in table.names)
    parts = tuple(
        _part(rows, (rows.target if boxes else rows.name) if several else rows.part, clock) for rows in table.parts
    )
    any_lost = np.isin(clock.frames, table.frame[table.status == "lost"])
    # as the run says it: frames in which a part is lost are shown as such
    sure = np.isfinite(table.confidence) & (table.status != "init") & ~np.isin(table.frame, clock.frames[any_lost])
    frames, place = np.unique(table.frame[sure], return_inverse=True)
    mean = np.round(np.bincount(place, table.confidence[sure]) / np.bincount(place), 12)
    return RunHistory(
        parts,
        tuple(Stretch(int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost)),
        int(any_lost.sum()),
        int(frames[np.argmin(mean)]) if len(frames) else None,
        tuple(np.unique(np.concatenate([rows.frame[rows.corrected] for rows in table.parts])).tolist()),
        seams,
    )


def _part(rows: Trajectory, name: str, clock: Clock) -> PartHistory:
    frames = [*rows.frame.tolist(), int(rows.frame[-1]) + 1]

    def unseen(status: str) -> Iterator[Span]:
        for a, b in spans(rows.status == status):
            ends = b < len(rows)
            back = frames[b] if ends and rows.status[b] != "absent" else None
            seconds, lowest = clock.at(frames[b]) - clock.at(frames[a]), float(np.fmin.reduce(rows.confidence[a:b]))
            yield Span(frames[a], frames[b - 1], name, back, b - a, seconds, ends and bool(rows.corrected[b]), lowest)

    lost, hidden, absent = (tuple(unseen(status)) for status in ("lost", "hidden", "absent"))
    mean = confidence_of(rows)
    return PartHistory(name, len(rows), math.nan if mean is None else mean, str(rows.status[-1]), lost, hidden, absent)


def key_frames(history: RunHistory, events: Iterable[int], first: int, last: int) -> list[int]:
    """At most MAX_KEY_FRAMES: the first, the last, that of the lowest mean confidence, and of `events`. Of too many
    events that where the longest episode begins, then, one by one, that furthest in time from all taken.
    """
    left, taken = np.array(sorted({*events, first})), {first, last}
    taken |= set() if history.worst is None else {history.worst}
    taken |= {min(history.episodes, key=lambda e: e.first - e.last).first} if history.episodes else set()
    while len(taken) < MAX_KEY_FRAMES:
        away = np.abs(left[:, None] - np.array(sorted(taken))).min(axis=1)
        if not away.max():
            break
        taken.add(int(left[np.argmax(away)]))
    return sorted(taken)


def reasons(
    table: Trajectory, history: RunHistory, origin: str, first: int, last: int
) -> dict[int, list[tuple[str, str, str]]]:
    """By frame, (kind, heading, words) of each reason to show it; `origin` is that of the start, as `--box`."""
    why: dict[int, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    why[first]["start"] = [f"placed by {_DETECTORS.get(origin) or Path(origin).name or origin}"]
    for frame in history.corrections:
        rows = table.at(frame)
        for part, status in zip(rows.which.tolist(), rows.status.tolist(), strict=True):
            if status in ("init", "absent"):
                why[frame]["corrected"].append(history.parts[part].name + " absent" * (status == "absent"))
    for seam in history.seams:
        if not seam.agrees:
            why[seam.frame]["seam"] = [f"they agree in {percent(seam.agreement)} of the frames that both have"]
    for span in history.lost:
        why[span.first]["lost"].append(span.name)
        if span.back is not None and not span.by_hand:
            why[span.back]["back"].append(f"{span.name} after {lasting(span.seconds)}")
    for span in history.hidden:
        why[span.first]["hidden"].append(f"{span.name} for {lasting(span.seconds)}")
    if history.worst is not None:
        why[history.worst]["worst"] = [number(float(np.nanmean(table.at(history.worst).confidence)))]
    ends = [f"{status}: {names(gone, 5)}" for status in ("lost", "absent") if (gone := history.ending(status))]
    why[last]["end"] = ["; ".join(ends) or "nothing is lost"]
    return {
        frame: [(kind, heading, names(own[kind], 5)) for kind, heading in _HEADINGS.items() if kind in own]
        for frame, own in why.items()
    }


def identities(table: Trajectory) -> Iterator[tuple[str, str, float, int | None]]:
    """Of each target with an identity the last one, its probability, and the frame since which it is sure."""
    for target in table.targets:
        rows = table.of_target(target)[0]
        for last in np.flatnonzero(rows.identity != "")[-1:]:
            name = str(rows.identity[last])
            yield target, name, float(rows.identity_prob[last]), table.recognised(target, name)


def confidence_of(table: Trajectory) -> float | None:
    """The mean confidence of all rows after the start, also of rows called lost; None without confidences."""
    sure = table.confidence[np.isfinite(table.confidence) & (table.status != "init")]
    return float(sure.mean()) if sure.size else None


def doubts(header: Header, mean: float | None) -> list[str]:
    """A line if a confidence of this mean speaks against the track, be it calibrated with other settings."""
    if mean is None or mean >= DOUBTFUL or not fitted(header.recipe):
        return []
    return ["The track is doubtful: by its confidence fewer than half of its rows are right"]


# --- in words --------------------------------------------------------------------------------------------------------


def count(n: int, singular: str, many: str = "") -> str:
    """`1 frame`, `2 frames`, `12,000 frames`."""
    return f"{n:,} {singular if n == 1 else many or singular + 's'}"


def lasting(seconds: float) -> str:
    """A length of time."""
    if not math.isfinite(seconds):
        return "–"
    return f"{seconds:.2f} s" if seconds < 60 else at_clock(seconds)


def percent(share: float | None) -> str:
    """A share in percent; 0 % and 100 % stand for exactly none and all."""
    if share is None or not math.isfinite(share):
        return "–"
    return f"{100 * share:.0f}\u00a0%" if share in (0, 1) else f"{100 * min(max(share, 0.001), 0.999):.1f}\u00a0%"


def number(value: float | None, decimals: int = 2) -> str:
    """A figure, or a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def names(items: Sequence[str], most: int = 8) -> str:
    """`a, b and c`; of many, the first and how many more."""
    if len(items) > most:
        return f"{', '.join(items[: most - 1])} and {len(items) - most + 1} more"
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))
