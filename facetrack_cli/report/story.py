"""What happened in a run: when each part was lost and tracked again, the frames that show it, and all of it in words.

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
from facetrack_cli.core.types import BOX, Mask, Whole
from facetrack_cli.recipe.load import calibrated, fitted
from facetrack_cli.runs.verdict import LOW
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, SURE
from facetrack_cli.trajectory.reader import Header, SeamHeader
from facetrack_cli.trajectory.trajectory import Trajectory, mean_confidence
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
    """A part lost or hidden in `first` to `last`; `back`: where it is tracked again, if so; `by_hand`: a correction
    ended it. Confidences are that in `first`, the lowest, and that in the frame after `last`.
    """

    name: str
    first: int
    last: int
    back: int | None
    frames: int
    seconds: float
    by_hand: bool
    confidence: float
    lowest: float
    after: float


@dataclass(frozen=True)
class PartHistory:
    """One part, and when it was lost (`spans`) and hidden. Confidences are nan where unknown, `worst` is the frame of
    the lowest; `judged`: it has a status.
    """

    name: str
    rows: int
    spans: tuple[Span, ...]
    hidings: tuple[Span, ...]
    absences: tuple[Stretch, ...]
    frames_absent: int
    mean: float
    lowest: float
    worst: int
    last_status: str
    judged: bool
    vanishes: bool


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
    def spans(self) -> list[Span]:
        """When parts were lost, in the order in which that begins."""
        return sorted((s for part in self.parts for s in part.spans), key=lambda s: (s.first, s.name))

    def ending(self, status: str) -> list[str]:
        """The parts with this status at the end."""
        return [part.name for part in self.parts if part.last_status == status]

    @property
    def hidings(self) -> list[Span]:
        """When parts were hidden."""
        return sorted(span for part in self.parts for span in part.hidings)


def history_of(table: Trajectory, clock: Clock, seams: tuple[SeamHeader, ...] = ()) -> RunHistory:
    """What happened, from the rows of a trajectory; `seams` are where chunks of its clip meet."""
    several, boxes = len(table.targets) > 1, all(part == BOX for _, part in table.names)
    parts = tuple(
        _part(rows, (rows.target if boxes else rows.name) if several else rows.part, clock) for rows in table.parts
    )
    place = np.searchsorted(clock.frames, table.frame)
    any_lost = np.bincount(place[table.status == "lost"], minlength=len(clock.frames)) > 0
    sure = np.isfinite(table.confidence) & (table.status != "init")
    counted = np.bincount(place[sure], minlength=len(clock.frames))
    total = np.bincount(place[sure], table.confidence[sure], len(clock.frames))
    # as the run says it: frames in which a part is lost are shown as such
    there = (counted > 0) & ~any_lost
    mean = np.round(np.divide(total, counted, out=np.full(len(total), np.inf), where=there), 12)
    return RunHistory(
        parts,
        _stretches(clock.frames, any_lost),
        int(any_lost.sum()),
        int(clock.frames[np.argmin(mean)]) if there.any() else None,
        tuple(np.unique(np.concatenate([rows.frame[rows.corrected] for rows in table.parts])).tolist()),
        seams,
    )


def _stretches(frames: Whole, mask: Mask) -> tuple[Stretch, ...]:
    return tuple(Stretch(int(frames[a]), int(frames[b - 1])) for a, b in spans(mask))


def _part(rows: Trajectory, name: str, clock: Clock) -> PartHistory:
    sure, frames, status = rows.confidence, rows.frame.tolist(), rows.status

    def unseen(kind: str) -> Iterator[Span]:
        for a, b in spans(status == kind):
            ends = b < len(frames)
            stop = clock.at(frames[b]) if ends else clock.at(frames[b - 1] + 1)
            back, by_hand = (frames[b] if ends and status[b] != "absent" else None), ends and bool(rows.corrected[b])
            sures = sure[a], np.fmin.reduce(sure[a:b]), sure[b] if ends else math.nan
            seconds = stop - clock.at(frames[a])
            yield Span(name, frames[a], frames[b - 1], back, b - a, seconds, by_hand, *map(float, sures))

    is_sure = np.isfinite(sure)
    tracked = sure[(status != "init") & is_sure]
    return PartHistory(
        name=name,
        rows=len(rows),
        spans=tuple(unseen("lost")),
        hidings=tuple(unseen("hidden")),
        absences=_stretches(rows.frame, status == "absent"),
        frames_absent=int((status == "absent").sum()),
        mean=float(tracked.mean()) if len(tracked) else math.nan,
        lowest=float(np.fmin.reduce(sure)),
        worst=frames[np.nanargmin(sure)] if is_sure.any() else frames[0],
        last_status=str(status[-1]),
        judged=bool((status != "init").any() or is_sure.any()),
        vanishes=bool(rows.vanished.any()),
    )


def key_frames(history: RunHistory, events: Iterable[int], first: int, last: int) -> list[int]:
    """At most MAX_KEY_FRAMES: the first, the last, that of the lowest mean confidence, and of `events`. Of too many
    events that where the longest episode begins, then, one by one, that furthest in time from all taken.
    """
    left, taken = np.array(sorted({*events, first})), {first, last}
    taken |= set() if history.worst is None else {history.worst}
    taken |= {span.first for span in sorted(history.episodes, key=lambda e: e.first - e.last)[:1]}
    while len(taken) < MAX_KEY_FRAMES:
        away = np.abs(left[:, None] - np.array(sorted(taken))).min(axis=1)
        if not away.max():
            break
        taken.add(int(left[np.argmax(away)]))
    return sorted(taken)


# --- in words --------------------------------------------------------------------------------------------------------


def count(n: int, singular: str, many: str = "") -> str:
    """`1 frame`, `2 frames`, `12,000 frames`."""
    return f"{n:,} {singular if n == 1 else many or singular + 's'}"


def lasting(seconds: float) -> str:
    """A length of time."""
    if not math.isfinite(seconds):
        return "–"
    if seconds < 60:
        return f"{seconds:.2f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


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


def sentences(table: Trajectory, header: Header, clock: Clock, history: RunHistory) -> str:
    """The run in words: what was tracked, for how long, how often it was lost."""
    frames, parts = len(clock.frames), len(history.parts)
    whose = table.target if len(table.targets) == 1 else count(len(table.targets), "target")
    # of each target a box, or its only part
    what = whose if parts == len(table.targets) else f"{count(parts, 'part')} of {whose}"
    long = f"{count(frames, 'frame')}, {lasting(clock.duration)}"
    facts = [f"The recipe {header.recipe_name} looked for {what} in {header.clip_name} over {long}."]
    lost = [part.name for part in history.parts if part.spans]
    if not any(part.judged for part in history.parts):
        facts.append("The tracker does not report when it is lost.")
    elif not lost:
        facts.append("It was never called lost." if parts == 1 else "No part was ever called lost.")
    else:
        share = f"{count(history.frames_lost, 'frame')} ({percent(history.frames_lost / frames)})"
        times = count(len(history.episodes), "stretch", "stretches")
        facts.append(f"Called lost in {share}, in {times}: {names(lost)}.")
        gone = history.ending("lost")
        facts.append(f"In the last frame {_are(gone) if gone else 'none is'} called lost.")
    if hidden := len({at for span in history.hidings for at in range(span.first, span.last + 1)}):
        facts.append(f"Something was hidden, at a likely place, in {count(hidden, 'frame')}.")
    if (mean := confidence_of(table)) is not None:
        facts.append(_trust(calibrated(header.recipe), mean))
    if history.seams:
        differ = sum(not seam.agrees for seam in history.seams)
        where = f"{differ or 'none'} of the {count(len(history.seams), 'place')} where they meet"
        facts.append(f"It was tracked in chunks, which differ at {where}.")
    if history.corrections:
        facts.append(f"It was corrected by hand in {count(len(history.corrections), 'frame')}.")
    if missing := [part for part in history.parts if part.frames_absent]:
        said = "Absent" if any(part.vanishes for part in missing) else "Marked as absent"
        rows = count(sum(part.frames_absent for part in missing), "row")
        facts.append(f"{said}: {names([part.name for part in missing])}, in {rows}.")
    return " ".join(facts)


def to_look_at(table: Trajectory, history: RunHistory, clock: Clock) -> list[tuple[int, str]]:
    """Frames to look at first, as the run names them, each with the words: the longest stretches in which a part is
    called lost, and the frame of the lowest confidence where that is low.
    """
    looks = []
    for first, last in sorted(sorted(history.episodes, key=lambda episode: episode.first - episode.last)[:3]):
        lost = dict.fromkeys(span.name for span in history.spans if span.first <= last and span.last >= first)
        frames = f"frames {first} to {last}" if last > first else f"frame {first}"
        looks.append((first, f"{at_clock(clock.at(first))}, {frames}: {names([*lost], 3)} lost"))
    if history.worst is not None:
        rows = table.at(history.worst)
        mean = mean_confidence(rows.confidence[np.isfinite(rows.confidence) & (rows.status != "init")])
        if mean < LOW:
            at = f"{at_clock(clock.at(history.worst))}, frame {history.worst}"
            looks.append((history.worst, f"{at}: the lowest confidence, {number(mean)}"))
    return looks


def confidence_of(table: Trajectory) -> float | None:
    """The mean confidence of all rows after the start, also of rows called lost; None without confidences."""
    sure = table.confidence[np.isfinite(table.confidence) & (table.status != "init")]
    return float(sure.mean()) if sure.size else None


def _trust(calibrated: bool, mean: float) -> str:
    """What the mean confidence says of the rows."""
    if not calibrated:
        return "Its confidence is not calibrated: it says how alike the image is, not how often the place is right."
    right = "right, within a quarter of the target's size"
    return f"Its confidence, calibrated on clips of known truth, expects {percent(mean)} of the rows to be {right}."


def doubts(header: Header, mean: float | None) -> list[str]:
    """A line if a confidence of this mean speaks against the track, be it calibrated with other settings."""
    if mean is None or mean >= DOUBTFUL or not fitted(header.recipe):
        return []
    return ["The track is doubtful: by its confidence fewer than half of its rows are right"]


def identities(table: Trajectory, clock: Clock) -> Iterator[str]:
    """A sentence for each target with an identity: the last one, its probability, and since when it is sure."""
    for target in table.targets:
        rows = table.of_target(target)[0]
        named = np.flatnonzero(rows.identity != "")
        if not named.size:
            continue
        name, sure = str(rows.identity[named[-1]]), float(rows.identity_prob[named[-1]])
        sentence = f"{f'{target} is named' if len(table.targets) > 1 else 'It is named'} {name} at the end"
        if math.isfinite(sure):
            sentence += f", with a probability of {percent(sure)}"
        passed = table.recognised(target, name)
        if passed is not None:
            sentence += f"; that passed {SURE:g} in frame {passed:,}, at {at_clock(clock.at(passed))}"
        elif math.isfinite(sure):
            sentence += f"; that never passed {SURE:g}"
        yield f"{sentence}."


def reasons(
    table: Trajectory, history: RunHistory, origin: str, first: int, last: int
) -> dict[int, list[tuple[str, str, str]]]:
    """By frame, (kind, heading, words) of each reason to show it; `origin` is that of the start, as `--box`."""
    found: dict[int, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))

    def called(frame: int, status: str) -> list[str]:
        rows = table.at(frame)
        return [history.parts[part].name for part in rows.which[rows.status == status].tolist()]

    found[first]["start"] = [f"placed by {_DETECTORS.get(origin) or Path(origin).name or origin}"]
    for frame in history.corrections:
        gone = f"{_are(absent, 5)} absent" if (absent := called(frame, "absent")) else ""
        found[frame]["corrected"] = ["; ".join(filter(None, (names(called(frame, "init"), 5), gone)))]
    for seam in history.seams:
        if not seam.agrees:
            found[seam.frame]["seam"] = [f"they agree in {percent(seam.agreement)} of the frames that both have"]
    for span in history.spans:
        found[span.first]["lost"].append(f"{span.name} (confidence {number(span.confidence)})")
        if span.back is not None and not span.by_hand:
            then = f"{span.name} after {lasting(span.seconds)} (confidence {number(span.after)})"
            found[span.back]["back"].append(then)
    for span in history.hidings:
        then = f"{span.name} for {lasting(span.seconds)} (confidence {number(span.confidence)})"
        found[span.first]["hidden"].append(then)
    if history.worst is not None:
        confidence = table.at(history.worst).confidence
        over = f", the mean over {len(confidence):,} parts" if len(confidence) > 1 else ""
        found[history.worst]["worst"] = [f"{number(float(np.nanmean(confidence)))}{over}"]
    ends = [f"called {status}: {names(gone, 5)}" for status in ("lost", "absent") if (gone := called(last, status))]
    found[last]["end"] = ["; ".join(ends) or "nothing is called lost"]
    return {
        frame: [(kind, heading, names(why[kind], 5)) for kind, heading in _HEADINGS.items() if kind in why]
        for frame, why in found.items()
    }


def _are(items: Sequence[str], most: int = 8) -> str:
    return f"{names(items, most)} {'is' if len(items) == 1 else 'are'}"
