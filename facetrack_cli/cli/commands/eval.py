"""facetrack eval: a trajectory against the truth."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.core.errors import InputError, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.summary import Evaluation
    from facetrack_cli.trajectory.trajectory import Trajectory


def _failure(ctx: click.Context, param: click.Parameter, value: str) -> float:
    try:
        share = float(value)
    except ValueError:
        share = 0.0
    if not 0 < share <= 100:
        raise click.BadParameter(f"{value!r}: give a normalised error above 0, as 0.1 or 0.08")
    return share


@click.command()
@click.argument("trajectory", metavar="TRAJECTORY", type=click.Path(path_type=Path))
@click.option(
    "--truth",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Truth file or folder [default: <clip>.truth.csv beside the clip that a JSON trajectory names].",
)
@options.truth_format
@click.option(
    "--format",
    "results_format",
    metavar="FORMAT",
    type=click.Choice(options.TRUTH_FORMATS),
    default="auto",
    help="How to read TRAJECTORY if another tracker wrote it: one of the same [default: by its shape].",
)
@options.target
@options.shift
@options.partial
@click.option(
    "--normalise",
    metavar="LENGTH",
    default="size",
    show_default=True,
    help="Length that errors are divided by: size (the largest distance between two points in the first frame; of a "
    "box the root of its area), mouth, eyes, two parts as A:B, or a number of pixels.",
)
@click.option(
    "--failure",
    metavar="SHARE",
    default="0.1",
    show_default=True,
    callback=_failure,
    help="A point has failed above this normalised error; 300-W takes 0.08.",
)
@click.option("--json", "json_to", metavar="FILE", help="Write all measures as JSON; - is standard output.")
@click.option("--csv", "csv_to", metavar="FILE", help="Write a row a part and one of all as CSV; - is standard output.")
@click.option("--plot", "plot_to", metavar="FILE.png", help="Draw how far confidence can be trusted (needs [plot]).")
@click.option("--overwrite", is_flag=True, help="Replace files that are there already.")
def command(
    trajectory: Path,
    truth: Path | None,
    truth_format: str,
    results_format: str,
    target: str | None,
    shift: int | None,
    partial: bool,
    normalise: str,
    failure: float,
    json_to: str | None,
    csv_to: str | None,
    plot_to: str | None,
    overwrite: bool,
) -> None:
    """Measure a trajectory against the truth.

    TRAJECTORY is a trajectory.csv, .json or .jsonl, the folder of a run, or
    what another tracker wrote, in any of the formats of truth. Printed are
    the errors of points, or the overlaps of boxes; how long parts take to
    come back after occlusions; and how far lost, confidence and the spread
    can be trusted. With --json - or --csv - the data take the place of the
    tables. The first frame, which the tracker is given, counts among the
    points; whatever measures trust leaves it out.

    \b
    Examples:
      facetrack eval out/ --truth clip.truth.csv
      facetrack eval out/ --truth groundtruth_rect.txt --json eval.json
      facetrack eval out/ --truth annot/ --partial --normalise eyes
      facetrack eval results/MIL.txt --truth groundtruth_rect.txt
      for run in runs/*/; do
        facetrack eval "$run" --truth clip.truth.csv --csv - | tail -n 1
      done

    \b
    Exit codes: 0 done, 2 usage or output, 3 a trajectory or truth that
    cannot be read, or that do not belong together, 130 interrupted.
    """
    outputs = {"--json": json_to, "--csv": csv_to, "--plot": plot_to}
    files = _check_outputs(outputs, overwrite)
    if plot_to is not None:
        from facetrack_cli.report.figures.style import need_matplotlib

        need_matplotlib()

    from facetrack_cli.core.files import check_new
    from facetrack_cli.evaluation.match import match
    from facetrack_cli.evaluation.output import About, to_csv, to_json, to_text
    from facetrack_cli.evaluation.rows import check_normalise
    from facetrack_cli.evaluation.summary import Options, evaluate
    from facetrack_cli.trajectory.formats.read import read_results, read_truth
    from facetrack_cli.trajectory.header import clip_of, picture_of

    check_normalise(normalise)
    ours = read_results(trajectory, results_format)
    theirs = read_truth(truth or _truth_beside(ours), truth_format, shift=shift or 0)
    for path in files.values():
        check_new(path, overwrite=overwrite, inputs=(ours.path, theirs.path, clip_of(ours)))
    notes: list[str] = []
    pairs = match(ours, theirs, partial=partial, select=target, check_shift=shift is None, note=notes.append)
    settings = Options(normalise, failure, picture_of(ours))
    evaluation = evaluate(pairs, notes, settings, reference=theirs.parts)
    about = About(
        ours.path, theirs.path, str(theirs.header.get("read_as", truth_format)), shift or 0, ours.header.get("read_as")
    )

    data = {"--json": to_json, "--csv": to_csv}
    whole: dict[str, bytes] = {
        option: make(evaluation, about).encode(errors="backslashreplace")
        for option, make in data.items()
        if option in files
    }
    if plot_to is not None:
        whole["--plot"] = _plot(evaluation, ours.path)
    _write(trajectory, whole, files, overwrite)
    streamed = [make(evaluation, about) for option, make in data.items() if outputs[option] == "-"]
    _print(streamed[0] if streamed else to_text(evaluation, about, colour=_colour()))


def _check_outputs(outputs: dict[str, str | None], overwrite: bool) -> dict[str, Path]:
    """The files to write by their options; refused before anything is read if they cannot be."""
    from facetrack_cli.core.files import check_new

    if outputs["--json"] == outputs["--csv"] == "-":
        raise UsageError("--json - and --csv - both want standard output; write one of them to a file")
    files = {option: Path(name) for option, name in outputs.items() if name is not None and name != "-"}
    for option, path in files.items():
        if not str(outputs[option]):
            raise UsageError(f"{option} is empty; name a file")
        check_new(path, overwrite=overwrite)
    if len({os.path.realpath(path) for path in files.values()}) < len(files):
        raise UsageError(f"{' and '.join(files)} name the same file; name one for each")
    if outputs["--plot"] is not None and Path(outputs["--plot"]).suffix.lower() != ".png":
        raise UsageError(f"--plot {outputs['--plot']}: the picture is a PNG; let its name end in .png")
    return files


def _truth_beside(ours: Trajectory) -> Path:
    """The truth file beside the clip of a JSON trajectory."""
    from facetrack_cli.trajectory.header import clip_of, is_there

    clip = clip_of(ours)
    if clip is None:
        raise UsageError(f"{ours.path}: does not name its clip, beside which the truth might be; give --truth FILE")
    beside = clip.with_name(clip.stem + ".truth.csv") if clip.name else clip
    if not is_there(beside):
        raise UsageError(f"{ours.path}: beside its clip there is no {beside}; give --truth FILE")
    return beside


def _plot(evaluation: Evaluation, path: Path) -> bytes:
    from facetrack_cli.report.figures.compare import calibration_figure
    from facetrack_cli.report.figures.style import render

    confidence = evaluation.all.confidence
    if confidence is None or not confidence.bins:
        raise InputError(f"{path}: has no confidence from 0 to 1 in rows of known truth to draw; leave --plot out")
    return render(calibration_figure(confidence))


def _write(trajectory: Path, whole: dict[str, bytes], files: dict[str, Path], overwrite: bool) -> None:
    from facetrack_cli.core.files import write_new

    for option, content in whole.items():
        write_new(files[option], content, overwrite=overwrite)
        click.echo(" ".join(f"{trajectory} -> {files[option]}".splitlines()), err=True)


def _print(text: str) -> None:
    """To standard output, in what its encoding has."""
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    if not encoding.lower().replace("-", "").startswith("utf"):
        text = text.replace("\N{EN DASH}", "-")
    click.echo(text.encode(encoding, errors="backslashreplace").decode(encoding), nl=False)


def _colour() -> bool:
    return sys.stdout.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
