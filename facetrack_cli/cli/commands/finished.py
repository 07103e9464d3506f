"""facetrack fix, people, report, plot and export: what is corrected in a finished run, and what is made of it."""

from __future__ import annotations

import inspect
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import Command, flag, frame_at, moment, option, refuse, say, words, working
from facetrack_cli.core.errors import ExitCode, InputError, UsageError
from facetrack_cli.trajectory.formats import ALIASES, EXPORTS, OF_MEDIA

if TYPE_CHECKING:
    from facetrack_cli.editor.fixer import Fixer
    from facetrack_cli.trajectory.formats.tables import Clip
    from facetrack_cli.trajectory.people import Change, People
    from facetrack_cli.trajectory.views import Around, Clock

FIGURES = ("png", "svg", "pdf")  # those that report/figures/style.py renders
Words: TypeAlias = tuple[tuple[str, ...], ...]
_NAMES = words("A=B", "([^=]*)=(.*)", "give two names, as person_3=person_1")
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
@options.page_options
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

    With --import, the corrections are what differs from the run in a file of an annotation tool, to which facetrack
    export --to cvat, labelstudio or eaf has brought it: parts that were moved, and parts that were marked as not
    visible. Of ELAN's .eaf the segments of the tiers seen and absent count, and of a film without --person the
    participants, who are the names of its people.

    \b
    Examples:
      facetrack fix out
      facetrack fix out --import annotations.xml
      facetrack fix film --person Eileen@0:03
    """
    from facetrack_cli.editor.fix_session import FixSession
    from facetrack_cli.editor.fixer import fixing, open_track
    from facetrack_cli.run_folder.manifest import read_run
    from facetrack_cli.runs.finished import open_run
    from facetrack_cli.runs.people import people_in
    from facetrack_cli.trajectory.reader import PEOPLE
    from facetrack_cli.trajectory.views import Clock

    file = init or imported
    refuse((init and imported, "--import adds to the run's corrections, --init replaces them; leave one of them out"))
    if imported is not None and imported.suffix.lower() == ".eaf" and not person and (folder / PEOPLE).is_file():
        return _rename(folder, clip, imported, quiet, video=not no_video)
    if person is None:
        opened = open_run(folder, clip)
    else:
        at = frame_at(person[1], Clock(read_run(folder), people_in(folder).fps))
        opened = open_track(folder, person[0], at, clip)
    if file is None:
        return page.serve(FixSession(opened, video=not no_video))
    with fixing(opened) as (fixer, _):
        return _apply(fixer, file, quiet, adds=init is None, video=not no_video)


def _apply(fixer: Fixer, file: Path, quiet: bool, *, adds: bool, video: bool) -> int:
    """Take the corrections of --init or --import, and save; the exit code."""
    from facetrack_cli.editor.fixer import corrections_of, merged, save
    from facetrack_cli.editor.import_annotations import imported_corrections
    from facetrack_cli.trajectory.reader import UNSAVED

    folder = fixer.run.folder
    unsaved, left_out = folder / UNSAVED, list[str]()
    if unsaved.is_file() and not (file.is_file() and file.samefile(unsaved)):
        remedy = f"facetrack fix {folder} goes on with them, --init {unsaved} takes them; or remove it"
        raise UsageError(f"{unsaved}: corrections that were not saved are there; {remedy}")
    if not adds:
        corrections = corrections_of(file, fixer.run)
    else:
        parts, find = fixer.run.parts, fixer.find
        found = imported_corrections(file, fixer.run, fixer.rows, left_out.append)
        for line in () if quiet else left_out:
            say(f"facetrack: warning: {line}")
        if not found:
            say(f"facetrack: {file} is {'otherwise ' * bool(left_out)}as the run has it; nothing was written")
            return ExitCode.DONE
        corrections = tuple(merged(fix, find(fix.frame, fix.target), parts[fix.target]) for fix in found)
    with working(quiet, folder) as (stop, shown):
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
    from facetrack_cli.run_folder.manifest import read_run
    from facetrack_cli.runs.people import people_in, recast
    from facetrack_cli.trajectory.people import rename
    from facetrack_cli.trajectory.reader import clip_of

    at = clip or clip_of(read_run(folder))
    names = renames(file, people_in(folder).names, at.name if at else "")
    if not names:
        say(f"facetrack: {file}: the names are the run's, nothing was written; segments count with --person NAME@TIME")
        return ExitCode.DONE
    changes = [(f"rename {old}={name}", partial(rename, name=old, to=name)) for old, name in names.items()]
    with working(quiet, folder) as (stop, shown):
        recast(folder, changes, clip=clip, video=video, report=shown.looked, stop=stop)
        shown.say(f"{folder}: {', '.join(f'{old} is {name}' for old, name in names.items())}")
    return ExitCode.DONE


@click.command(cls=Command, basic="merge split rename give save edit clip no_video as_csv overwrite quiet")
@click.argument("folder", type=options.RUN)
@option("--merge", type=_NAMES, multiple=True, help="A is B: both are one person, under the name of B.")
@option("--split", type=moment("A@TIME"), multiple=True, help="From that time on (1:23, or 2075f) A is somebody else.")
@option("--rename", type=_NAMES, multiple=True, help="The name of A.")
@option(
    "--save", type=options.NPZ,
    help="Save what these people look like, for run --faces all --gallery FILE.npz.",
)  # fmt: skip
@option(
    "--give", type=_TRACK, multiple=True,
    help="The track of A at that time is of B; B may be A, which settles a doubt.",
)  # fmt: skip
@flag("--page", "edit", help="Correct the cast on a page in the browser.")
@options.page_options
@options.clip
@flag("--no-video", help="Do not draw annotated.mp4 again.")
@flag("--csv", "as_csv", help="Print when each person is seen, a row an interval.")
@flag("--overwrite", help="Replace the file of --save.")
@flag("--quiet", "-q", help="Say nothing but errors, and print no table.")
def people_command(
    folder: Path, merge: Words, split: Words, rename: Words, save: Path | None, give: Words, edit: bool,
    page: options.Page, clip: Path | None, no_video: bool, as_csv: bool, overwrite: bool, quiet: bool,
) -> int:  # fmt: skip
    """Show who is in a film, and correct it.

    RUN_DIR is a folder that facetrack run --faces all wrote. For each person it says how long, in how many tracks, and
    how sure. A correction writes the rows, the pictures and the video of the run again.

    \b
    Examples:
      facetrack people out
      facetrack people out --rename person_1=Anna --rename person_2=Ben
      facetrack people out --split person_2@1:23
      facetrack people out --csv > intervals.csv
      facetrack people out --save people.npz
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.core.numbers import csv_text
    from facetrack_cli.run_folder.manifest import read_run
    from facetrack_cli.runs.people import people_in, recast, save_looks
    from facetrack_cli.trajectory import people as edits
    from facetrack_cli.trajectory.views import Clock

    others = split or give or merge or rename or save is not None or as_csv
    refuse((edit and others, "--page corrects on the page alone; correct, save and print in a command without it"))
    people = people_in(folder)
    clock = Clock(read_run(folder) if split or give else None, people.fps)
    changes: list[Change] = [
        *((f"split {a}@{at}", partial(edits.split, name=a, frame=frame_at(at, clock))) for a, at in split),
        *((f"give {a}@{at}={b}", partial(edits.give, name=a, frame=frame_at(at, clock), to=b)) for a, at, b in give),
        *((f"merge {a}={b}", partial(edits.merge, name=a, into=b)) for a, b in merge),
        *((f"rename {a}={b}", partial(edits.rename, name=a, to=b)) for a, b in rename),
    ]
    if edit:
        from facetrack_cli.editor.fix_session import CastSession

        return page.serve(CastSession(folder, clip, video=not no_video))
    if save is not None:
        check_new(save, overwrite=overwrite)
    if changes:
        with working(quiet, folder) as (stop, shown):
            people = recast(folder, changes, clip=clip, video=not no_video, report=shown.looked, stop=stop)
    if save is not None:
        left = f"{save} was not written" + "; the changes are" * bool(changes)
        with working(quiet, folder, left) as (stop, shown):
            shown.say(f"{save}: {', '.join(save_looks(folder, save, clip, shown.looked, stop))}")
    if as_csv:
        # the frames in which people are seen, and their times in s, in the order of time
        each = ((person.name, zip(person.intervals, person.times, strict=True)) for person in people.people)
        spans = sorted((*frames, name, *times) for name, both in each for frames, times in both)
        rows = ([name, first, stop - 1, f"{begin:.3f}", f"{end:.3f}"] for first, stop, name, begin, end in spans)
        click.echo(csv_text(["person", "first_frame", "last_frame", "begin_s", "end_s"], rows), nl=False)
    elif not quiet:
        _show(people, Clock(read_run(folder), people.fps))
    return 0


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


@click.command()
@click.argument("trajectory", type=options.TRAJECTORY)
@option("--to", type=click.Choice([*EXPORTS, *ALIASES]), metavar="FORMAT", required=True, help="Format, as above.")
@option("-o", "--out", type=options.FILE_OR_DASH, help="File to write [default: beside TRAJECTORY]; - standard output.")
@options.target
@option("--media", type=options.FILE, help=f"Clip it was tracked in ({', '.join(OF_MEDIA)}).")
@option("--into", type=options.FILE, help="An .eaf to add the tiers to.")
@option(
    "--box", type=click.Choice(["windows", "points"]), metavar="KIND",
    help="What a box around points encloses: windows [default], or points, their centres alone.",
)  # fmt: skip
@flag("--drop-lost", help="Write lost rows as not known, not with the estimate.")
@options.overwrite
def export_command(
    trajectory: Path, to: str, out: str | None, target: str | None, media: Path | None, into: Path | None,
    box: Around | None, drop_lost: bool, overwrite: bool,
) -> None:  # fmt: skip
    """Write a trajectory as other tools read it.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run; for measures, events and boris also that of
    many runs. The file goes beside it, with the ending of its format, unless -o says otherwise.

    \b
    Formats:
      FORMATS

    In mot, otb, got10k, vot and coco, a target of several points has the box around the windows that the tracker
    compares; with --box points, around the points alone.

    Lost rows hold the tracker's estimate, and say so as far as a format can; with --drop-lost they are as if nothing
    was found. docs/export.md has the table of all formats, and what the tiers of eaf are.

    By facetrack fix --import comes back what is corrected in CVAT, Label Studio or ELAN. With --into an .eaf that is
    there gets the tiers beside its own; the result goes to -o, or with --overwrite into that file itself.

    \b
    Examples:
      facetrack export out/ --to mot
      facetrack export out/ --to otb --target face/nose -o -
      facetrack export out/trajectory.csv --to eaf --media clip.mp4
      facetrack export out/ --to elan --into session.eaf --overwrite
    """
    from facetrack_cli.core.files import StreamSink, check_new, write_new
    from facetrack_cli.runs.export import content, encoded
    from facetrack_cli.trajectory.reader import clip_of

    to = ALIASES.get(to, to)
    refuse(
        (into and to != "eaf", f"--into adds the tiers of eaf to a file of ELAN; {to} has none"),
        (drop_lost and to == "eaf", "--drop-lost is not for eaf, which has a tier for what was lost; leave it out"),
        (out == "-" and to == "dlc-h5", "dlc-h5 is not text, and does not go to standard output; name a file with -o"),
    )
    clips, many = _clips(trajectory, to, target, drop_lost)
    table = clips[0].table
    folder, stem = (trajectory, trajectory.resolve().name) if many else (table.path.parent, table.path.stem)
    path = None if out == "-" else Path(out) if out else into or folder / f"{stem}.{EXPORTS[to].ending}"
    if path is not None:
        check_new(path, overwrite=overwrite, inputs=(table.path, media, clip_of(table)))
    try:
        about: Any = {"media": media, "into": into, "box": box}
        made = content(clips, to, path, many=many, say=say, **about)
    except InputError as e:
        # what is wrong within the table has no file's name yet
        placed = str(e).startswith((str(table.path), str(media), str(into)))
        raise e if placed else InputError(f"{table.path}: {e}") from None
    if path is None:
        StreamSink(sys.stdout.buffer).finish(lambda _: str(made))
        return
    write_new(path, encoded(made), overwrite=overwrite)
    frames = table.frames
    first = f"; line 1 is frame {frames[0]}" if to in ("otb", "got10k") and frames[0] else ""
    what = f"{len(frames)} frame{'s' * (len(frames) != 1)} of {', '.join(table.targets) or 'one target'}"
    say(f"{path}: {what if not many else f'{len(clips)} clips'}{first}")


def _clips(trajectory: Path, to: str, target: str | None, drop_lost: bool) -> tuple[list[Clip], bool]:
    """The trajectory, or those of the many runs in a folder, less what cannot be read; whether there are many."""
    from facetrack_cli.run_folder.manifest import read_run
    from facetrack_cli.runs.export import named
    from facetrack_cli.trajectory.views import choose

    paths = [] if any(trajectory.glob("trajectory.*")) else trajectory.glob("*/trajectory.*")
    folders = sorted({path.parent for path in paths})
    if (many := bool(folders)) and "clips" not in EXPORTS[to].takes.split():
        raise UsageError(f"{trajectory}: is a folder of runs, and {to} takes one; name that of one run")
    clips = []
    for path in folders or [trajectory]:
        try:
            table = choose(read_run(path), target)
        except (InputError, UsageError) as e:
            if not many:
                raise
            say(f"facetrack: warning: {e}; it is left out")
            continue
        clips.append(named(table, drop_lost=drop_lost))
    if not clips:
        raise InputError(f"{trajectory}: none of its runs can be read; look at facetrack status")
    return clips, many


_CALLED = {form: ", ".join([form, *(alias for alias, of in ALIASES.items() if of == form)]) for form in EXPORTS}
_LIST = "\n  ".join(f"{_CALLED[form]:<9} {export.about}" for form, export in EXPORTS.items())
export_command.help = inspect.cleandoc(str(export_command.help)).replace("FORMATS", _LIST)


@click.command()
@click.argument("folder", type=options.RUN)
@option("--truth", type=options.FILE, help="Measure against this file of ground truth.")
@options.truth_options
@option("-o", "--out", type=options.FILE, help="The page [default: RUN_DIR/report.html, or batch.html].")
@options.clip
@options.overwrite
@options.quiet
def report_command(
    folder: Path, truth: Path | None, reference: options.TruthOptions, out: Path | None, clip: Path | None,
    overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Write one HTML page about a run, or about a batch.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    images of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    Of a folder with the runs of a batch the page is batch.html: a table of the clips, the worst first, with a still of
    each and links to its files.

    \b
    Examples:
      facetrack report out
      facetrack report out --truth clip.truth.csv -o paper/supplement.html
      facetrack report results
    """
    from facetrack_cli.core.files import check_new, check_plain, write_new
    from facetrack_cli.report.make import BATCH_PAGE, make_batch_report, make_report
    from facetrack_cli.run_folder.manifest import REPORT, trajectory_of
    from facetrack_cli.run_folder.status import is_batch
    from facetrack_cli.runs.progress import progress

    batch = is_batch(folder)
    refuse((batch and (truth or clip), "--truth and --clip are of one run; name its folder, or leave them out"))
    if not batch:
        trajectory_of(folder)
    to = folder / (BATCH_PAGE if batch else REPORT) if out is None else out
    if out is None:
        check_plain(to)
    check_new(to, overwrite=overwrite, inputs=(truth, clip))
    with progress(quiet) as shown:
        shown.begin(folder.name or str(folder), "clips" if batch else "frames")
        measured = None if truth is None else (reference.read(truth), reference.pairs)
        if batch:
            page = make_batch_report(folder, to, report=shown.update)
        else:
            page = make_report(folder, truth=measured, clip=clip, report=shown.update)
        write_new(to, page.html, overwrite=overwrite)
        for note in page.notes:
            shown.say(f"facetrack: warning: {note}")
        shown.say(f"{folder} -> {to} ({len(page.html) / 1e6:.1f} MB)")


@click.command()
@click.argument("trajectory", type=options.TRAJECTORY)
@option("--truth", type=options.FILE, help="Draw the ground truth too, and the error.")
@options.truth_options
@option("--measure", type=options.Text("NAMES"), help="Draw these measures and events alone, separated by commas.")
@option(
    "-o", "--out", type=options.FILE, help="File to write: .png, .svg or .pdf [default: plot.png beside TRAJECTORY]."
)
@options.overwrite
def plot_command(
    trajectory: Path, truth: Path | None, reference: options.TruthOptions, measure: str | None, out: Path | None,
    overwrite: bool,
) -> None:  # fmt: skip
    """Draw what happened in a trajectory.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, or the folder of a run. The page shows, over time, position and
    size of every part, confidence and what was lost, particles and their effective sample size, spread, and with
    --truth the error. Of a tracker that adapts it also shows the identity, the scale, noise and error, from its JSON.
    What the tracker does not report is left out.

    With --measure the figure has a panel for each of these measures, with bars where the events named are.

    \b
    Examples:
      facetrack plot out/
      facetrack plot out/ --truth clip.truth.csv -o page.pdf
      facetrack plot out/ --measure mouth_opening,blink -o figure.pdf
    """
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.report.figures.page import measures_figure, page_figure
    from facetrack_cli.report.figures.style import need_matplotlib, render
    from facetrack_cli.run_folder.manifest import PLOT, read_run
    from facetrack_cli.trajectory.views import choose

    out = out or (trajectory if trajectory.is_dir() else trajectory.parent) / PLOT
    form = out.suffix[1:].lower()
    refuse((form not in FIGURES, f"{out}: cannot tell the kind of file; let its name end in .png, .svg or .pdf"))
    check_new(out, overwrite=overwrite)
    need_matplotlib()
    table = read_run(trajectory)
    if measure is None:
        pairs = None if truth is None else reference.pairs(table, reference.read(truth), say)
        figure = page_figure(choose(table, reference.target), pairs)
    else:
        figure = measures_figure(choose(table, reference.target), [name.strip() for name in measure.split(",")])
    write_new(out, render(figure, form), overwrite=overwrite)
    say(f"{trajectory} -> {out}")
