"""The report in words: the summary, and what each key frame shows."""

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.recipe.load import calibrated, fitted
from facetrack_cli.report.events import Event, KeyFrame, RunHistory
from facetrack_cli.runs.verdict import SURE as LOW
from facetrack_cli.trajectory.clock import Clock
from facetrack_cli.trajectory.diagnostics import DOUBTFUL, SURE
from facetrack_cli.trajectory.header import Header
from facetrack_cli.trajectory.trajectory import Trajectory, mean_confidence

_DETECTORS: Final[Mapping[str, str]] = {"haar": "the Haar cascades", "yunet": "YuNet"}


def count(n: int, one: str, many: str = "") -> str:
    """`1 frame`, `2 frames`, `12,000 frames`."""
    return f"{n:,} {one if n == 1 else many or one + 's'}"


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


def names(those: Sequence[str], most: int = 8) -> str:
    """`a, b and c`; of many, the first and how many more."""
    if len(those) > most:
        return f"{', '.join(those[: most - 1])} and {len(those) - most + 1} more"
    return " and ".join(filter(None, (", ".join(those[:-1]), *those[-1:])))


def sentences(table: Trajectory, header: Header, clock: Clock, history: RunHistory) -> str:
    """The run in words: what was tracked, for how long, how often it was lost."""
    frames, one = len(clock.frames), len(history.parts) == 1
    whose = table.target if len(table.targets) == 1 else count(len(table.targets), "target")
    each = len(history.parts) == len(table.targets)  # a box of each, or the only part
    what = whose if each else f"{count(len(history.parts), 'part')} of {whose}"
    long = f"{count(frames, 'frame')}, {lasting(clock.duration)}"
    found = [f"The recipe {header.recipe_name} looked for {what} in {header.clip_name} over {long}."]
    lost = [part.name for part in history.parts if part.spans]
    gone, absent = history.ending("lost"), history.ending("absent")
    if not any(part.judged for part in history.parts):
        found.append("The tracker does not report when it is lost.")
    elif not lost:
        found.append("It was never called lost." if one else "No part was ever called lost.")
    else:
        n = len(history.episodes)
        times = {1: "one stretch", 2: "two stretches"}.get(n, count(n, "stretch", "stretches"))
        who = "It" if one else "At least one part"
        those = "" if one else f": {names(lost)}"
        share = f"{count(history.frames_lost, 'frame')} ({percent(history.frames_lost / frames)})"
        found.append(f"{who} was called lost in {share}, in {times}{those}.")
        end = f"{_are(gone)} called lost" if gone else f"{'no other' if absent else 'no'} part is called lost"
        if not one or not absent:
            found.append(
                f"In the last frame {('it is called lost' if gone else 'it is not called lost') if one else end}."
            )
    if hidden := len({at for part in history.parts for one in part.hidings for at in range(one.first, one.last + 1)}):
        found.append(
            f"{'It' if one else 'At least one part'} was hidden, at a likely place, in {count(hidden, 'frame')}."
        )
    if (mean := confidence_of(table)) is not None:
        found.append(_trust(calibrated(header.recipe), mean))
    if history.seams:
        differ = sum(not seam.agrees for seam in history.seams)
        those = f"{differ or 'none'} of the {count(len(history.seams), 'place')} where they meet"
        found.append(f"It was tracked in chunks, which differ at {those}.")
    if history.corrections:
        found.append(f"It was corrected by hand in {count(len(history.corrections), 'frame')}.")
    if missing := [part for part in history.parts if part.frames_absent]:
        rows = sum(part.frames_absent for part in missing)
        over = count(rows, "frame" if len(missing) == 1 else "row")
        said = "Absent" if any(part.vanishes for part in missing) else "Marked as absent"
        found.append(f"{said}: {names([part.name for part in missing])}, in {over}.")
    return " ".join(found)


def to_look_at(table: Trajectory, history: RunHistory, clock: Clock) -> list[tuple[int, str]]:
    """Frames to look at first, as the run names them, each with the words: the longest stretches in which a part is
    called lost, and the frame of the lowest confidence where that is low.
    """
    found = []
    for first, last in sorted(sorted(history.episodes, key=lambda one: one.first - one.last)[:3]):
        lost = dict.fromkeys(span.name for span in history.spans if span.first <= last and span.last >= first)
        frames = f"{first} to {last}" if last > first else str(first)
        found.append(
            (first, f"{at_clock(clock.at(first))}, frame{'s' * (last > first)} {frames}: {names([*lost], 3)} lost")
        )
    if history.worst is not None:
        rows = table.at(history.worst)
        mean = mean_confidence(rows.confidence[np.isfinite(rows.confidence) & (rows.status != "init")])
        if mean < LOW:
            at = f"{at_clock(clock.at(history.worst))}, frame {history.worst}"
            found.append((history.worst, f"{at}: the lowest confidence, {number(mean)}"))
    return found


def confidence_of(table: Trajectory) -> float | None:
    """The mean confidence of all rows after the start, also of rows called lost; None without confidences."""
    sure = table.confidence[np.isfinite(table.confidence) & (table.status != "init")]
    return float(sure.mean()) if sure.size else None


def _trust(known: bool, mean: float) -> str:
    """What the mean confidence says of the rows."""
    if not known:
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
        one = table.of_target(target)[0]
        known = np.flatnonzero(one.identity != "")
        if not known.size:
            continue
        name, sure = str(one.identity[known[-1]]), float(one.identity_prob[known[-1]])
        found = f"{f'{target} is named' if len(table.targets) > 1 else 'It is named'} {name} at the end"
        if math.isfinite(sure):
            found += f", with a probability of {percent(sure)}"
        passed = table.recognised(target, name)
        if passed is not None:
            found += f"; that passed {SURE:g} in frame {passed:,}, at {at_clock(clock.at(passed))}"
        elif math.isfinite(sure):
            found += f"; that never passed {SURE:g}"
        yield f"{found}."


def reasons(key: KeyFrame, table: Trajectory, history: RunHistory, origin: str) -> list[tuple[str, str, str]]:
    """(kind, heading, words) of each event of a key frame; `origin` is that of the start, as `--box`."""
    rows = table.at(key.frame)
    parts = [history.parts[part].name for part in rows.which.tolist()]
    confidence = dict(zip(parts, rows.confidence.tolist(), strict=True))
    known = rows.confidence[np.isfinite(rows.confidence)]
    mean = number(float(known.mean()) if known.size else None)

    def words(event: Event) -> tuple[str, str]:
        match event.kind:
            case "start":
                return "Start", f"placed by {_DETECTORS.get(origin) or Path(origin).name or origin}"
            case "corrected":
                given, absent = event.corrected[1:] if event.corrected else ((), ())
                gone = f"{_are(absent, 5)} absent" if absent else ""
                return "Corrected by hand", "; ".join(filter(None, (names(given, 5), gone)))
            case "seam":
                share = None if event.seam is None else event.seam.agreement
                agree = f"they agree in {percent(share)} of the frames that both have"
                return "Two chunks differ", "none of the frames is in both" if share is None else agree
            case "hidden":
                covered = [
                    f"{s.name} for {lasting(s.seconds)} (confidence {number(confidence.get(s.name))})"
                    for s in event.spans
                ]
                return "Hidden", names(covered, 5)
            case "lost":
                lost = [f"{s.name} (confidence {number(confidence.get(s.name))})" for s in event.spans]
                return "Called lost", names(lost, 5)
            case "back":
                back = [(s.name, lasting(s.seconds), number(confidence.get(s.name))) for s in event.spans]
                return "No longer called lost", names([f"{name} after {s} (confidence {c})" for name, s, c in back], 5)
            case "opening" | "smile" | "blink":
                return {"opening": "Mouth open widest", "smile": "Widest smile"}.get(event.kind, "Blink"), event.words
            case "worst":
                return "Lowest confidence", mean + (f", the mean over {len(parts):,} parts" if len(parts) > 1 else "")
            case _:
                ends = [(kind, [parts[i] for i in np.flatnonzero(rows.status == kind)]) for kind in ("lost", "absent")]
                words = {"lost": "called lost", "absent": "absent"}
                found = "; ".join(f"{words[kind]}: {names(those, 5)}" for kind, those in ends if those)
                return "End", found or ("not called lost" if len(parts) == 1 else "no part is called lost")

    return [(event.kind, *words(event)) for event in key.events]


def _are(those: Sequence[str], most: int = 8) -> str:
    return f"{names(those, most)} {'is' if len(those) == 1 else 'are'}"
