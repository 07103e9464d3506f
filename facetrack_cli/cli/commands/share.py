"""facetrack report, plot and export: what is made of a run for people and other programs."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE_OR_DASH, TruthOptions, flag, option, refuse, say, truth_options, write_figure
from facetrack_cli.core.errors import InputError, UsageError
from facetrack_cli.trajectory.formats import ALIASES, EXPORTS, OF_BOXES, OF_MEDIA

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from facetrack_cli.trajectory.formats.tables import Clip
    from facetrack_cli.trajectory.views import Around


@click.command()
@click.argument("trajectory", type=options.TRAJECTORY)
@option("--to", type=click.Choice([*EXPORTS, *ALIASES]), metavar="FORMAT", required=True, help="Format, as above.")
@option("-o", "--out", type=FILE_OR_DASH, help="File to write [default: beside TRAJECTORY]; - standard output.")
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
      facetrack export out/trajectory.csv --to dlc -o clip.csv
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
        (media and to not in OF_MEDIA, f"--media is for {', '.join(OF_MEDIA)}; {to} does not name the clip"),
        (box and to not in OF_BOXES, f"--box is for {', '.join(OF_BOXES)}; {to} has no boxes"),
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


_NAMES = {form: ", ".join([form, *(alias for alias, of in ALIASES.items() if of == form)]) for form in EXPORTS}
_LIST = "\n  ".join(f"{_NAMES[form]:<9} {export.about}" for form, export in EXPORTS.items())
export_command.help = inspect.cleandoc(str(export_command.help)).replace("FORMATS", _LIST)


@click.command()
@click.argument("folder", type=options.RUN)
@option("--truth", type=options.FILE, help="Measure against this file of ground truth.")
@truth_options
@option("-o", "--out", type=options.FILE, help="The page [default: RUN_DIR/report.html, or batch.html].")
@options.clip
@options.overwrite
@options.quiet
def report_command(
    folder: Path, truth: Path | None, reference: TruthOptions, out: Path | None, clip: Path | None,
    overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Write one HTML page about a run, or about a batch.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    images of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    Of a folder with the runs of a batch the page is batch.html: a table of the clips, the worst first, with a still of
    each and links to its files.

    The images are drawn from the clip.

    \b
    Examples:
      facetrack report out
      facetrack report out --truth clip.truth.csv -o paper/supplement.html
      facetrack report out --clip /archive/clip.mp4 --overwrite
      facetrack report results
    """
    from facetrack_cli.core.files import check_new, check_plain, write_new
    from facetrack_cli.report.make import BATCH_PAGE, make_batch_report, make_report
    from facetrack_cli.run_folder.manifest import REPORT, trajectory_of
    from facetrack_cli.run_folder.status import is_batch
    from facetrack_cli.runs.progress import progress

    if truth is None:
        reference.refuse(target=True)
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
@truth_options
@option("--measure", type=options.Text("NAMES"), help="Draw these measures and events alone, separated by commas.")
@options.figure_file("plot.png beside TRAJECTORY")
@options.overwrite
def plot_command(
    trajectory: Path, truth: Path | None, reference: TruthOptions, measure: str | None, out: Path | None,
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
      facetrack plot out/trajectory.csv --target face/nose -o nose.svg
      facetrack plot out/ --truth groundtruth_rect.txt --partial --overwrite
      facetrack plot out/ --measure mouth_opening,blink -o figure.pdf
    """
    from facetrack_cli.report.figures.page import measures_figure, page_figure
    from facetrack_cli.run_folder.manifest import PLOT, read_run
    from facetrack_cli.trajectory.views import choose

    if truth is None:
        reference.refuse(target=False)

    def draw() -> Figure:
        table = read_run(trajectory)
        if measure is not None:
            names = [name.strip() for name in measure.split(",")]
            return measures_figure(choose(table, reference.target), names)
        pairs = None if truth is None else reference.pairs(table, reference.read(truth), say)
        return page_figure(choose(table, reference.target), pairs)

    out = out or (trajectory if trajectory.is_dir() else trajectory.parent) / PLOT
    write_figure(out, draw, overwrite=overwrite)
    say(f"{trajectory} -> {out}")
