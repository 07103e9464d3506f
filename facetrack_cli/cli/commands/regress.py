"""facetrack regress: clips against their goldens, for CI."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Whole, flag, option
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.goldens.check import Checked


@click.command()
@click.argument("folder", metavar="DIR", type=FILE)
@option(
    "--config configs",
    "RECIPE",
    "Only this recipe, a file or a name; repeatable [default: all that have goldens].",
    multiple=True,
)
@option("--set overrides", "KEY=VALUE", "Check with this key changed; repeatable.", multiple=True)
@option("--gallery", "FILE", "People that recipes with recognition know; a golden remembers its own.", type=FILE)
@flag("--update", "Record goldens instead: of --config, else of all that have one.")
@option("--seeds", "N", "Runs to record a golden from [default: 40].", type=Whole(min=20, max=500))
@option("--stop", "N", "Record up to this frame only; for slow trackers.", type=Whole(min=2))
@option("--junit", "FILE", "Write JUnit XML, for CI services.", type=FILE)
@option("--json json_file", "FILE", "Write the results as JSON.", type=FILE)
@options.overwrite
@options.jobs("Goldens at a time.")
@flag("--quiet -q", "No progress.")
def command(
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
) -> int:
    """Check clips against their golden results.

    Runs every clip in DIR that has a golden, DIR/goldens/<clip>.<recipe>.json, with a few seeds, and compares them
    with what was recorded from many: position, spread, step length, effective sample size, confidence, frames lost.
    Other seeds pass, and so does the rounding of another processor: of checks of an unchanged tracker less than 1 in
    1000 fails.

    A recipe that was edited is named, and checked all the same. One that this installation cannot run is skipped.

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
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.evaluation.goldens.output import as_json, as_junit, summary
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
    with Stop().listening() as stopped, contextlib.closing(progress(quiet)) as shown:
        shown.begin(str(folder), "frames", None)
        runs: dict[str, Any] = {
            "gallery": gallery,
            "workers": workers,
            "stopped": stopped,
            "report": lambda done, total: shown.update(done, total or None),
        }
        if update:
            failed = _update(folder, configs, seeds or 40, stop, runs)
            if stopped.code is not None:
                shown.say(f"{stopped.reason}; goldens that were not written are as they were")
            return stopped.code or (ExitCode.BATCH if failed else ExitCode.DONE)
        began = time.monotonic()
        found, total = _check(folder, configs, overrides, runs)
        if stopped.code is not None:
            shown.say(f"{stopped.reason} after {len(found)} of {total} goldens")
            return stopped.code
        seconds = time.monotonic() - began
        if junit is not None:
            write_new(junit, as_junit(found, seconds).encode(), overwrite=overwrite)
        if json_file is not None:
            write_new(json_file, as_json(found).encode(), overwrite=overwrite)
        _print(summary(found, seconds))
    return stopped.code or (ExitCode.REGRESSION if any(one.status == "fails" for one in found) else ExitCode.DONE)


def _check(
    folder: Path, configs: tuple[str, ...], overrides: tuple[str, ...], runs: dict[str, Any]
) -> tuple[list[Checked], int]:
    """Check the goldens, and print a line of each; what was found, and how many goldens there are."""
    from facetrack_cli.evaluation.goldens.check import check, select
    from facetrack_cli.evaluation.goldens.output import line
    from facetrack_cli.recipe.load import load_recipe

    given = [load_recipe(name, overrides) for name in configs]
    goldens = select(folder, given)
    found = []
    for one in check(folder, goldens, given, overrides, **runs):
        found.append(one)
        _print(*line(one))
    return found, len(goldens)


def _update(folder: Path, configs: tuple[str, ...], seeds: int, stop: int | None, runs: dict[str, Any]) -> bool:
    """Record goldens, and print a line of each; whether one could not be recorded."""
    from facetrack_cli.evaluation.goldens.check import update

    failed = False
    for one in update(folder, configs, seeds, stop, **runs):
        what = f"wrote {one.path} ({one.message})" if one.path else f"skipped: {one.message}"
        if not (one.path or one.skipped):
            failed = True
            what = f"not recorded: {one.message}"
        _print(f"{one.clip} {one.recipe}: {what}")
    return failed


def _print(*lines: str) -> None:
    """Each as it comes, also into a pipe; a name may hold a line break, a line must not."""
    for text in lines:
        click.echo(" ".join(text.splitlines()))
