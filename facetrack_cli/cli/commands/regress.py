"""facetrack regress: clips against their goldens, for CI."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from facetrack_cli.cli.options import Whole
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.goldens.check import Checked
    from facetrack_cli.runs.progress import Progress
    from facetrack_cli.runs.signals import Stop


@click.command()
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option(
    "--config",
    "configs",
    metavar="RECIPE",
    multiple=True,
    help="Only this recipe, a file or a name; repeatable [default: all that have goldens].",
)
@click.option("--set", "overrides", metavar="KEY=VALUE", multiple=True, help="Check with this key changed; repeatable.")
@click.option(
    "--gallery", metavar="FILE", type=click.Path(path_type=Path),
    help="People that recipes with recognition know; a golden remembers its own.",
)  # fmt: skip
@click.option("--update", is_flag=True, help="Record goldens instead: of --config, else of all that have one.")
@click.option("--seeds", metavar="N", type=Whole(min=20, max=500), help="Runs to record a golden from [default: 40].")
@click.option("--stop", metavar="N", type=Whole(min=2), help="Record up to this frame only; for slow trackers.")
@click.option("--junit", metavar="FILE", type=click.Path(path_type=Path), help="Write JUnit XML, for CI services.")
@click.option("--json", "json_file", metavar="FILE", type=click.Path(path_type=Path), help="Write the results as JSON.")
@click.option("--overwrite", is_flag=True, help="Replace --junit and --json files that are there already.")
@click.option("-j", "--jobs", "workers", metavar="N", type=Whole(min=1), default=1, help="Goldens at a time.")
@click.option("--quiet", "-q", is_flag=True, help="No progress.")
@click.pass_context
def command(
    ctx: click.Context,
    folder: Path,
    configs: tuple[str, ...],
    overrides: tuple[str, ...],
    gallery: Path | None,
    update: bool,
    seeds: int | None,
    stop: int | None,
    junit: Path | None,
    json_file: Path | None,
    overwrite: bool,
    workers: int,
    quiet: bool,
) -> None:
    """Check clips against their golden results.

    Runs every clip in DIR that has a golden, DIR/goldens/<clip>.<recipe>.json, with a few seeds, and compares them
    with what was recorded from many: position, spread, step length, effective sample size, confidence, frames lost.
    Other seeds pass, and so does the rounding of another processor: of checks of an unchanged tracker less than 1 in
    1000 fails.

    A recipe that was edited is told, and checked all the same. One that this installation cannot run is skipped.

    \b
    Examples:
      facetrack regress sample_videos -j 2 --junit regress.xml
      facetrack regress clips --config factorized --update
      facetrack regress clips --config mine.yaml --gallery people.npz --update
      facetrack regress clips --update --seeds 60
      facetrack regress sample_videos --config sir --set motion.sigma=0.13

    \b
    Exit codes: 0 all pass, 2 usage, recipe or output, 3 input, or no goldens,
    5 some could not be recorded, 6 a regression, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop

    if update and (overrides or junit or json_file):
        raise UsageError("--update records recipes as they are; leave --set, --junit and --json to a check")
    if not update and (seeds is not None or stop is not None):
        raise UsageError("--seeds and --stop go with --update; a check takes them from the golden")
    if junit is not None and junit == json_file:
        raise UsageError("--junit and --json name the same file; give two names")
    for path in (junit, json_file):
        if path is not None:
            check_new(path, overwrite=overwrite)
    if gallery is not None:  # a mistake in the option is no regression
        from facetrack_cli.recipe.gallery_option import check_file
        from facetrack_cli.tracking.identity.gallery import load_gallery

        check_file(str(gallery))
        load_gallery(gallery)
    with Stop().listening() as ending, contextlib.closing(progress(quiet)) as shown:
        shown.begin(str(folder), "frames", None)
        if update:
            code = _update(folder, configs, gallery, seeds or 40, stop, workers, ending, shown)
        else:
            code = _check(folder, configs, overrides, gallery, junit, json_file, overwrite, workers, ending, shown)
    ctx.exit(ending.code or code)


def _check(
    folder: Path,
    configs: tuple[str, ...],
    overrides: tuple[str, ...],
    gallery: Path | None,
    junit: Path | None,
    json_file: Path | None,
    overwrite: bool,
    workers: int,
    ending: Stop,
    shown: Progress,
) -> ExitCode:
    from facetrack_cli.core.files import write_new
    from facetrack_cli.evaluation.goldens.check import check, select
    from facetrack_cli.evaluation.goldens.output import as_json, as_junit, line, summary
    from facetrack_cli.recipe.load import load_recipe

    began = time.monotonic()
    given = [load_recipe(name, overrides) for name in configs]
    goldens = select(folder, given)
    found: list[Checked] = []
    for one in check(
        folder,
        goldens,
        given,
        overrides,
        gallery=gallery,
        workers=workers,
        stopped=ending,
        report=lambda done, total: shown.update(done, total or None),
    ):
        found.append(one)
        _print(line(one))
    if ending.code is not None:
        shown.say(f"{ending.reason} after {len(found)} of {len(goldens)} goldens")
        return ending.code
    seconds = time.monotonic() - began
    if junit is not None:
        write_new(junit, as_junit(found, seconds).encode(), overwrite=overwrite)
    if json_file is not None:
        write_new(json_file, as_json(found).encode(), overwrite=overwrite)
    _print([summary(found, seconds)])
    return ExitCode.REGRESSION if any(one.status == "fails" for one in found) else ExitCode.DONE


def _update(
    folder: Path,
    configs: tuple[str, ...],
    gallery: Path | None,
    seeds: int,
    stop: int | None,
    workers: int,
    ending: Stop,
    shown: Progress,
) -> ExitCode:
    from facetrack_cli.evaluation.goldens.check import update

    failed = False
    for one in update(
        folder,
        configs,
        seeds,
        stop,
        gallery=gallery,
        workers=workers,
        stopped=ending,
        report=lambda done, total: shown.update(done, total or None),
    ):
        what = f"wrote {one.golden} ({one.message})" if one.status == "ok" else f"skipped: {one.message}"
        if one.status == "fails":
            failed = True
            what = f"not recorded: {one.message}"
        _print([f"{one.clip} {one.recipe}: {what}"])
    if ending.code is not None:
        shown.say(f"{ending.reason}; goldens that were not written are as they were")
        return ending.code
    return ExitCode.BATCH if failed else ExitCode.DONE


def _print(lines: Sequence[str]) -> None:
    """Each as it comes, also into a pipe; a name may hold a line break, a line must not."""
    for text in lines:
        click.echo(" ".join(text.splitlines()))
