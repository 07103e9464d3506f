"""The points of one person of a film in one shot, corrected as those of a clip are.

A track is a run of its own here: its start is its first row, and what was corrected is what its rows say is by hand.
When it is saved, its rows take their place in the film's; who is who stays.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from facetrack_cli.core.errors import InputError
from facetrack_cli.core.types import BOX, Correction, Start, TargetStart
from facetrack_cli.engine.corrected import all_or, correctable_parts
from facetrack_cli.run_folder.finished import Run, recipe_of, run_files, stamp
from facetrack_cli.run_folder.lease import FolderLease
from facetrack_cli.runs.people import ORIGIN, film_of, painted, people_in, rows_in, write_people
from facetrack_cli.runs.plan import Report
from facetrack_cli.runs.signals import Stopped
from facetrack_cli.trajectory.header import read_header
from facetrack_cli.trajectory.people import read_still
from facetrack_cli.trajectory.select import choose
from facetrack_cli.trajectory.trajectory import Trajectory, successive


def open_track(folder: Path, person: str, frame: int, clip: Path | None = None) -> Run:
    """The track of a person in the film of a run that has this frame; `clip` is where the film is now.

    Raises InputError where the person is not seen in the frame, or the film is gone.
    """
    people, whole = people_in(folder), rows_in(folder)
    track = next((one for one in people.tracks if one.person == person and one.first <= frame < one.stop), None)
    if track is None:
        raise InputError(f"{folder}: {person} is not seen in frame {frame}; facetrack people {folder} says who is when")
    where, how = film_of(people, whole, clip)
    if where is None or not where.exists():
        raise InputError(f"{where or folder}: the film is not there; name it with --clip")
    rows = choose(whole, person).between(track.first, track.stop)
    header = read_header(whole)
    recipe = recipe_of(whole.path, whole.header["recipe"], [Path(), folder, folder.parent, where.parent])
    first = {part: rows.parts[k].take(slice(0, 1)) for k, (_, part) in enumerate(rows.names)}
    box: tuple[float, ...] = tuple(first[BOX].boxes[0].round(2).tolist())
    points = {part: (round(float(first[part].x[0]), 2), round(float(first[part].y[0]), 2)) for part in recipe.points}
    at = Start(track.first, {person: TargetStart((box[0], box[1], box[2], box[3]), points)}, ORIGIN)
    start = replace(at, corrections=tuple(_by_hand(rows, person)))
    files = {form: (path, stamp(path)) for form, path in run_files(folder).items()}
    return Run(folder, rows, header, recipe, start, where, how["fps"], files, film=True)


def _by_hand(rows: Trajectory, person: str) -> Iterator[Correction]:
    """What was corrected, by the rows that say so."""
    for frame in sorted({*rows.frame[rows.by_hand].tolist()} - {int(rows.frame[0])}):
        now = rows.at(frame)
        parts = [name for _, name in now.names]
        known = zip(parts, now.status.tolist(), now.x.tolist(), now.y.tolist(), now.by_hand.tolist(), strict=True)
        hand = {part: (status, (x, y)) for part, status, x, y, by_hand in known if by_hand}
        given = {part: place for part, (status, place) in hand.items() if status == "init" and part != BOX}
        absent = [part for part, (status, _) in hand.items() if status == "absent"]
        if given or absent:
            yield Correction(frame, person, TargetStart(points=given), absent=all_or(absent, parts))
        else:
            yield Correction(frame, person, confirmed=all_or([*hand], correctable_parts(parts)))


def save_track(run: Run, rows: Trajectory, *, video: bool, report: Report, stop: Stopped) -> list[str]:
    """Write the film of a run with these rows of one of its tracks; a line on each file. Raises as `save` does."""
    folder, [person] = run.folder, rows.targets
    with FolderLease(folder) as lock:
        people, whole = people_in(folder), rows_in(folder)
        if not any((one.person, one.first, one.stop) == (person, run.first, run.last + 1) for one in people.tracks):
            raise InputError(f"{folder}: who is who was changed meanwhile; open the page again")
        pieces = [choose(whole, name) for name in whole.targets]
        at = whole.targets.index(person)
        before, after = pieces[at].between(0, run.first), pieces[at].between(run.last + 1, int(whole.frame.max()) + 1)
        pieces[at : at + 1] = [one for one in (before, rows, after) if len(one)]
        film = replace(successive(pieces), header=whole.header, path=whole.path)
        told = people.model_copy(update={"corrections": (*people.corrections, f"fix {person}@{run.first}f")})
        stills = {one.still for one in people.people} | {one.still for one in people.tracks}
        pictures = {still: read_still(folder, still) for still in stills if still}
        paint = painted(folder, people, whole, run.clip) if video else None
        notes = write_people(folder, film, told, pictures, paint, report, stop, lock)
    return [*(f"{path}: written" for path, _ in run.files.values()), *notes]
