"""facetrack regress: clips against their goldens, for CI."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import flag, option
from facetrack_cli.cli.types import FILE, FOLDER, RECIPE, Whole
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.goldens.check import Checked


@click.command()
@click.argument("folder", type=FOLDER)
@option(
    "--config", type=RECIPE, multiple=True,
    help="Only this recipe, a file or a name; repeatable [default: all that have goldens].",
)  # fmt: skip
@options.set_("Check with this key changed; repeatable.")
@option("--gallery", type=FILE, help="People that recipes with recognition know; a golden remembers its own.")
@flag("--update", help="Record goldens instead: of --config, else of all that have one.")
@option("--seeds", type=Whole(min=20, max=500), help="Runs to record a golden from [default: 40].")
@option("--stop", type=Whole(min=2), help="Record up to this frame only; for slow trackers.")
@option("--junit", type=FILE, help="Write JUnit XML, for CI services.")
@option("--json", type=FILE, help="Write the results as JSON.")
@options.overwrite
@options.jobs("Goldens at a time.")
@flag("--quiet", "-q", help="No progress.")
def command(
    folder: Path, config: tuple[str, ...], overrides: tuple[str, ...], gallery: Path | None, update: bool,
    seeds: int | None, stop: int | None, junit: Path | None, json: Path | None, overwrite: bool, jobs: int, quiet: bool,
) -> int:  # fmt: skip
    """Check clips against their golden results.

    Runs every clip in DIR that has a golden, DIR/goldens/<clip>.<recipe>.json, with a few seeds, and compares them
    with what was recorded from many: position, spread, step length, effective sample size, confidence, frames lost.
    A check fails if all tested seeds lie outside of the range of the recorded seeds. Rounding on another processor
    passes.

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
    from facetrack_cli.core.files import check_new
    from facetrack_cli.recipe.gallery_option import check_file
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.tracking.identity.gallery import load_gallery

    if update and (overrides or junit or json):
        raise UsageError("--update records recipes as they are; leave --set, --junit and --json to a check")
    if not update and (seeds is not None or stop is not None):
        raise UsageError("--seeds and --stop go with --update; a check takes them from the golden")
    if junit is not None and junit == json:
        raise UsageError("--junit and --json name the same file; give two names")
    for path in filter(None, (junit, json)):
        check_new(path, overwrite=overwrite)
    reports = junit, json, overwrite
    if gallery is not None:  # a mistake in the option is no regression
        check_file(str(gallery))
        load_gallery(gallery)
    with Stop().listening() as stopped, progress(quiet) as shown:
        shown.begin(str(folder))
        runs: dict[str, Any] = {"gallery": gallery, "workers": jobs, "stopped": stopped, "report": shown.update}
        if update:
            code, left = _update(folder, config, seeds, stop, runs)
        else:
            code, left = _check(folder, config, overrides, reports, runs)
        if stopped.code is not None:
            shown.say(f"{stopped.reason}{left}")
    return stopped.code or code


def _check(
    folder: Path,
    config: tuple[str, ...],
    overrides: tuple[str, ...],
    reports: tuple[Path | None, Path | None, bool],
    runs: dict[str, Any],
) -> tuple[ExitCode, str]:
    """Check the goldens, a line of each; the exit code, and what to say if it was interrupted."""
    from facetrack_cli.core.errors import flat
    from facetrack_cli.core.files import write_new
    from facetrack_cli.evaluation.goldens.check import check, select
    from facetrack_cli.evaluation.goldens.output import as_json, as_junit, line, summary
    from facetrack_cli.recipe.load import load_recipe

    junit, json, overwrite = reports
    began = time.monotonic()
    given = [load_recipe(name, overrides, installed=False) for name in config]
    goldens = select(folder, given)
    found: list[Checked] = []
    for one in check(folder, goldens, given, overrides, **runs):
        found.append(one)
        click.echo("\n".join(map(flat, line(one))))
    if runs["stopped"].code is None:
        seconds = time.monotonic() - began
        if junit is not None:
            write_new(junit, as_junit(found, seconds).encode(), overwrite=overwrite)
        if json is not None:
            write_new(json, as_json(found).encode(), overwrite=overwrite)
        click.echo(flat(summary(found, seconds)))
    code = ExitCode.REGRESSION if any(one.status == "fails" for one in found) else ExitCode.DONE
    return code, f" after {len(found)} of {len(goldens)} goldens"


def _update(
    folder: Path, config: tuple[str, ...], seeds: int | None, stop: int | None, runs: dict[str, Any]
) -> tuple[ExitCode, str]:
    """Record goldens, a line of each; the exit code, and what to say if it was interrupted."""
    from facetrack_cli.core.errors import flat
    from facetrack_cli.evaluation.goldens.check import update

    failed = False
    for one in update(folder, config, seeds or 40, stop, **runs):
        what = f"wrote {one.golden} ({one.message})" if one.status == "ok" else f"skipped: {one.message}"
        if one.status == "fails":
            failed = True
            what = f"not recorded: {one.message}"
        click.echo(flat(f"{one.clip} {one.recipe}: {what}"))
    return ExitCode.BATCH if failed else ExitCode.DONE, "; goldens that were not written are as they were"
