"""facetrack regress: clips against their goldens, for CI."""

import time
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import flag, option
from facetrack_cli.cli.types import FILE, FOLDER, RECIPE, Whole
from facetrack_cli.core.errors import ExitCode, RecipeError, UsageError


@click.command()
@click.argument("folder", type=FOLDER)
@option(
    "--config", type=RECIPE, multiple=True,
    help="Only this recipe, a file or a name; repeatable [default: all that have goldens].",
)  # fmt: skip
@options.set_("Check with this key changed; repeatable.")
@option("--gallery", type=FILE, help="People that recipes with recognition know; a golden remembers its own.")
@flag("--update", help="Record goldens instead: of --config, else of all that have one.")
@option("--seeds", type=Whole(min=5, max=500), help="Runs to record a golden from [default: 10].")
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

    Runs every clip in DIR that has a golden, DIR/goldens/<clip>.<recipe>.json. With the recipe and the versions that it
    was recorded with, a run must give the same rows. With others, also on another processor, four seeds are run: a
    check fails if all of them are off more than the seeds that were recorded are from each other.

    A recipe that was edited is named, and checked all the same. One that this installation cannot run is skipped.

    \b
    Examples:
      facetrack regress sample_videos -j 2 --junit regress.xml
      facetrack regress clips --config factorized --update
      facetrack regress clips --config mine.yaml --gallery people.npz --update
      facetrack regress clips --update --seeds 40
      facetrack regress sample_videos --config sir --set motion.sigma=0.13

    \b
    Exit codes: 0 all pass, 2 usage, recipe or output, 3 input, or no goldens,
    5 some could not be recorded, 6 a regression, 130 interrupted, 143 terminated.
    """
    from facetrack_cli.core.errors import flat
    from facetrack_cli.core.files import check_new, write_new
    from facetrack_cli.evaluation.goldens import SEEDS, as_json, as_junit, counts, recordable, recorded, regress
    from facetrack_cli.recipe.load import check_gallery_file, load_recipe
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.runs.signals import Stop
    from facetrack_cli.trackers.appearance.gallery import load_gallery

    if update and (overrides or junit or json):
        raise UsageError("--update records recipes as they are; leave --set, --junit and --json to a check")
    if not update and (seeds is not None or stop is not None):
        raise UsageError("--seeds and --stop go with --update; a check takes them from the golden")
    if junit is not None and junit == json:
        raise UsageError("--junit and --json name the same file; give two names")
    for path in filter(None, (junit, json)):
        check_new(path, overwrite=overwrite)
    if gallery is not None:  # a mistake in the option is no regression
        check_gallery_file(str(gallery))
        load_gallery(gallery)
    given = {load_recipe(name, overrides, installed=False).name: name for name in config}
    asked = recordable(folder, given) if update and given else recorded(folder, given)
    for each in asked if overrides else ():
        try:
            load_recipe(each.recipe, overrides, installed=False)
        except RecipeError as e:  # what is wrong with the recipe fails its golden
            if str(e).startswith("--set"):
                raise
    fails, began, found = "not recorded" if update else "FAILS", time.monotonic(), []
    with Stop().listening() as stopped, progress(quiet) as shown:
        shown.begin(str(folder))
        results = regress(
            folder, asked, update=update, overrides=overrides, seeds=seeds or SEEDS, stop=stop, gallery=gallery,
            stopped=stopped, workers=jobs, report=shown.update,
        )  # fmt: skip
        for one in results:
            found.append(one)
            ok = one.message if update else f"ok ({one.message}; {one.seconds:.1f} s)"
            said = {"ok": ok, "fails": f"{fails}: {one.message}", "skipped": f"skipped: {one.message}"}[one.status]
            for line in (f"{one.clip} {one.recipe}: {said}", *(f"    {more}" for more in one.details)):
                click.echo(flat(line))
        if stopped.code is not None:
            shown.say(f"{stopped.reason} after {len(found)} of {len(asked)} goldens")
            return stopped.code
    many = counts(found)
    if update:
        return ExitCode.BATCH if many["fails"] else ExitCode.DONE
    for file, text in ((junit, as_junit), (json, as_json)):
        if file is not None:
            write_new(file, text(found).encode(), overwrite=overwrite)
    took = f"{len(found)} golden{'s' * (len(found) != 1)} in {time.monotonic() - began:.0f} s"
    skipped = f", {many['skipped']} skipped" if many["skipped"] else ""
    click.echo(f"{took}: {many['ok']} ok, {many['fails']} FAIL{'S' * (many['fails'] == 1)}{skipped}")
    return ExitCode.REGRESSION if many["fails"] else ExitCode.DONE
