"""facetrack fix and people: correct a finished run, and who is in a film."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Command, flag, frame_at, moment, option, page_options, refuse, say, words, working
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.run_folder.finished import Run
    from facetrack_cli.trajectory.people import People, Tracks
    from facetrack_cli.trajectory.views import Clock

    Change: TypeAlias = tuple[str, Callable[[Tracks], Tracks]]

Words: TypeAlias = tuple[tuple[str, ...], ...]
_NAMES = words("A=B", "([^=]*)=(.*)", "give two names, as person_3=person_1")
_NAME = words("A=NAME", "([^=]*)=(.*)", "give two names, as person_3=person_1")
_TRACK = words("A@TIME=B", "(.*)@([^@=]*)=([^@]*)", "give a name, a time and a name, as person_2@1:23=person_1")


@click.command()
@click.argument("folder", type=options.RUN)
@options.clip
@option("--init", type=options.FILE, help="No page: take the corrections of this init file, and no others.")
@option(
    "--import",
    "imported",
    type=options.FILE,
    help="No page: add what was corrected in CVAT (XML), Label Studio (JSON) or ELAN.",
)
@option(
    "--person", type=moment("NAME@TIME"),
    help="Of a film: the points of this person in the shot at a time (1:23, or 2075f).",
)  # fmt: skip
@flag("--no-video", help="Leave annotated.mp4 as it is.")
@page_options
@flag("--quiet", "-q", help="With --init: say nothing but errors.")
def fix_command(
    folder: Path, clip: Path | None, init: Path | None, imported: Path | None, person: tuple[str, str] | None,
    no_video: bool, page: options.Page, quiet: bool,
) -> int:  # fmt: skip
    """Correct a finished run, on a page.

    RUN_DIR is the folder that facetrack run wrote, with JSON. The page shows the clip with its trajectory, and leads
    from one doubtful frame to the next. Where a part is wrong, drag it to its place, or mark it as absent: the target
    is tracked again from there to its next correction, and every other row stays the same, to the byte. Save writes the
    trajectories and the annotated video again, and RUN_DIR/corrected.init.yaml, with which facetrack run makes the same
    trajectory. The page goes on after it, until Done.

    The rows of a smoothed run are given the whole clip, and targets that exclude each other move each other: at Save
    all of such a run is tracked again.

    With --import, the corrections are what differs from the run in a file of an annotation tool, to which facetrack
    export --to cvat, labelstudio or eaf has brought it: parts that were moved, and parts that were marked as not
    visible. Of ELAN's .eaf the segments of the tiers seen and absent count, and of a film without --person the
    participants, who are the names of its people.

    The video is drawn from the rows, which do not hold the particles: they are no longer in it.

    \b
    Examples:
      facetrack fix out
      facetrack fix out --clip /archive/clip.mp4 --open
      facetrack fix out --init corrected.init.yaml --no-video
      facetrack fix out --import annotations.xml
      facetrack fix film --person Eileen@0:03
    """
    from facetrack_cli.editor.fix_session import FixSession
    from facetrack_cli.editor.history import Fixer
    from facetrack_cli.run_folder.finished import check_size, open_run
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.reader import PEOPLE
    from facetrack_cli.video.seek import Frames

    file = init or imported
    both = init is not None and imported is not None
    refuse(
        (both, "--import adds to the run's corrections, --init replaces them; leave one of them out"),
        (quiet and file is None, "--quiet goes with --init and --import; the page's address must be said"),
    )
    if file is not None:
        page.refuse(f"leave it or {'--init' if init else '--import'} out")
    if imported is not None and imported.suffix.lower() == ".eaf" and not person and (folder / PEOPLE).is_file():
        return _rename(folder, clip, imported, quiet, video=not no_video)
    opened = _track(folder, clip, *person) if person else open_run(folder, clip)
    with Frames(opened.clip, fps=opened.fps, stream=opened.header.source.stream) as frames:
        check_size(opened, frames.size)
        with contextlib.closing(Fixer(opened, frames.read)) as fixer:
            if file is not None:
                return _apply(fixer, file, quiet, adds=init is None, video=not no_video)
            with Stop().listening() as stop:
                return page.serve(FixSession(fixer, frames, video=not no_video), stop)


def _track(folder: Path, clip: Path | None, name: str, at: str) -> Run:
    """The track of a person of a film."""
    from facetrack_cli.editor.save import open_track
    from facetrack_cli.runs.people import people_in, rows_in
    from facetrack_cli.trajectory.views import Clock

    return open_track(folder, name, frame_at(at, Clock(rows_in(folder), people_in(folder).fps)), clip)


def _apply(fixer: Fixer, file: Path, quiet: bool, *, adds: bool, video: bool) -> int:
    """Take the corrections of --init or --import, and save; the exit code."""
    from facetrack_cli.editor.history import corrections_of, merged
    from facetrack_cli.editor.import_annotations import imported_corrections
    from facetrack_cli.editor.save import save
    from facetrack_cli.trajectory.reader import UNSAVED

    folder = fixer.run.folder
    unsaved, left_out = folder / UNSAVED, list[str]()

    def note(line: str) -> None:
        left_out.append(line)
        if not quiet:
            say(f"facetrack: warning: {line}")

    if unsaved.is_file() and not (file.is_file() and file.samefile(unsaved)):
        raise UsageError(
            f"{unsaved}: corrections that were not saved are there; facetrack fix {folder} goes on with them, "
            f"--init {unsaved} takes them; or remove it"
        )
    if not adds:
        corrections = corrections_of(file, fixer.run)
    elif not (corrections := imported_corrections(file, fixer.run, fixer.rows, note)):
        say(f"facetrack: {file} is {'otherwise ' * bool(left_out)}as the run has it; nothing was written")
        return ExitCode.DONE
    else:
        parts, find = fixer.run.parts, fixer.find
        corrections = tuple(merged(fix, find(fix.frame, fix.target), parts[fix.target]) for fix in corrections)
    with working(quiet, folder.name or str(folder), f"{folder} is as it was") as (stop, shown):
        (fixer.put if adds else fixer.apply)(corrections, report=shown.update, stop=stop)
        if adds:
            frames = ", ".join(str(frame) for frame in sorted({correction.frame for correction in corrections})[:10])
            count = f"{len(corrections)} correction{'s' if len(corrections) > 1 else ''}, in frames {frames}"
            shown.say(f"{file}: {count}; export the run again before more is corrected there")
        shown.begin("saving")
        for line in save(fixer, video=video, report=shown.update, stop=stop):
            shown.say(line)
    return ExitCode.DONE


def _rename(folder: Path, clip: Path | None, file: Path, quiet: bool, *, video: bool) -> int:
    """Take the names that a film's people have in a file of ELAN; the exit code."""
    from facetrack_cli.editor.import_annotations import renames
    from facetrack_cli.runs.people import people_in, recast, rows_in
    from facetrack_cli.trajectory.people import rename
    from facetrack_cli.trajectory.reader import clip_of

    at = clip or clip_of(rows_in(folder))
    names = renames(file, people_in(folder).names, at.name if at else "")
    if not names:
        say(f"facetrack: {file}: the names are the run's, nothing was written; segments count with --person NAME@TIME")
        return ExitCode.DONE
    changes = [(f"rename {old}={name}", partial(rename, name=old, to=name)) for old, name in names.items()]
    with working(quiet, folder.name or str(folder), f"{folder} is as it was") as (stop, shown):
        recast(folder, changes, clip=clip, video=video, report=shown.looked, stop=stop)
        shown.say(f"{folder}: {', '.join(f'{old} is {name}' for old, name in names.items())}")
    return ExitCode.DONE


@click.command(cls=Command, basic="merge split rename give save edit clip no_video as_json as_csv overwrite quiet")
@click.argument("folder", type=options.RUN)
@option("--merge", type=_NAMES, multiple=True, help="A is B: both are one person, under the name of B.")
@option("--split", type=moment("A@TIME"), multiple=True, help="From that time on (1:23, or 2075f) A is somebody else.")
@option("--rename", type=_NAME, multiple=True, help="The name of A.")
@option(
    "--save", type=options.NPZ,
    help="Save what these people look like, for run --faces all --gallery FILE.npz.",
)  # fmt: skip
@option(
    "--give", type=_TRACK, multiple=True,
    help="The track of A at that time is of B; B may be A, which settles a doubt.",
)  # fmt: skip
@flag("--page", "edit", help="Correct the cast on a page in the browser.")
@page_options
@options.clip
@flag("--no-video", help="Do not draw annotated.mp4 again.")
@flag("--json", "as_json", help="Print people.json.")
@flag("--csv", "as_csv", help="Print when each person is seen, a row an interval.")
@flag("--overwrite", help="Replace the file of --save.")
@flag("--quiet", "-q", help="Say nothing but errors, and print no table.")
def people_command(
    folder: Path, merge: Words, split: Words, rename: Words, save: Path | None, give: Words, edit: bool,
    page: options.Page, clip: Path | None, no_video: bool, as_json: bool, as_csv: bool, overwrite: bool, quiet: bool,
) -> int:  # fmt: skip
    """Show who is in a film, and correct it.

    RUN_DIR is a folder that facetrack run --faces all wrote. For each person it says how long, in how many tracks, and
    how sure. A correction writes the rows, the pictures and the video of the run again.

    \b
    Examples:
      facetrack people out
      facetrack people out --rename person_1=Anna --rename person_2=Ben
      facetrack people out --merge person_3=person_1
      facetrack people out --page --open
      facetrack people out --split person_2@1:23
      facetrack people out --json | jq '.people[].name'
      facetrack people out --csv > intervals.csv
      facetrack people out --save people.npz
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.runs.people import people_in, recast, rows_in, save_looks
    from facetrack_cli.trajectory.views import Clock

    refuse((as_json and as_csv, "--json and --csv both go to standard output; give one of them"))
    flags: dict[str, object] = {"--split": split, "--give": give, "--merge": merge, "--rename": rename}
    flags |= {"--save": save is not None, "--json": as_json, "--csv": as_csv}
    also = ", ".join(name for name, value in flags.items() if value)
    refuse((edit and also, f"--page corrects on the page alone; give {also} in a command without it"))
    people = people_in(folder)
    clock = Clock(rows_in(folder) if split or give else None, people.fps)
    changes = _changes(clock, split, give, merge, rename)
    if edit:
        return _serve_cast(folder, clip, page, video=not no_video)
    page.refuse("give --page")
    if save is not None:
        check_new(save, overwrite=overwrite)
    name = folder.name or str(folder)
    if changes:
        with working(quiet, name, f"{folder} is as it was") as (stop, shown):
            people = recast(folder, changes, clip=clip, video=not no_video, report=shown.looked, stop=stop)
    if save is not None:
        left = f"{save} was not written" + "; the changes are" * bool(changes)
        with working(quiet, name, left) as (stop, shown):
            shown.say(f"{save}: {', '.join(save_looks(folder, save, clip, shown.looked, stop))}")
    if as_json or as_csv:
        click.echo(people.text().decode() if as_json else _intervals(people), nl=False)
    elif not quiet:
        _show(people, Clock(rows_in(folder), people.fps))
    return 0


def _serve_cast(folder: Path, elsewhere: Path | None, page: options.Page, *, video: bool) -> int:
    """Serve the page until it is saved or stopped; the exit code."""
    from facetrack_cli.editor.fix_session import CastSession
    from facetrack_cli.runs.people import film_of, people_in, rows_in
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.video.seek import Frames

    clip, how = film_of(people_in(folder), rows_in(folder), elsewhere)
    if clip is None:
        raise UsageError(f"{folder}: does not name its clip; give it with --clip")
    with Frames(clip, **how) as frames, Stop().listening() as stop:
        return page.serve(CastSession(folder, frames, clip, video=video), stop)


def _changes(clock: Clock, split: Words, give: Words, merge: Words, rename: Words) -> list[Change]:
    from facetrack_cli.trajectory import people as edits

    return [
        *((f"split {a}@{at}", partial(edits.split, name=a, frame=frame_at(at, clock))) for a, at in split),
        *((f"give {a}@{at}={b}", partial(edits.give, name=a, frame=frame_at(at, clock), to=b)) for a, at, b in give),
        *((f"merge {a}={b}", partial(edits.merge, name=a, into=b)) for a, b in merge),
        *((f"rename {a}={b}", partial(edits.rename, name=a, to=b)) for a, b in rename),
    ]


def _intervals(people: People) -> str:
    """The frames in which people are seen, and their times in s, in the order of time."""
    from facetrack_cli.core.numbers import csv_text

    each = ((person.name, zip(person.intervals, person.times, strict=True)) for person in people.people)
    spans = sorted((*frames, name, *times) for name, both in each for frames, times in both)
    rows = ([name, first, stop - 1, f"{begin:.3f}", f"{end:.3f}"] for first, stop, name, begin, end in spans)
    return csv_text(["person", "first_frame", "last_frame", "begin_s", "end_s"], rows)


def _show(people: People, seconds: Clock) -> None:
    """The cast as a table, and what is in doubt."""
    from facetrack_cli.core.numbers import clock
    from facetrack_cli.evaluation.summary import Sheet

    tracks = [track.person for track in people.tracks]
    rows = tuple(
        (
            person.name, f"{person.seconds:.1f}", str(len(person.intervals)), str(tracks.count(person.name)),
            clock(seconds.at(person.intervals[0][0])), f"{person.p:.2f}", "photograph" if person.photograph else "",
        )
        for person in people.people
    )  # fmt: skip
    notes = [
        f"{clock(seconds.at(track.first))} (frame {track.first}): {track.person} with P = {track.p:.2f}, "
        f"{track.other or 'somebody new'} with {track.p_other:.2f}"
        for track in people.doubts
    ]
    title = f"{len(people.people)} people in {len(people.shots)} shots" + ("; in doubt:" if notes else "")
    heads = ("person", "seconds", "times", "tracks", "first seen", "P", "")
    Sheet(title, heads, rows, tuple(notes), left=(0, 6)).show()
