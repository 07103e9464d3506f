"""facetrack eval: a trajectory against ground truth."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.app import colour
from facetrack_cli.cli.options import Command, TruthOptions, flag, option, say, truth_options
from facetrack_cli.cli.types import FILE, FILE_OR_DASH, TRAJECTORY, Text
from facetrack_cli.core.errors import InputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.summary import Evaluation
    from facetrack_cli.trajectory.trajectory import Trajectory


def _failure(value: str) -> float:
    try:
        share = float(value)
    except ValueError:
        share = 0.0
    if not 0 < share <= 100:
        raise click.BadParameter(f"{value!r}: give a normalised error above 0, as 0.1 or 0.08")
    return share


@click.command(cls=Command, basic="truth partial target normalise people json_file csv_file plot overwrite")
@click.argument("trajectory", type=TRAJECTORY)
@option(
    "--truth", type=FILE,
    help="File or folder of ground truth [default: <clip>.truth.csv beside the clip that a JSON trajectory names].",
)  # fmt: skip
@truth_options
@options.format_of("--format", "How to read TRAJECTORY if another tracker wrote it: one of the same")
@option(
    "--normalise", type=Text("LENGTH"), default="size",
    help="Length that errors are divided by: size (the largest distance between two points in the first frame; of a "
    "box the root of its area), mouth, eyes, two parts as A:B, or a number of pixels.",
)  # fmt: skip
@option(
    "--failure", type=Text("SHARE", _failure), default="0.1",
    help="A point has failed above this normalised error; 300-W takes 0.08.",
)  # fmt: skip
@flag(
    "--people",
    help="Find which target is which person, whatever their names, and measure HOTA, IDF1, switches and fragments; "
    "other tables are of the rows that both have.",
)
@option("--json", "json_file", type=FILE_OR_DASH, help="Write all measures as JSON; - is standard output.")
@option("--csv", "csv_file", type=FILE_OR_DASH, help="Write a row a part and one of all as CSV; - is standard output.")
@option("--plot", type=Text("FILE.png"), help="Draw how far confidence can be trusted (needs [plot]).")
@options.overwrite
def command(
    trajectory: Path, truth: Path | None, known: TruthOptions, format: str, normalise: str, failure: float,
    people: bool, json_file: str | None, csv_file: str | None, plot: str | None, overwrite: bool,
) -> None:  # fmt: skip
    """Measure a trajectory against ground truth.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, the folder of a run, or what another tracker wrote, in any of the
    formats of ground truth. It prints the errors of points, or the overlaps of boxes; how long parts take to come back
    after occlusions; and how far the status lost, the confidence and the spread can be trusted. With --json - or
    --csv - the data take the place of the tables. The first frame, which the tracker is given, counts among the points;
    the measures of trust leave it out.

    \b
    Examples:
      facetrack eval out/ --truth clip.truth.csv
      facetrack eval out/ --truth groundtruth_rect.txt --json eval.json
      facetrack eval out/ --truth annot/ --partial --normalise eyes
      facetrack eval film/ --truth film.truth.csv --people
      facetrack eval results/MIL.txt --truth groundtruth_rect.txt
      for run in runs/*/; do
        facetrack eval "$run" --truth clip.truth.csv --csv - | tail -n 1
      done

    \b
    Exit codes: 0 done, 2 usage or output, 3 a trajectory or ground truth that
    cannot be read, or that do not belong together, 130 interrupted.
    """
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.evaluation.identities import identified
    from facetrack_cli.evaluation.rows import check_normalise
    from facetrack_cli.evaluation.summary import About, Options, evaluate, to_csv, to_json, to_text
    from facetrack_cli.report.figures.style import need_matplotlib
    from facetrack_cli.run_folder.manifest import check_run, other_clip
    from facetrack_cli.trajectory.formats.read import read_results
    from facetrack_cli.trajectory.header import clip_of, frame_size_of

    wanted = {"--json": json_file, "--csv": csv_file, "--plot": plot}
    files = _files(wanted, overwrite)
    if plot is not None:
        need_matplotlib()
    check_normalise(normalise)
    check_run(trajectory)
    ours = read_results(trajectory, format)
    theirs = known.read(truth or _truth_beside(ours), ours)
    for path in files.values():
        check_new(path, overwrite=overwrite, inputs=(ours.path, theirs.path, clip_of(ours)))
    clip = clip_of(ours)
    other = None if clip is None else other_clip(ours, clip)
    notes = [] if other is None else [other]
    persons = None
    if people:
        ours, persons, named = identified(ours, theirs)
        notes += named
        known.partial = True
    pairs = known.pairs(ours, theirs, notes.append)
    settings = Options(normalise, failure, frame_size_of(ours))
    evaluation = evaluate(pairs, notes, settings, reference=theirs.parts, people=persons)
    read_as = str(theirs.header.get("read_as", known.truth_format))
    about = About(ours.path, theirs.path, read_as, known.shift, ours.header.get("read_as"))

    made: dict[str, bytes] = {}
    printed = ""
    for name, to, make in (("--json", json_file, to_json), ("--csv", csv_file, to_csv)):
        if name in files:
            made[name] = make(evaluation, about).encode(errors="backslashreplace")
        elif to is not None:
            printed = make(evaluation, about)
    if plot is not None:
        made["--plot"] = _plot(evaluation, ours.path)
    for name, content in made.items():
        write_new(files[name], content, overwrite=overwrite)
        say(f"{trajectory} -> {files[name]}")
    _print(printed or to_text(evaluation, about, colour=colour()))


def _files(wanted: dict[str, str | None], overwrite: bool) -> dict[str, Path]:
    """The files to write by their options; refused before anything is read if they cannot be."""
    from facetrack_cli.core.files import check_new

    if wanted["--json"] == wanted["--csv"] == "-":
        raise UsageError("--json - and --csv - both name standard output; write one of them to a file")
    files = {name: Path(file) for name, file in wanted.items() if file is not None and file != "-"}
    for name, path in files.items():
        if not wanted[name]:
            raise UsageError(f"{name} is empty; name a file")
        check_new(path, overwrite=overwrite)
    if len({os.path.realpath(path) for path in files.values()}) < len(files):
        raise UsageError(f"{' and '.join(files)} name the same file; name one for each")
    if "--plot" in files and files["--plot"].suffix.lower() != ".png":
        raise UsageError(f"--plot {files['--plot']}: the figure is a PNG; let its name end in .png")
    return files


def _truth_beside(ours: Trajectory) -> Path:
    """The ground truth beside the clip of a JSON trajectory."""
    from facetrack_cli.trajectory.header import clip_of, is_there

    clip = clip_of(ours)
    if clip is None:
        raise UsageError(
            f"{ours.path}: does not name its clip, beside which the ground truth might be; give --truth FILE"
        )
    beside = clip.with_name(clip.stem + ".truth.csv") if clip.name else clip
    if not is_there(beside):
        raise UsageError(f"{ours.path}: beside its clip there is no {beside}; give --truth FILE")
    return beside


def _plot(evaluation: Evaluation, path: Path) -> bytes:
    from facetrack_cli.report.figures import calibration_figure, render

    confidence = evaluation.all.confidence
    if confidence is None or not confidence.bins:
        raise InputError(
            f"{path}: has no confidence from 0 to 1 in rows with known ground truth to draw; leave --plot out"
        )
    return render(calibration_figure(confidence.bins))


def _print(text: str) -> None:
    """To standard output, in what its encoding has."""
    if not (sys.stdout.encoding or "utf-8").lower().startswith("utf"):
        text = text.replace("\N{EN DASH}", "-")
    click.echo(text, nl=False)
