"""What happened in a run: when each part was lost and tracked again, the frames that show it, and all of it in words.

Frames are source frames.
"""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array
from facetrack_cli.recipe.load import calibrated, fitted
from facetrack_cli.runs.verdict import LOW
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, SURE
from facetrack_cli.trajectory.reader import Header, SeamHeader
from facetrack_cli.trajectory.trajectory import Trajectory, mean_confidence
from facetrack_cli.trajectory.views import Clock

Kind: TypeAlias = Literal["start", "corrected", "seam", "lost", "hidden", "back", "worst", "end"]
"""Why a frame is shown, in the order in which the reasons of one frame stand."""
MAX_KEY_FRAMES: Final = 12
_HEADINGS: Final[Mapping[Kind, tuple[str, str]]] = {
    "start": ("Start", ""), "corrected": ("Corrected by hand", ""), "seam": ("Two chunks differ", ""),
    "lost": ("Called lost", ""), "hidden": ("Hidden", " for {}"), "back": ("No longer called lost", " after {}"),
    "worst": ("Lowest confidence", ""), "end": ("End", ""),
}  # fmt: skip
"""The heading of each kind, and what follows a part that was lost or hidden so long."""
_DETECTORS: Final[Mapping[str, str]] = {"haar": "the Haar cascades", "yunet": "YuNet"}


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
    """Why a frame is shown: the spans that begin or end in it, its correction, chunks that meet."""

    kind: Kind
    spans: tuple[LostSpan, ...] = ()
    corrected: CorrectedFrame | None = None
    seam: SeamHeader | None = None


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
        return events | {(fix.frame, "corrected"): Event("corrected", corrected=fix) for fix in self.corrections}


def history_of(table: Trajectory, clock: Clock, seams: tuple[SeamHeader, ...] = ()) -> RunHistory:
    """What happened, from the rows of a trajectory; `seams` are where chunks of its clip meet."""
    several, boxes = len(table.targets) > 1, all(part == BOX for _, part in table.names)
    parts = tuple(
        _part(rows, (rows.target if boxes else rows.name) if several else rows.part, clock) for rows in table.parts
    )
    place = np.searchsorted(clock.frames, table.frame)
    any_lost = np.zeros(len(clock.frames), dtype=np.bool_)
    any_lost[place[table.status == "lost"]] = True
    sure = np.isfinite(table.confidence) & (table.status != "init")
    counted = np.bincount(place[sure], minlength=len(clock.frames))
    total = np.bincount(place[sure], table.confidence[sure], len(clock.frames))
    # as the run says it: frames in which a part is lost are shown as such
    there = (counted > 0) & ~any_lost
    mean = np.round(np.divide(total, counted, out=np.full(len(total), np.inf), where=there), 12)
    episodes = tuple(Stretch(int(clock.frames[a]), int(clock.frames[b - 1])) for a, b in spans(any_lost))
    worst = int(clock.frames[np.argmin(mean)]) if there.any() else None
    corrected: dict[int, tuple[list[str], list[str]]] = {}
    for rows, part in zip(table.parts, parts, strict=True):
        for at in np.flatnonzero(rows.corrected).tolist():
            fixed, absent = corrected.setdefault(int(rows.frame[at]), ([], []))
            (absent if rows.status[at] == "absent" else fixed).append(part.name)
    fixes = tuple(CorrectedFrame(at, tuple(fixed), tuple(absent)) for at, (fixed, absent) in sorted(corrected.items()))
    return RunHistory(parts, episodes, int(any_lost.sum()), worst, fixes, seams)


def _part(rows: Trajectory, name: str, clock: Clock) -> PartHistory:
    sure, frames, status = rows.confidence, rows.frame.tolist(), rows.status
    unseen: dict[str, list[LostSpan]] = {"lost": [], "hidden": []}
    for kind, (a, b) in ((state, span) for state in unseen for span in spans(status == state)):
        ends = b < len(frames)
        stop = clock.at(frames[b]) if ends else clock.at(frames[b - 1] + 1)
        back = frames[b] if ends and status[b] != "absent" else None
        seconds, by_hand = stop - clock.at(frames[a]), ends and bool(rows.corrected[b])
        unseen[kind].append(LostSpan(name, frames[a], frames[b - 1], back, b - a, seconds, _least(sure[a:b]), by_hand))
    is_sure = np.isfinite(sure)
    tracked = sure[(status != "init") & is_sure]
    return PartHistory(
        name=name,
        rows=len(rows),
        spans=tuple(unseen["lost"]),
        hidings=tuple(unseen["hidden"]),
        mean=float(tracked.mean()) if len(tracked) else math.nan,
        lowest=_least(sure),
        worst=frames[np.nanargmin(sure)] if is_sure.any() else frames[0],
        last_status=str(status[-1]),
        judged=bool((status != "init").any() or is_sure.any()),
        absences=tuple(Stretch(frames[a], frames[b - 1]) for a, b in spans(status == "absent")),
        frames_absent=int((status == "absent").sum()),
        vanishes=bool(rows.vanished.any()),
    )


def _least(values: Array) -> float:
    return float(np.fmin.reduce(values, initial=math.nan))


def key_frames(history: RunHistory, first: int, last: int, most: int = MAX_KEY_FRAMES) -> list[KeyFrame]:
    """At most `most` frames: the first, the last, that of the lowest mean confidence, and of events. Of too many
    events that where the longest episode begins, then, one by one, that furthest in time from all taken.
    """
    by_frame = history.events
    events = np.array(sorted({frame for frame, _ in by_frame}), dtype=np.int64)
    worst = [] if history.worst is None else [(history.worst, Event("worst"))]
    fixed = [(first, Event("start")), *worst, (last, Event("end"))]
    by_frame |= {(frame, event.kind): event for frame, event in fixed}
    taken = {frame for frame, _ in fixed}
    taken |= {span.first for span in sorted(history.episodes, key=lambda e: e.first - e.last)[:1]}
    while len(events) and len(taken) < most:
        away = np.abs(events[:, None] - np.array(sorted(taken))).min(axis=1)
        if not away.max():
            break
        taken.add(int(events[np.argmax(away)]))
    kinds: tuple[Kind, ...] = get_args(Kind)
    return [KeyFrame(at, tuple(by_frame[at, kind] for kind in kinds if (at, kind) in by_frame)) for at in sorted(taken)]


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
    if hidden := len({at for part in history.parts for gap in part.hidings for at in range(gap.first, gap.last + 1)}):
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


def reasons(key: KeyFrame, table: Trajectory, history: RunHistory, origin: str) -> list[tuple[str, str, str]]:
    """(kind, heading, words) of each event of a key frame; `origin` is that of the start, as `--box`."""
    rows = table.at(key.frame)
    parts = [history.parts[part].name for part in rows.which.tolist()]
    confidence = dict(zip(parts, rows.confidence.tolist(), strict=True))
    confidences = rows.confidence[np.isfinite(rows.confidence)]
    mean = number(float(confidences.mean()) if confidences.size else None)

    def words(event: Event) -> tuple[str, str]:
        heading, after = _HEADINGS[event.kind]
        match event.kind:
            case "start":
                text = f"placed by {_DETECTORS.get(origin) or Path(origin).name or origin}"
            case "corrected":
                placed, absent = event.corrected[1:] if event.corrected else ((), ())
                gone = f"{_are(absent, 5)} absent" if absent else ""
                text = "; ".join(filter(None, (names(placed, 5), gone)))
            case "seam":
                share = None if event.seam is None else event.seam.agreement
                text = f"they agree in {percent(share)} of the frames that both have"
            case "hidden" | "lost" | "back":
                text = names([
                    f"{s.name}{after.format(lasting(s.seconds))} (confidence {number(confidence.get(s.name))})"
                    for s in event.spans
                ], 5)  # fmt: skip
            case "worst":
                text = mean + (f", the mean over {len(parts):,} parts" if len(parts) > 1 else "")
            case _:
                ends = [(kind, [parts[i] for i in np.flatnonzero(rows.status == kind)]) for kind in ("lost", "absent")]
                text = "; ".join(f"called {kind}: {names(gone, 5)}" for kind, gone in ends if gone)
                text = text or "nothing is called lost"
        return heading, text

    return [(event.kind, *words(event)) for event in key.events]


def _are(items: Sequence[str], most: int = 8) -> str:
    return f"{names(items, most)} {'is' if len(items) == 1 else 'are'}"
