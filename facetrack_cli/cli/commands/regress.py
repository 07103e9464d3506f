"""facetrack regress: clips against their goldens, for CI."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Whole, argument, flag, option, verb
from facetrack_cli.core.errors import ExitCode, UsageError

if TYPE_CHECKING:
    from facetrack_cli.evaluation.goldens.check import Checked


class Regress:
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

    folder: Path = argument("DIR")
    config: tuple[str, ...] = option(
        "--config RECIPE",
        "Only this recipe, a file or a name; repeatable [default: all that have goldens].",
        multiple=True,
    )
    set: tuple[str, ...] = option("--set KEY=VALUE", "Check with this key changed; repeatable.", multiple=True)
    gallery: Path | None = option(
        "--gallery FILE", "People that recipes with recognition know; a golden remembers its own.", type=FILE
    )
    update: bool = flag("--update", "Record goldens instead: of --config, else of all that have one.")
    seeds: int | None = option("--seeds N", "Runs to record a golden from [default: 40].", type=Whole(min=20, max=500))
    stop: int | None = option("--stop N", "Record up to this frame only; for slow trackers.", type=Whole(min=2))
    junit: Path | None = option("--junit FILE", "Write JUnit XML, for CI services.", type=FILE)
    json: Path | None = option("--json FILE", "Write the results as JSON.", type=FILE)
    overwrite: bool = options.OVERWRITE
    jobs: int = options.jobs_option("Goldens at a time.")
    quiet: bool = flag("--quiet -q", "No progress.")

    def run(self) -> int:
        from facetrack_cli.core.files import check_new
        from facetrack_cli.recipe.gallery_option import check_file
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.trackers.appearance.gallery import load_gallery

        if self.update and (self.set or self.junit or self.json):
            raise UsageError("--update records recipes as they are; leave --set, --junit and --json to a check")
        if not self.update and (self.seeds is not None or self.stop is not None):
            raise UsageError("--seeds and --stop go with --update; a check takes them from the golden")
        if self.junit is not None and self.junit == self.json:
            raise UsageError("--junit and --json name the same file; give two names")
        for path in filter(None, (self.junit, self.json)):
            check_new(path, overwrite=self.overwrite)
        if self.gallery is not None:  # a mistake in the option is no regression
            check_file(str(self.gallery))
            load_gallery(self.gallery)
        with Stop().listening() as stopped, progress(self.quiet) as shown:
            shown.begin(str(self.folder))
            runs: dict[str, Any] = {
                "gallery": self.gallery,
                "workers": self.jobs,
                "stopped": stopped,
                "report": shown.update,
            }
            code, left = self._update(runs) if self.update else self._check(runs)
            if stopped.code is not None:
                shown.say(f"{stopped.reason}{left}")
        return stopped.code or code

    def _check(self, runs: dict[str, Any]) -> tuple[ExitCode, str]:
        """Check the goldens, a line of each; the exit code, and what to say if it was interrupted."""
        from facetrack_cli.core.errors import flat
        from facetrack_cli.core.files import write_new
        from facetrack_cli.evaluation.goldens.check import check, select
        from facetrack_cli.evaluation.goldens.output import as_json, as_junit, line, summary
        from facetrack_cli.recipe.load import load_recipe

        began = time.monotonic()
        given = [load_recipe(name, self.set, installed=False) for name in self.config]
        goldens = select(self.folder, given)
        found: list[Checked] = []
        for one in check(self.folder, goldens, given, self.set, **runs):
            found.append(one)
            click.echo("\n".join(map(flat, line(one))))
        if runs["stopped"].code is None:
            seconds = time.monotonic() - began
            if self.junit is not None:
                write_new(self.junit, as_junit(found, seconds).encode(), overwrite=self.overwrite)
            if self.json is not None:
                write_new(self.json, as_json(found).encode(), overwrite=self.overwrite)
            click.echo(flat(summary(found, seconds)))
        code = ExitCode.REGRESSION if any(one.status == "fails" for one in found) else ExitCode.DONE
        return code, f" after {len(found)} of {len(goldens)} goldens"

    def _update(self, runs: dict[str, Any]) -> tuple[ExitCode, str]:
        """Record goldens, a line of each; the exit code, and what to say if it was interrupted."""
        from facetrack_cli.core.errors import flat
        from facetrack_cli.evaluation.goldens.check import update

        failed = False
        for one in update(self.folder, self.config, self.seeds or 40, self.stop, **runs):
            what = f"wrote {one.golden} ({one.message})" if one.status == "ok" else f"skipped: {one.message}"
            if one.status == "fails":
                failed = True
                what = f"not recorded: {one.message}"
            click.echo(flat(f"{one.clip} {one.recipe}: {what}"))
        return ExitCode.BATCH if failed else ExitCode.DONE, "; goldens that were not written are as they were"


command = verb(Regress)
