"""Corrections from an annotation tool: where its export differs from the rows of the run that were exported.

Of a file of ELAN the tiers `seen` and `absent` of a target count: where they differ from what `export` writes of the
rows, the target, or the parts that the text names, come or go. Another participant is another name of a film's person.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from facetrack_cli.core.errors import InputError, reading
from facetrack_cli.core.numbers import spans
from facetrack_cli.core.types import BOX, Array, Correction, Mask
from facetrack_cli.engine.corrected import all_or, correctable_parts
from facetrack_cli.run_folder.manifest import read_run
from facetrack_cli.runs.finished import Run
from facetrack_cli.trajectory.formats.annotation import Tier, read_cvat, read_labelstudio, read_tiers, seen_in, spans_of
from facetrack_cli.trajectory.trajectory import DECIMALS, UNSEEN, Trajectory, hide_outside
from facetrack_cli.trajectory.views import every_frame, frame_milliseconds

MOVED: Final = 0.05  # pixels: CVAT keeps two decimals
Place: TypeAlias = "tuple[float, ...] | None"  # of a part: (x, y), or a box; None where it is absent
Changes: TypeAlias = "dict[tuple[int, str], dict[str, Place]]"  # of parts, by frame and target


def imported_corrections(
    path: Path, run: Run, rows: Trajectory, note: Callable[[str], None] = lambda line: None
) -> tuple[Correction, ...]:
    """The corrections in which the keyframes of an annotation tool's file differ from `rows` of a run; () for none.

    A visible part is placed by hand if its place is more than MOVED pixels from its row, if that is not seen, and in
    the first frame after it was not visible. A part that is not visible, and whose row is seen, is absent from there
    on. `note` gets a line on parts that no correction places, and that were changed: they are left out. Of one track of
    a film only that person in those frames counts. InputError for a file that cannot be read, for a part that the run
    lacks, and for a film's person who is not in the file.
    """
    if path.suffix.lower() == ".eaf":
        changes = _presence(path, run, rows)
    else:
        changes = _places(path, run, hide_outside(rows, run.header.source.size), read_annotations(path, run, rows))
    corrections, gone, vain = list[Correction](), set[str](), dict[str, None]()
    for (frame, target), parts in sorted(changes.items()):
        can = (*correctable_parts(run.parts[target]), BOX)
        if placed := {part: place for part, place in parts.items() if part in can}:
            absent = all_or([part for part, place in placed.items() if place is None], run.parts[target])
            box: Any = placed.pop(BOX, None) if absent is not True else None
            points = {part: (place[0], place[1]) for part, place in placed.items() if place is not None}
            points = {} if absent is True else points
            corrections.append(Correction(frame, target, box, points, absent=absent))
            gone = gone | {target} if corrections[-1].absent is True else gone - {target}
        if target not in gone:  # all of it is absent
            vain |= dict.fromkeys(f"{target}/{part}" for part in parts if part not in can)
    if vain:
        note(f"{path}: {', '.join(vain)}: no correction places {'these' if len(vain) > 1 else 'this'}; left out")
    return tuple(corrections)


def _places(path: Path, run: Run, rows: Trajectory, annotated: Trajectory) -> Changes:
    """Where parts are by keyframes that differ from the rows."""
    changes: Changes = defaultdict(dict)
    ours = [part for part in annotated.parts if part.target in run.parts or not run.film]
    if not ours:
        whose = ", ".join(annotated.targets[:10])
        raise InputError(f"{path}: has no track of {rows.targets[0]}, but of {whose}; correct the labels")
    for part in ours:
        row = rows.find(part.target, part.part)
        if row is None:
            there = ", ".join("/".join(pair) if pair[1] != BOX else pair[0] for pair in rows.names)
            raise InputError(f"{path}: {part.name} is not in the run, which has {there}; correct the label")
        # the box of a head that carries points is not absent by itself
        carries = part.part == BOX and len(run.parts[part.target]) > 1
        kept = part.take(part.status != "absent") if carries else part
        if run.film:
            kept = kept.between(run.first, run.last + 1)
        can = (*correctable_parts(run.parts[part.target]), BOX)
        for frame, place, moved in _moves(kept, row):
            if moved or part.part in can:
                changes[frame, part.target][part.part] = place
    return changes


def renames(path: Path, names: Sequence[str], clip: str) -> dict[str, str]:
    """The new names of a film's people, by the ones that they have: a tier's participant, where that is another."""
    new: dict[str, str] = {}
    for tier in read_tiers(path, clip):
        name = tier.name.partition("@")[2]
        other = tier.participant not in ("", name)
        if name in names and other and new.setdefault(name, tier.participant) != tier.participant:
            both = f"{new[name]} and {tier.participant}"
            raise InputError(f"{path}: the tiers of {name} have the participants {both}; give them one")
    return new


def _presence(path: Path, run: Run, rows: Trajectory) -> Changes:
    """What comes and goes by the tiers `seen` and `absent` of targets. A second tier has a number at its end."""
    tiers: dict[tuple[str, str], list[Tier]] = defaultdict(list)
    for tier in read_tiers(path, run.clip.name):
        kind, _, name = tier.name.partition("@")
        target = next((each for each in (tier.participant, name) if each in rows.targets), None)
        if kind in ("seen", "absent") and target is not None:
            tiers[target, kind].append(tier)
    if not tiers:
        there = f"has no tier seen or absent of {', '.join(rows.targets)}"
        raise InputError(f"{path}: {there}; add a tier absent@{rows.targets[0]} there")
    begin, end = frame_milliseconds(rows)
    frames = rows.frames
    middles = np.array([(begin[frame] + end[frame]) / 2 for frame in frames.tolist()])
    changes: Changes = defaultdict(dict)
    for target in dict.fromkeys(target for target, _ in tiers):
        parts = {part.part: part for part in rows.of_target(target)}
        now = {name: np.isin(frames, part.frame[part.status == "absent"]) for name, part in parts.items()}
        then = {name: mask.copy() for name, mask in now.items()}
        own = {"seen": [(a, b, "") for a, b in seen_in([*parts.values()]) or [(run.first, run.last)]]}
        own["absent"] = spans_of([part.take(~part.vanished) for part in parts.values()], "absent")
        for kind in ("seen", "absent"):
            if theirs := tiers.get((target, kind)):
                ours = _marked([(begin[a], end[b], text) for a, b, text in own[kind]], middles, parts, path)
                notes = [note for tier in theirs for note in tier.notes]
                for name, mask in _marked(notes, middles, parts, path).items():
                    changed = mask != ours[name]
                    then[name][changed] = mask[changed] if kind == "absent" else ~mask[changed]
        can = correctable_parts(run.parts[target])
        for name in run.parts[target]:
            off, gone = then[name] != now[name], then[name]
            # where it differs, and where it is as before again
            for at in sorted({at for span in spans(off) for at in span if at < len(frames)}):
                frame = int(frames[at])
                if name in can and (off[at] or gone[at] != gone[at - 1]):
                    changes[frame, target][name] = None if gone[at] else _place(path, parts[name], frame)
                elif off[at] and name != BOX:
                    changes[frame, target][name] = None
    return changes


def _marked(
    notes: Sequence[tuple[int, int, str]], middles: Array, parts: Mapping[str, object], path: Path
) -> dict[str, Mask]:
    """Of each part (T,) the frames whose middle lies in an annotation that names it, or names none."""
    marked = {part: np.zeros(len(middles), np.bool_) for part in parts}
    for begin, end, text in notes:
        for part in [*parts] if text in ("", "seen", "absent") else [name.strip() for name in text.split(",")]:
            if part not in marked:
                there = f"there are {', '.join(parts)}, or absent, for all"
                raise InputError(f"{path}: {text!r} at {begin / 1000:.3f} s: {part!r} is no part; {there}")
            marked[part] |= (middles >= begin) & (middles < end)
    return marked


def _place(path: Path, part: Trajectory, frame: int) -> Place:
    """Where a part is that comes back: where its row has it."""
    at = part.row(frame)
    place = () if at is None else part.boxes[at] if part.part == BOX else np.array([part.x[at], part.y[at]])
    if not len(place) or not np.isfinite(place).all():
        where = "and the run has no place of it; place it there on the page first: facetrack fix"
        raise InputError(f"{path}: {part.name} is there in frame {frame}, {where}")
    return tuple(round(float(value), DECIMALS["x"]) for value in place)


def read_annotations(path: Path, run: Run, rows: Trajectory) -> Trajectory:
    """The file of an annotation tool: CVAT's XML, or Label Studio's JSON. InputError if it is neither."""
    with reading(path, "name a file of CVAT, Label Studio or ELAN"), path.open("rb") as file:
        begins = file.read(256).decode("utf-8-sig", "replace").lstrip()
    if begins[:1] in ("[", "{"):
        whole = read_run(run.folder) if run.film else rows  # the file has all frames of the film
        return read_labelstudio(path, run.header.source.size, every_frame(whole), fps=run.header.source.fps)
    return read_cvat(path)


def _moves(part: Trajectory, row: Trajectory) -> Iterator[tuple[int, Place, bool]]:
    """The frames in which a part is corrected, its place there, and whether that is another than the row's."""
    gone = False  # by a correction of these
    box = part.part == BOX
    ours, theirs = ((each.boxes if box else np.stack([each.x, each.y], axis=1)) for each in (row, part))
    for n in np.flatnonzero(part.by_hand).tolist():
        frame, at = int(part.frame[n]), row.row(int(part.frame[n]))
        placed = at is not None and bool(np.isfinite(row.x[at] + row.y[at]))
        lost = not placed or row.status[at] in UNSEEN
        if part.status[n] == "absent":
            if not lost and not gone:
                yield frame, None, True
                gone = True
            continue
        place = tuple(round(value, DECIMALS["x"]) for value in theirs[n].tolist())
        there = ours[at] if placed else np.array(np.nan)
        moved = not np.abs(there - place).max() <= MOVED
        if gone or moved or (lost and part.status[n] == "visible"):
            yield frame, place, moved
        gone = False
