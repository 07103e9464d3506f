"""facetrack run: clips in, trajectories and annotated videos out."""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FRAME, Whole, rate
from facetrack_cli.core.errors import ExitCode, OutputError, UsageError
from facetrack_cli.trajectory.writers import FORMATS, Format

if TYPE_CHECKING:
    from fractions import Fraction

    from facetrack_cli.core.types import Box
    from facetrack_cli.runs.job import Job, Outcome
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop


def _formats(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[Format, ...] | None:
    if value is None:
        return None
    names = [name.strip().lower() for name in value.split(",") if name.strip()]
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        raise click.BadParameter(f"{','.join(unknown) or value!r}: choose among {', '.join(FORMATS)}")
    return tuple(form for form in FORMATS if form in names)


@click.command()
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--config", metavar="RECIPE", default="factorized", show_default=True, help="Recipe: a file, or a name.")
@click.option(
    "--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Override a key of the recipe; repeatable."
)
@click.option("--seed", metavar="N", type=Whole(min=0), help="Seed of the random numbers, instead of the recipe's.")
@options.gallery
@options.init
@options.face_box
@click.option(
    "--init-frame", metavar="N", type=FRAME, help="Frame of --init or --box, or where the search for a face begins."
)
@click.option(
    "-o", "--out", metavar="DIR", help="Folder for results [default: ./<clip>-<recipe>]; - streams to stdout."
)
@click.option("--no-video", is_flag=True, help="Do not write annotated.mp4.")
@click.option(
    "--format",
    "formats",
    metavar="LIST",
    callback=_formats,
    help="csv, json, jsonl [default: csv,json; csv with -o -].",
)
@click.option("--start", metavar="N", type=FRAME, default=0, help="First frame, from 0.")
@click.option("--stop", metavar="N", type=FRAME, help="Frame to stop before.")
@click.option("--fps", metavar="RATE", callback=rate, help="Frames per second of image folders.")
@click.option("--overwrite", is_flag=True, help="Replace results that are there already.")
@click.option("--fail-on-lost", is_flag=True, help="Exit with 4 if a part is lost in the last frame.")
@click.option("--threads", metavar="N", type=Whole(min=1), help="Threads a clip [default: the cores, shared by -j].")
@click.option("-j", "--jobs", "workers", metavar="N", type=Whole(min=1), default=1, help="Clips at a time.")
@click.option("--quiet", "-q", is_flag=True, help="Say nothing but errors.")
@click.pass_context
def command(
    ctx: click.Context,
    inputs: tuple[Path, ...],
    config: str,
    overrides: tuple[str, ...],
    seed: int | None,
    gallery: str | None,
    init: str | None,
    box: Box | None,
    init_frame: int | None,
    out: str | None,
    no_video: bool,
    formats: tuple[Format, ...] | None,
    start: int,
    stop: int | None,
    fps: Fraction | None,
    overwrite: bool,
    fail_on_lost: bool,
    threads: int | None,
    workers: int,
    quiet: bool,
) -> None:
    """Track faces, heads and hands in videos and image folders.

    Each INPUT gets a folder with annotated.mp4, trajectory.csv and trajectory.json. The track starts from --init or
    --box, else from <clip>.init.yaml beside the clip, else from the first face that a Haar cascade finds.

    Recipes of points follow the features of a face; within --box they are placed by the picture. Recipes of regions
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
    from facetrack_cli.recipe.gallery_option import with_gallery
    from facetrack_cli.recipe.load import load_recipe
    from facetrack_cli.runs.batch import absolute
    from facetrack_cli.runs.job import HAAR, Job
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.runs.workers import cores
    from facetrack_cli.tracking.build.build import check_gallery

    if init is not None and box is not None:
        raise UsageError("--init and --box both say where the track starts; give one of them")
    if stop is not None and stop <= start:
        raise UsageError(f"--stop {stop} leaves no frame after --start {start}; it is the frame to stop before")
    if fps is not None and all(clip.is_file() for clip in inputs):
        raise UsageError("--fps is for image folders; a video brings its own rate")
    if init == "":
        raise UsageError("--init is empty; name an init file, or haar to look for a face")
    if seed is not None:
        overrides = (*overrides, f"seed={seed}")
    [recipe] = with_gallery([load_recipe(config, overrides)], gallery)
    check_gallery(recipe)
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
                init=None if init is None else HAAR if init == HAAR else Path(init),
                box=box,
                init_frame=init_frame,
                start=start,
                stop=stop,
                fps=None if clip.is_file() else fps,
                overwrite=overwrite,
                threads=threads or max(1, cores() // workers),
            )
            for clip, folder in zip(clips, folders, strict=True)
        ]
        code = _one(jobs[0], ending, shown) if len(jobs) == 1 else _several(jobs, workers, ending, shown)
        if code is ExitCode.LOST and not fail_on_lost:
            code = ExitCode.DONE
    ctx.exit(code)


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
    names = folders(clips, recipe)
    if out is not None and len(clips) == 1:
        return [Path(out)], formats or ("csv", "json")
    return [Path(out or ".") / name for name in names], formats or ("csv", "json")


def _one(job: Job, stop: Stop, shown: Progress) -> ExitCode:
    """Run one clip; its error is the command's."""
    from facetrack_cli.runs.clip import run
    from facetrack_cli.runs.outputs import check
    from facetrack_cli.runs.workers import use_threads

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
    if stop.code is not None:
        return stop.code
    return ExitCode.LOST if outcome.lost_at_end else ExitCode.DONE


def _several(jobs: list[Job], workers: int, stop: Stop, shown: Progress) -> ExitCode:
    """Run a batch; each clip's line is printed as it ends, and the failures are counted."""
    from facetrack_cli.runs.batch import check_all, run_batch
    from facetrack_cli.runs.workers import use_threads

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
    if failed and stop.code is None:
        shown.say(f"{failed} of {len(jobs)} inputs failed")
    if stop.code is not None:
        return stop.code
    return ExitCode.BATCH if failed else ExitCode.LOST if lost else ExitCode.DONE


def _report(outcome: Outcome, shown: Progress, *, named: bool = False) -> None:
    """Warnings, which say of which clip they are if `named`, and the summary."""
    for warning in outcome.warnings:
        of = f"{outcome.clip}: " if named and str(outcome.clip) not in warning else ""
        shown.say(f"facetrack: warning: {of}{warning}")
    shown.say(outcome.summary())
