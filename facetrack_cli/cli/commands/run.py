"""facetrack run: clips in, trajectories and annotated videos out."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FRAME, Command, Extent, Text, extent_options, flag, option, refuse, say
from facetrack_cli.core.errors import ExitCode, FacetrackError, UsageError, about

if TYPE_CHECKING:
    from facetrack_cli.recipe.model import Recipe
    from facetrack_cli.runs.plan import Job, Outcome
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trajectory.writers import Format

    Batch: TypeAlias = Callable[..., Iterator[Outcome]]  # of jobs, stop, progress


_UNITS = {"s": 1.0, "m": 60.0, "h": 3600.0, "f": 1.0}
MAX_DONE_LINES = 20  # for clips that were done before; of more clips there is one line
MOST_THREADS = 4  # of a clip: with 8 and 16 on 16 cores it takes a fifth longer


def _shard(value: str) -> tuple[int, int]:
    """The number of one of N jobs, and N."""
    with contextlib.suppress(ValueError):
        number, count = map(int, value.split("/"))
        if 0 < number <= count:
            return number, count
    raise click.BadParameter(f"{value!r}: give I/N, as 3/20, the third of twenty jobs; the first is 1/20")


def _length(value: str) -> tuple[float, bool]:
    """A length in s, or in frames, and whether it is the latter."""
    with contextlib.suppress(ValueError, KeyError):
        if 0 < (length := float(value[:-1]) * _UNITS[value[-1:].lower()]) < 1e9:
            return length, value[-1:].lower() == "f"
    raise click.BadParameter(f"{value!r}: is no length of a chunk; give one as 10m, 90s, 1h, or 5000f for frames")


def _formats(value: str) -> tuple[Format, ...]:
    from facetrack_cli.trajectory.writers import FORMATS

    names = [name.strip().lower() for name in value.split(",") if name.strip()]
    unknown = [name for name in names if name not in FORMATS]
    if unknown or not names:
        raise click.BadParameter(f"{','.join(unknown) or value!r}: choose among {', '.join(FORMATS)}")
    return tuple(form for form in FORMATS if form in names)


@click.command(
    cls=Command,
    sections={
        "init": "Where the track begins", "config": "How it tracks", "out": "What it writes",
        "overwrite": "How it runs", "jobs": "Many clips and long clips",
    },
    basic="init box start stop faces config overrides out no_video smooth overwrite jobs",
)  # fmt: skip
@click.argument("inputs", type=options.INPUT, nargs=-1, required=True)
@extent_options
@option(
    "--faces", type=click.Choice(["one", "all"]), metavar="WHICH", default="one", show_default=False,
    help="`one`, the largest face that stays, or `all`: everybody, over cuts, see docs/film.md [default: one].",
)  # fmt: skip
@option("--init-frame", type=FRAME, help="Frame of --init or --box, or where the search for a face begins.")
@option("--stream", type=FRAME, help="Video stream of a file with several, by FFmpeg's number [default: FFmpeg's own].")
@options.config
@options.set_("Override a key of the recipe; repeatable.")
@option("--seed", type=int, metavar="N", help="Seed of the random numbers, instead of the recipe's.")
@option(
    "--gallery", type=options.GALLERY,
    help="People to recognise, as facetrack gallery fit writes them; with --faces all as facetrack people --save does.",
)  # fmt: skip
@option(
    "-o", "--out", type=options.FOLDER_OR_DASH,
    help="Folder for results [default: ./<clip>-<recipe>, with --set]; - streams to stdout.",
)  # fmt: skip
@flag("--no-video", help="Do not write annotated.mp4.")
@option("--format", "formats", type=Text("LIST", _formats), help="csv, json, jsonl [default: csv,json; csv with -o -].")
@flag("--smooth", help="Then smooth it: every row given the whole clip, see docs/smooth.md.")
@option("--lag", type=click.IntRange(1, 1000), help="Rows N frames later, given the frames up to then.")
@options.overwrite
@flag("--no-resume", help="Track from the start what was interrupted, not from its last checkpoint.")
@flag("--strict", help="Exit with 3 if a clip is cut short or damaged.")
@flag("--fail-on-lost", help="Exit with 4 if a part is lost in the last frame.")
@flag("--live", help="Write a JSON line a frame to stdout as it comes; INPUT may be a camera, an address, or -.")
@options.quiet
@options.jobs("Clips at a time.")
@option("--threads", type=click.IntRange(1, 1000), help="Threads a clip [default: the cores, shared by -j, at most 4].")
@option("--shard", type=Text("I/N", _shard), help="Track every N-th clip alone, from the I-th on: one of N jobs.")
@option(
    "--split", type=Text("LENGTH", _length),
    help="Track one long clip in chunks of 10m, 90s, 1h or 5000f (frames), see docs/pipelines.md.",
)  # fmt: skip
@flag("--retry-failed", help="Try clips again that have failed before.")
@option(
    "--cluster", type=Text("WHERE"),
    help="Workers of Dask: tcp://HOST:PORT, or a scheduler file; see docs/pipelines.md.",
)  # fmt: skip
def run_command(
    inputs: tuple[Path, ...], extent: Extent, faces: Literal["one", "all"], init_frame: int | None, stream: int | None,
    config: str | None, overrides: tuple[str, ...], seed: int | None, gallery: str | None, out: str | None,
    no_video: bool, formats: tuple[Format, ...] | None, smooth: bool, lag: int | None, overwrite: bool, no_resume: bool,
    strict: bool, fail_on_lost: bool, live: bool, quiet: bool, jobs: int, threads: int | None,
    shard: tuple[int, int] | None, split: tuple[float, bool] | None, retry_failed: bool, cluster: str | None,
) -> int:  # fmt: skip
    """Track faces, heads and hands in videos and image folders.

    \b
      facetrack run clip.mp4                           # find and follow a face
      facetrack run clip.mp4 --box 110,93,56,64        # follow what is in a box
      facetrack run clips/ -j 4 --no-video -o results  # many clips

    Each clip gets a folder with annotated.mp4, trajectory.csv and trajectory.json. An INPUT is a video, a folder of
    images, a folder of such clips, a quoted glob, or @list.txt with a path a line (@- reads it from standard input).

    The track begins at --init or --box, else at <clip>.init.yaml beside the clip, else at the first face that a
    detector finds in several frames. Without --config, what is in --box is followed as a box, else the features of a
    face are.

    With several clips, --out holds a folder for each; a clip that fails does not stop the others. The same command
    again skips clips that are done, and goes on with clips that were interrupted. Run twice at once, also on two
    machines, it shares the clips. facetrack status tells how far they are.

    \b
    Examples:
      facetrack run clip.mp4 --config signer --smooth
      facetrack run film.mp4 --faces all -o film
      facetrack run clip.mp4 --config sir --set filter.particles=500 -o out
      facetrack run 0 --live
      facetrack run @list.txt --shard 3/20 -o results
      facetrack run day.mp4 --split 10m -j 8 -o day

    \b
    Exit codes: 0 done (also if a clip was cut short or is damaged: a warning
    says so), 2 usage, recipe or output, 3 input (and --strict),
    4 lost (--fail-on-lost), 5 some of several inputs failed,
    130 interrupted, 143 terminated.
    """
    from facetrack_cli.recipe.load import default_recipe, load_recipe
    from facetrack_cli.recipe.model import seeded
    from facetrack_cli.runs.batch import expand, folders, run_batch, variant_name
    from facetrack_cli.runs.clip import run
    from facetrack_cli.runs.plan import Job, Split, check_smoothing, follows_everyone
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.seeds import load_recipes
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.runs.workers import cores, share_threads
    from facetrack_cli.video.source import brings_rate, is_live

    wanted = (default_recipe(box=extent.box is not None) if config is None else config), overrides
    cast = faces == "all" and follows_everyone(load_recipe(*wanted))  # people are named at the end, by the looks of all
    recipe = seeded(load_recipes([wanted], None if cast else gallery)[0], seed)
    if live or any(is_live(path) for path in inputs):
        return _live(inputs, live, out, extent, recipe, faces, gallery)
    remote, csv_alone = cluster is not None, formats == ("csv",)
    replaced = "--overwrite would replace what the other shards did; remove the folder before them"
    blind = f"--fail-on-lost: {recipe.name} cannot tell when it is lost; leave it out"
    whole = "goes over the whole clip, --split cuts it in chunks; give one of them"
    refuse(
        (fail_on_lost and not recipe.judges, blind),
        (remote and out == "-", "-o - streams one clip from this machine; name a folder, or leave --cluster out"),
        (remote and jobs > 1, "--cluster has workers of its own, -j those of this machine; give one of them"),
        (remote and split, "--split tracks its chunks with -j or --shard; leave --cluster out"),
        (split and out == "-", "--split keeps its chunks in a folder; name one with --out"),
        (split and shard and overwrite, replaced),
        (split and (smooth or lag), f"{'--smooth' if smooth else '--lag'} {whole}"),
        (smooth and lag, "--lag smooths while it runs, --smooth after it; give one of them"),
        (smooth and out == "-", "--smooth reads the run's files again, and -o - writes none; take --lag, or a folder"),
        (smooth and csv_alone, "--smooth reads the rows from JSON; give --format csv,json"),
        (out == "-" and formats and len(formats) > 1, "-o - streams one format; give one with --format"),
    )
    if cluster is not None:
        from facetrack_cli.runs.batch import address_of, run_cluster

        cluster = address_of(cluster)
    clips, several = expand(inputs)
    extent.check()
    several = several or (shard is not None and split is None)
    rated = extent.fps is not None and all(clip.is_file() and brings_rate(clip) for clip in clips)
    refuse(
        (rated, "--fps is for images; a video brings its own rate"),
        (split and len(clips) > 1, f"--split cuts one clip, and {len(clips)} are given; split one at a time"),
        (several and out == "-", "-o - streams one clip; give one INPUT, or a folder with --out"),
    )
    if smooth:
        check_smoothing(recipe)
    places: list[Path | None] = [None]  # for standard output
    if out != "-":
        names = [""] if out and not several else folders(clips, variant_name(recipe.name, overrides))
        places = [Path(out or ".") / name for name in names]
        if several and out:
            from facetrack_cli.run_folder.status import write_batch

            write_batch(Path(out), recipe.name, clips, names)
    first, step = (1, 1) if split else shard or (1, 1)
    clips, places = clips[first - 1 :: step], places[first - 1 :: step]
    workers = jobs if split else max(1, min(jobs, len(clips)))
    with Stop().listening() as stop, progress(quiet) as shown:
        todo = [
            Job(
                clip=clip,
                recipe=recipe,
                out=folder,
                formats=formats or (("csv",) if out == "-" else ("csv", "json")),
                video=not no_video and folder is not None,
                init_frame=init_frame,
                stream=stream,
                faces=faces,
                gallery=Path(gallery) if gallery and cast else None,
                overwrite=overwrite,
                lag=lag or 0,
                smooth=smooth,
                strict=strict,
                resume=not no_resume,
                batch=several,
                retry_failed=retry_failed,
                split=None if split is None else Split(*split),
                threads=threads or (1 if cluster else min(MOST_THREADS, max(1, cores() // workers))),
                **vars(extent) | ({"fps": None} if several and brings_rate(clip) else {}),
            )
            for clip, folder in zip(clips, places, strict=True)
        ]
        if split is not None:
            from facetrack_cli.runs.split import run_chunks

            with about(clips[0].name):
                code = _one(run_chunks(todo[0], workers, stop, shown, shard or (1, 1)), stop, shown)
        elif cluster is not None:
            code = _several(todo, partial(run_cluster, address=cluster), stop, shown)
        elif several:
            code = _several(todo, partial(run_batch, workers=workers), stop, shown)
        else:
            share_threads(todo[0].threads)
            shown.begin(clips[0].name)
            code = _one([("", run(todo[0], stop, shown.update, shown.looked))], stop, shown)
    return ExitCode.DONE if code is ExitCode.LOST and not fail_on_lost else code


def _live(
    inputs: tuple[Path, ...], asked: bool, out: str | None, extent: Extent, recipe: Recipe, faces: str,
    gallery: str | None,
) -> int:  # fmt: skip
    """Track what comes from a camera, a pipe or a clip; the exit code."""
    from facetrack_cli.runs.live import LiveCast, follow, images_of
    from facetrack_cli.runs.plan import follows_everyone
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trackers.people.descriptor import load_people

    ctx, typed = click.get_current_context(), click.core.ParameterSource.COMMANDLINE
    fit = {"inputs", "config", "overrides", "seed", "gallery", "init", "box", "out", "live", "faces", "no_video"}
    others = [param for param in ctx.command.params if param.name not in fit | {"quiet"}]
    unfit = [max(param.opts, key=len) for param in others if ctx.get_parameter_source(str(param.name)) is typed]
    refuse(
        (not asked, f"{inputs[0]}: has no end; give --live, which writes results as they come"),
        (len(inputs) > 1, "--live follows one INPUT; give one"),
        (out not in (None, "-"), "--live writes to stdout; leave --out out"),
        (unfit, f"--live has no {unfit[0] if unfit else ''}: frames are tracked as they come; leave it out"),
    )
    init, cast = extent.box if extent.box is not None else extent.init, None
    if faces == "all":
        if not follows_everyone(recipe) or isinstance(init, Path | tuple):
            raise UsageError("--faces all --live looks for every face; leave out --init, --box, and --config but face")
        cast = LiveCast(init, 25.0, {} if gallery is None else load_people(Path(gallery)))
    with Stop().listening() as stop:
        follow(images_of(inputs[0], say), recipe, init, click.echo, stop, cast)
    return stop.code or ExitCode.DONE


def _one(outcomes: Iterable[tuple[str, Outcome]], stop: Stop, shown: Progress) -> ExitCode:
    """One clip, with "", after its chunks, if it has any. Their errors stop nothing; its own is the command's."""
    whole, failed = None, False
    for chunk, outcome in outcomes:
        if not chunk:
            whole = outcome
        elif outcome.failure is not None:
            failed = True
            shown.say(f"facetrack: warning: {chunk}: {outcome.failure}")
        elif not outcome.again and outcome.frames:
            shown.say(outcome.summary())
    shown.close()
    if whole is None:
        return stop.code or ExitCode.DONE
    if whole.failure is None or (whole.frames and not isinstance(whole.failure, BrokenPipeError)):
        _report(whole, shown)
    if whole.failure is not None:
        if failed and isinstance(whole.failure, FacetrackError):
            whole.failure.exit_code = ExitCode.BATCH
        raise whole.failure
    return stop.code or (ExitCode.LOST if whole.lost_at_end else ExitCode.DONE)


def _several(jobs: list[Job], batch: Batch, stop: Stop, shown: Progress) -> ExitCode:
    """Run a batch; each clip's line is printed as it ends, and the failures are counted."""
    from facetrack_cli.run_folder.status import clip_status, worst
    from facetrack_cli.runs.batch import check_all

    decided, left = check_all(jobs)
    done = sum(outcome.again and outcome.failure is None for outcome in decided)
    if done > MAX_DONE_LINES:
        shown.say(f"{done} clips: done before")
    failed = before = lost = 0
    for outcome in itertools.chain(decided, batch(left, stop=stop, progress=shown)):
        with about(outcome.source.name):
            if outcome.frames or outcome.failure is None:
                if not outcome.again or done <= MAX_DONE_LINES:
                    _report(outcome, shown, named=True)
                lost += bool(outcome.lost_at_end)
            if outcome.failure is not None:
                failed += 1
                before += outcome.again
                of = "" if str(outcome.source) in str(outcome.failure) else f"{outcome.source}: "
                shown.error(f"facetrack: error: {of}{outcome.failure}")
    shown.close()
    if stop.code is not None:
        return stop.code
    rows = [clip_status(job.out, job.out.name, str(job.clip)) for job in jobs if job.out is not None]
    for line in worst(rows) if any(row.look for row in rows) else ():  # what failed has been told
        shown.say(line)
    if failed:
        again = f", {before} of them before; --retry-failed tries those again" if before else ""
        shown.say(f"{failed} of {len(jobs)} inputs failed{again}")
    return ExitCode.BATCH if failed else ExitCode.LOST if lost else ExitCode.DONE


def _report(outcome: Outcome, shown: Progress, *, named: bool = False) -> None:
    """What the search took, warnings, the summary, the verdict; the next step, if no other clip is `named`."""
    if outcome.note:
        shown.say(f"{outcome.source}: {outcome.note}")
    for warning in outcome.warnings:
        of = f"{outcome.source}: " if named and str(outcome.source) not in warning else ""
        shown.say(f"facetrack: warning: {of}{warning}")
    shown.say(outcome.summary())
    if outcome.stopped or outcome.failure is not None:
        return
    if outcome.verdict and not (named and not outcome.doubts):
        shown.say(f"{outcome.source}: {outcome.verdict}")
    if not named and (what := outcome.next_step()):
        shown.say(what)
