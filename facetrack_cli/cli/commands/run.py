"""facetrack run: clips in, trajectories and annotated videos out."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, FRAME, Extent, Whole, flag, option
from facetrack_cli.core.errors import ExitCode, OutputError, UsageError
from facetrack_cli.trajectory.row import FORMATS, Format

if TYPE_CHECKING:
    from facetrack_cli.runs.job import Job, Outcome
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop


def _formats(value: str) -> tuple[Format, ...]:
    names = [name.strip().lower() for name in value.split(",") if name.strip()]
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        raise click.BadParameter(f"{','.join(unknown) or value!r}: choose among {', '.join(FORMATS)}")
    return tuple(form for form in FORMATS if form in names)


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=FILE)
@options.config
@options.overrides
@option("--seed", "N", "Seed of the random numbers, instead of the recipe's.", type=Whole(min=0))
@options.gallery
@options.extent("First frame, from 0.")
@option("--init-frame", "N", "Frame of --init or --box, or where the search for a face begins.", type=FRAME)
@option("-o --out", "DIR", "Folder for results [default: ./<clip>-<recipe>]; - streams to stdout.")
@flag("--no-video", "Do not write annotated.mp4.")
@option("--format formats", "LIST", "csv, json, jsonl [default: csv,json; csv with -o -].", type=_formats)
@options.overwrite
@flag("--fail-on-lost", "Exit with 4 if a part is lost in the last frame.")
@option("--threads", "N", "Threads a clip [default: the cores, shared by -j].", type=Whole(min=1))
@options.jobs("Clips at a time.")
@options.quiet
def command(
    inputs: tuple[Path, ...],
    config: str,
    overrides: tuple[str, ...],
    seed: int | None,
    gallery: str | None,
    extent: Extent,
    init_frame: int | None,
    out: str | None,
    no_video: bool,
    formats: tuple[Format, ...] | None,
    overwrite: bool,
    fail_on_lost: bool,
    threads: int | None,
    workers: int,
    quiet: bool,
) -> int:
    """Track faces, heads and hands in videos and image folders.

    Each INPUT gets a folder with annotated.mp4, trajectory.csv and trajectory.json. The track starts from --init or
    --box, else from <clip>.init.yaml beside the clip, else from the first face that a Haar cascade finds.

    Recipes of points follow the features of a face; within --box the image says where they are. Recipes of regions
    follow whatever is in the box.

    With several INPUTs, --out holds a folder for each; one that fails does not stop the others.

    \b
    Examples:
      facetrack run clip.mp4
      facetrack run clip.mp4 --config sir --set filter.particles=500 -o out
      facetrack run clip.mp4 --config histogram --box 110,93,56,64
      facetrack run clip.mp4 --config adaptive_recognition --gallery people.npz
      facetrack run frames/ --fps 25 -o - | head
      find . -name '*.mp4' -print0 | xargs -0 facetrack run -j 4 --no-video

    \b
    Exit codes: 0 done (also if a clip was cut short: a warning says so),
    2 usage, recipe or output, 3 input, 4 lost (--fail-on-lost),
    5 some of several inputs failed, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.runs.batch import absolute, cores
    from facetrack_cli.runs.job import Job
    from facetrack_cli.runs.plan import load_recipes
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop

    extent.check(*inputs)
    [recipe] = load_recipes([(config, overrides if seed is None else (*overrides, f"seed={seed}"))], gallery)
    if fail_on_lost and not recipe.judges:
        raise UsageError(
            f"--fail-on-lost: {recipe.name} has correlation alone, which cannot tell when it is lost; "
            "give likelihood.contour or likelihood.histogram too, or leave the option out"
        )
    clips = list({absolute(clip): clip for clip in reversed(inputs)}.values())[::-1]
    folders, wanted = _places(clips, recipe.name, out, formats)
    workers = min(workers, len(clips))
    with Stop().listening() as ending, contextlib.closing(progress(quiet)) as shown:
        jobs = [
            Job(
                clip=clip,
                recipe=recipe,
                out=folder,
                formats=wanted,
                video=not no_video and folder is not None,
                init_frame=init_frame,
                overwrite=overwrite,
                threads=threads or max(1, cores() // workers),
                **extent._replace(fps=None if clip.is_file() else extent.fps)._asdict(),
            )
            for clip, folder in zip(clips, folders, strict=True)
        ]
        code = _one(jobs[0], ending, shown) if len(jobs) == 1 else _several(jobs, workers, ending, shown)
    return ExitCode.DONE if code is ExitCode.LOST and not fail_on_lost else code


def _places(
    clips: list[Path], recipe: str, out: str | None, formats: tuple[Format, ...] | None
) -> tuple[list[Path | None], tuple[Format, ...]]:
    """The folder of each clip's results, None for standard output, and the formats to write."""
    from facetrack_cli.runs.batch import folders

    if out == "-":
        if len(clips) > 1:
            raise UsageError("-o - streams one clip; give one INPUT, or a folder with --out")
        if formats is not None and len(formats) > 1:
            raise UsageError("-o - streams one format; give one with --format")
        return [None], formats or ("csv",)
    if out == "":
        raise OutputError("--out is empty; name a folder, or - for standard output")
    one = out is not None and len(clips) == 1
    names = [""] if one else folders(clips, recipe)
    return [Path(out or ".") / name for name in names], formats or ("csv", "json")


def _one(job: Job, stop: Stop, shown: Progress) -> ExitCode:
    """Run one clip; its error is the command's."""
    from facetrack_cli.runs.batch import use_threads
    from facetrack_cli.runs.clip import run
    from facetrack_cli.runs.outputs import check

    check(job)
    use_threads(job.threads)
    shown.begin(job.clip.name, "frames", None)
    outcome = run(job, stop, shown.update)
    shown.close()
    if isinstance(outcome.error, BrokenPipeError):
        raise outcome.error
    _report(outcome, shown)
    if outcome.error is not None:
        raise outcome.error
    return stop.code or (ExitCode.LOST if outcome.lost_at_end else ExitCode.DONE)


def _several(jobs: list[Job], workers: int, stop: Stop, shown: Progress) -> ExitCode:
    """Run a batch; each clip's line is printed as it ends, and the failures are counted."""
    from facetrack_cli.runs.batch import check_all, run_batch, use_threads

    if workers == 1:
        use_threads(jobs[0].threads)
    refused, accepted = check_all(jobs)
    failed = lost = 0
    for ended in itertools.chain(refused, run_batch(accepted, workers, stop, shown)):
        if ended.outcome is not None:
            _report(ended.outcome, shown, named=True)
            lost += bool(ended.outcome.lost_at_end)
        if ended.failure:
            failed += 1
            named = "" if str(ended.clip) in ended.failure else f"{ended.clip}: "
            shown.error(f"facetrack: error: {named}{ended.failure}")
    shown.close()
    if stop.code is not None:
        return stop.code
    if failed:
        shown.say(f"{failed} of {len(jobs)} inputs failed")
    return ExitCode.BATCH if failed else ExitCode.LOST if lost else ExitCode.DONE


def _report(outcome: Outcome, shown: Progress, *, named: bool = False) -> None:
    """Warnings, which say of which clip they are if `named`, and the summary."""
    for warning in outcome.warnings:
        of = f"{outcome.clip}: " if named and str(outcome.clip) not in warning else ""
        shown.say(f"facetrack: warning: {of}{warning}")
    shown.say(outcome.summary())
