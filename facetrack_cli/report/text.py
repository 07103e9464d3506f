"""How the report says things: durations, shares, lists of names, the summary's sentences."""

from __future__ import annotations

import math
from collections.abc import Sequence

from facetrack_cli.core.numbers import clock as at_clock
from facetrack_cli.report.events import Clock, Event, Story
from facetrack_cli.trajectory.header import Header
from facetrack_cli.trajectory.trajectory import Trajectory

__all__ = ["at_clock", "count", "ended", "lasting", "names", "number", "percent", "rate", "sentences", "why"]


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
    """A share as a percentage, which is 0 or 100 only if it is exactly that."""
    if share is None or not math.isfinite(share):
        return "–"
    if share in (0, 1):
        return f"{100 * share:.0f}\u00a0%"
    return f"{100 * min(max(share, 0.001), 0.999):.1f}\u00a0%"


def number(value: float | None, decimals: int = 2) -> str:
    """A figure, or a dash where there is none."""
    return "–" if value is None or not math.isfinite(value) else f"{value:.{decimals}f}"


def names(those: Sequence[str], most: int = 8) -> str:
    """`a, b and c`; of many, the first and how many more."""
    if len(those) > most:
        return f"{', '.join(those[: most - 1])} and {len(those) - most + 1} more"
    return " and ".join(filter(None, (", ".join(those[:-1]), *those[-1:])))


def ended(header: Header) -> tuple[str, bool]:
    """How the run ended, and whether that is as it should."""
    if header.stopped in ("interrupted", "terminated"):
        return f"The run was {header.stopped} before its end.", False
    if header.stopped:
        return f"The run stopped at an error: {header.stopped}", False
    if header.complete is None:
        return "The end of the trajectory is missing: the run did not close it.", False
    if not header.complete:
        return "The run is incomplete: frames that were asked for are missing.", False
    return "The run is complete.", True


def sentences(table: Trajectory, header: Header, clock: Clock, story: Story) -> str:
    """The run in words: what was tracked, for how long, how often it was lost."""
    frames, one = len(clock.frames), len(story.parts) == 1
    targets = table.targets
    whose = targets[0] if len(targets) == 1 else count(len(targets), "target")
    what = whose if one else f"{count(len(story.parts), 'part')} of {whose}"
    told = [
        f"The recipe {header.recipe_name} followed {what} in {header.clip_name} over {count(frames, 'frame')}, "
        f"{lasting(clock.duration)}."
    ]
    lost = [part.name for part in story.parts if part.spans]
    gone = story.lost_at_end
    missing = [part.name for part in story.parts if part.frames_absent]
    absent = story.absent_at_end
    if not any(part.told for part in story.parts):
        told.append("The tracker does not say when it is lost.")
    elif not lost:
        told.append("It was never called lost." if one else "No part was ever called lost.")
    else:
        n = len(story.episodes)
        times = {1: "one stretch", 2: "two stretches"}.get(n, count(n, "stretch", "stretches"))
        who = "It" if one else "At least one part"
        those = "" if one else f": {names(lost)}"
        share = f"{count(story.frames_lost, 'frame')} ({percent(story.frames_lost / frames)})"
        told.append(f"{who} was lost in {share}, in {times}{those}.")
        end = f"{_are(gone)} lost" if gone else f"{'every other' if absent else 'every'} part is tracked"
        if not one or not absent:
            told.append(f"In the last frame {('it is lost' if gone else 'it is tracked') if one else end}.")
    if story.corrections:
        told.append(f"It was put right by hand in {count(len(story.corrections), 'frame')}.")
    if missing:
        most = sum(part.frames_absent for part in story.parts)
        over = count(most, "frame" if len(missing) == 1 else "row")
        told.append(f"Said to be absent: {names(missing)}, in {over}.")
    return " ".join(told)


def _are(those: Sequence[str]) -> str:
    return f"{names(those)} {'is' if len(those) == 1 else 'are'}"


def rate(header: Header) -> str:
    """The clip's frame rate."""
    nominal = f"{header.source.fps:.6g} frames/s"
    return f"{nominal} on average, at a varying rate" if header.variable_fps else nominal


def why(
    event: Event,
    confidence: dict[str, float],
    mean: float,
    origin: str,
    gone: Sequence[str],
    parts: int,
    absent: Sequence[str] = (),
) -> tuple[str, str]:
    """(heading, words) of an event of a frame; `confidence` is that of each part in it, `mean` that of all.

    `gone` are the parts lost in it, `absent` those said not to be there.
    """
    sure = [f"{s.name} (confidence {number(confidence.get(s.name))})" for s in event.spans]
    match event.kind:
        case "start":
            return "Start", f"placed by {origin}"
        case "corrected":
            put = event.corrected
            assert put is not None
            words = [names(put.given, 5)] if put.given else []
            words += [f"{names(put.absent, 5)} {'is' if len(put.absent) == 1 else 'are'} absent"] if put.absent else []
            return "Put right by hand", "; ".join(words)
        case "lost":
            return "Lost", names(sure, 5)
        case "back":
            back = [
                f"{s.name} after {lasting(s.seconds)} (confidence {number(confidence.get(s.name))})"
                for s in event.spans
            ]
            return "Tracked again", names(back, 5)
        case "worst":
            return (
                "Lowest confidence",
                f"{number(mean)}, the mean over {count(parts, 'part')}" if parts > 1 else number(mean),
            )
        case _:
            ends = [f"lost: {names(gone, 5)}"] if gone else []
            ends += [f"absent: {names(absent, 5)}"] if absent else []
            return "End", "; ".join(ends) or ("tracked" if parts == 1 else "all parts tracked")
