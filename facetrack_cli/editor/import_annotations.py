"""Corrections from an annotation tool: where its export differs from the rows of the run that were exported.

Of a file of ELAN the tiers `seen` and `absent` of a target count: where they differ from what `export` writes of the
rows, the target, or the parts that the text names, come or go. Another participant is another name of a film's person.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array, Correction, Mask, TargetStart
from facetrack_cli.engine.corrected import all_or, correctable_parts
from facetrack_cli.run_folder.finished import Run
from facetrack_cli.trajectory.clock import every_frame, frame_milliseconds
from facetrack_cli.trajectory.formats.annotation import read_cvat, read_labelstudio
from facetrack_cli.trajectory.formats.eaf import Tier, read_tiers, seen_in, spans_of
from facetrack_cli.trajectory.select import hide_outside
from facetrack_cli.trajectory.trajectory import DECIMALS, UNSEEN, Trajectory

MOVED: Final = 0.05  # pixels: CVAT keeps two decimals
Given: TypeAlias = "dict[tuple[int, str], dict[str, tuple[float, ...] | None]]"


def imported_corrections(path: Path, run: Run, rows: Trajectory) -> tuple[Correction, ...]:
    """The corrections in which the keyframes of an annotation tool's file differ from `rows` of a run; () for none.

    A visible part is placed by hand if its place is more than MOVED pixels from its row, if that is not seen, and in
    the first frame after it was not visible. A part that is not visible, and whose row is seen, is absent from there
    on. InputError for a file that cannot be read, and for a part that the run lacks.
    """
    if path.suffix.lower() == ".eaf":
        tiers = [pair for tier in read_tiers(path, run.clip.name) if (pair := _whose(tier, rows.targets))]
        if not tiers:
            there = f"has no tier seen or absent of {', '.join(rows.targets)}"
            raise InputError(f"{path}: {there}; add a tier absent@{rows.targets[0]} there")
        told = _presence(path, tiers, run, rows)
        return tuple(_correction(*key, parts, run) for key, parts in sorted(told.items()))
    found, rows = read_annotations(path, run, rows), hide_outside(rows, run.header.source.size)
    given: Given = defaultdict(dict)
    for one in found.parts:
        row = rows.find(one.target, one.part)
        if row is None:
            there = ", ".join("/".join(pair) if pair[1] != BOX else pair[0] for pair in rows.names)
            raise InputError(f"{path}: {one.name} is not in the run, which has {there}; correct the label")
        # the box of a head that carries points is not absent by itself
        carries = one.part == BOX and len(run.parts[one.target]) > 1
        for frame, place in _changes(one.take(one.status != "absent") if carries else one, row):
            given[frame, one.target][one.part] = place
    return tuple(_correction(*key, parts, run) for key, parts in sorted(given.items()))


def renames(path: Path, names: Sequence[str], clip: str) -> dict[str, str]:
    """The new names of a film's people, by the ones that they have: a tier's participant, where that is another."""
    found: dict[str, str] = {}
    for tier in read_tiers(path, clip):
        _, _, name = tier.name.partition("@")
        other = tier.participant not in ("", name)
        if name in names and other and found.setdefault(name, tier.participant) != tier.participant:
            both = f"{found[name]} and {tier.participant}"
            raise InputError(f"{path}: the tiers of {name} have the participants {both}; give them one")
    return found


def _whose(tier: Tier, names: Sequence[str]) -> tuple[str, str, Tier] | None:
    """The kind of a tier that is ours, `seen` or `absent`, and its target; a second one has a number at its end."""
    kind, _, name = tier.name.partition("@")
    target = next((one for one in (tier.participant, name) if one in names), None)
    return (kind, target, tier) if kind in ("seen", "absent") and target is not None else None


def _presence(path: Path, tiers: Sequence[tuple[str, str, Tier]], run: Run, rows: Trajectory) -> Given:
    """What comes and goes, by frame and target: each part to its place (x, y) or box, or to None, absent."""
    begin, end = frame_milliseconds(rows)
    frames = rows.frames
    middles = np.array([(begin[frame] + end[frame]) / 2 for frame in frames.tolist()])
    given: Given = defaultdict(dict)
    for target in dict.fromkeys(target for _, target, _ in tiers):
        parts = {one.part: one for one in rows.of_target(target)}
        now = {part: np.isin(frames, one.frame[one.status == "absent"]) for part, one in parts.items()}
        then = {part: mask.copy() for part, mask in now.items()}
        own = {"seen": [(a, b, "") for a, b in seen_in([*parts.values()]) or [(run.first, run.last)]]}
        own["absent"] = spans_of([one.take(~one.vanished) for one in parts.values()], "absent")
        for kind in ("seen", "absent"):
            theirs = [tier for what, of, tier in tiers if (what, of) == (kind, target)]
            if not theirs:
                continue
            ours = _marked([(begin[a], end[b], text) for a, b, text in own[kind]], middles, parts, path)
            notes = [note for tier in theirs for note in tier.notes]
            told = _marked(notes, middles, parts, path)
            for part, mask in told.items():
                changed = mask != ours[part]
                then[part][changed] = mask[changed] if kind == "absent" else ~mask[changed]
        for part in correctable_parts(run.parts[target]):
            off = then[part] != now[part]
            # where it differs, and where it is as before again
            turns = {at for span in spans(off) for at in span if at < len(frames)}
            for at in sorted(turns):
                if off[at] or then[part][at] != then[part][at - 1]:
                    frame = int(frames[at])
                    given[frame, target][part] = None if then[part][at] else _place(path, parts[part], frame)
    return given


def _marked(
    notes: Sequence[tuple[int, int, str]], middles: Array, parts: Mapping[str, object], path: Path
) -> dict[str, Mask]:
    """Of each part (T,) the frames whose middle lies in an annotation that names it, or names none."""
    found = {part: np.zeros(len(middles), np.bool_) for part in parts}
    for begin, end, text in notes:
        named = [name.strip() for name in text.split(",")] if text not in ("", "seen", "absent") else [*parts]
        for part in named:
            if part not in found:
                there = f"there are {', '.join(parts)}, or absent, for all"
                raise InputError(f"{path}: {text!r} at {begin / 1000:.3f} s: {part!r} is no part; {there}")
            found[part] |= (middles >= begin) & (middles < end)
    return found


def _place(path: Path, one: Trajectory, frame: int) -> tuple[float, ...]:
    """Where a part is that comes back: where its row has it."""
    at = one.row(frame)
    place = () if at is None else one.boxes[at].tolist() if one.part == BOX else (float(one.x[at]), float(one.y[at]))
    if not place or not np.isfinite(place).all():
        where = "and the run has no place of it; place it there on the page first: facetrack fix"
        raise InputError(f"{path}: {one.name} is there in frame {frame}, {where}")
    return tuple(round(value, DECIMALS["x"]) for value in place)


def read_annotations(path: Path, run: Run, rows: Trajectory) -> Trajectory:
    """The file of an annotation tool: CVAT's XML, or Label Studio's JSON. InputError if it is neither."""
    begins = ""
    if path.is_file():
        with path.open("rb") as file:
            begins = file.read(256).decode("utf-8-sig", "replace").lstrip()
    if begins[:1] in ("[", "{"):
        return read_labelstudio(path, run.header.source.size, every_frame(rows), fps=run.header.source.fps)
    return read_cvat(path)


def _changes(one: Trajectory, row: Trajectory) -> list[tuple[int, tuple[float, ...] | None]]:
    """Frames in which a part is corrected: to its place (x, y), or box, or to None, absent."""
    found: list[tuple[int, tuple[float, ...] | None]] = []
    gone = False  # by a correction of these
    boxes, places = one.boxes.tolist(), np.stack([one.x, one.y], axis=1).tolist()
    for n in np.flatnonzero(one.by_hand).tolist():
        frame, at = int(one.frame[n]), row.row(int(one.frame[n]))
        known = at is not None and bool(np.isfinite(row.x[at] + row.y[at]))
        lost = not known or row.status[at] in UNSEEN
        if one.status[n] == "absent":
            if not lost and not gone:
                found.append((frame, None))
                gone = True
            continue
        box = one.part == BOX
        place = tuple(round(value, DECIMALS["x"]) for value in (boxes[n] if box else places[n]))
        there = (row.boxes[at] if box else np.array([row.x[at], row.y[at]])) if known else np.array(np.nan)
        if gone or not np.abs(there - place).max() <= MOVED or (lost and one.status[n] == "visible"):
            found.append((frame, place))
        gone = False
    return found


def _correction(frame: int, target: str, parts: dict[str, tuple[float, ...] | None], run: Run) -> Correction:
    absent = all_or([part for part, place in parts.items() if place is None], run.parts[target])
    if absent is True:
        return Correction(frame, target, absent=True)
    box = parts.get(BOX)
    points = {part: (place[0], place[1]) for part, place in parts.items() if place is not None and part != BOX}
    given = TargetStart(box=None if box is None else (box[0], box[1], box[2], box[3]), points=points)
    return Correction(frame, target, given, absent=absent)
