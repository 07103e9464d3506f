"""facetrack tune: settings of a recipe searched on clips, and what they gain on clips that did not choose them."""

from functools import partial
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, FRAME, TruthOptions, Whole, argument, flag, group, option, verb
from facetrack_cli.core.errors import ExitCode, UsageError


class Tune:
    """Search settings of a recipe, checked on held-out clips.

    Optuna proposes settings within the ranges. Each runs on all clips with the seeds 0 to N-1, and so does the recipe
    as it is. Then each clip in turn is held out: the setting with the best mean over the others is measured on it. The
    table has the recipe as it is beside what was tuned, for each held-out clip; below it stand how far the choices
    differ, and whether the gain is larger than the spread. --out gets the recipe with the best setting of all clips.

    Settings are compared by ground truth beside each clip: points by points.auc and boxes by boxes.success_auc, which
    no clip decides alone, or by --measure. With --by evidence they are compared by the mean log marginal likelihood of
    a frame, without ground truth. That is for settings of motion, filter and prior, not of likelihoods, whose density
    is not normalised.

    \b
    Ranges:
      motion.sigma=0.02..0.3         numbers
      likelihood.sigma=0.5..3:log    sampled evenly in the logarithm
      filter.particles=50..400       whole numbers, where the key takes them
      likelihood.robust=l1,huber     choices

    \b
    Examples:
      facetrack tune factorized a.mp4 b.mp4 c.mp4 \\
        --set-range motion.sigma=0.02..0.3:log -o tuned.yaml
      facetrack tune histogram clips/*.mp4 --measure boxes.precision_20 \\
        --set-range likelihood.histogram.lambda_h=10..100 -j 2
      facetrack tune sir a.mp4 b.mp4 --by evidence \\
        --set-range motion.sigma=0.02..0.3 --trials 20

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input, 130 interrupted,
    143 terminated.
    """

    recipe: str = argument("RECIPE", type=str)
    clips: tuple[Path, ...] = argument("INPUT...", nargs=-1, required=True)
    ranges: tuple[str, ...] = option(
        "--set-range KEY=RANGE", "Values of a key to search; repeatable.", multiple=True, required=True
    )
    set: tuple[str, ...] = options.OVERRIDES
    by: str = option("--by truth|evidence", "What settings are compared by.", type=click.Choice(["truth", "evidence"]),
                     default="truth")  # fmt: skip
    measure: str | None = option("--measure MEASURE", "Of ground truth, as points.median_px or boxes.precision_20.")
    seeds: int = option("--seeds N", "Runs of each setting on each clip, seed 0 on.", type=Whole(min=1), default=3)
    trials: int = option("--trials N", "Settings that are proposed.", type=Whole(min=1), default=30)
    seed: int = option("--seed N", "Seed of the proposals.", type=Whole(min=0, max=2**32 - 1), default=0)
    truth: tuple[Path, ...] = option(
        "--truth FILE",
        "Ground truth, one for each clip in their order [default: <clip>.truth.csv, else groundtruth.csv beside it].",
        type=FILE,
        multiple=True,
    )
    truth_options: TruthOptions = group(TruthOptions)
    stop: int | None = option("--stop N", "Frame to stop before, in all clips.", type=FRAME)
    out: Path | None = option("-o --out FILE", "Write the recipe with the best setting of all clips.", type=FILE)
    as_json: bool = flag("--json", "Print JSON instead of the table.")
    overwrite: bool = options.OVERWRITE
    jobs: int = options.jobs_option("Processes that share the runs of each setting; for long clips.")
    quiet: bool = flag("--quiet -q", "Print the table, and nothing else but errors.")

    def run(self) -> int:
        from facetrack_cli.core.files import check_new, write_new
        from facetrack_cli.evaluation.experiments import tune
        from facetrack_cli.evaluation.experiments.compare import check_measure, default_truth
        from facetrack_cli.recipe.files import find_recipe
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.seeds import refuse_seed
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.runs.start import Begin

        known, by_truth = self.truth_options, self.by == "truth"
        if not by_truth and self.measure is not None:
            raise UsageError("--measure is one of ground truth; leave it, or take --by truth")
        if self.truth and len(self.truth) != len(self.clips):
            raise UsageError(f"--truth names {len(self.truth)} files for {len(self.clips)} clips; give one for each")
        if self.measure is not None:
            check_measure(self.measure, "--measure")
        ranges = [tune.read_range(one) for one in self.ranges]
        keys = [one.key for one in ranges]
        if twice := [key for key in keys if keys.count(key) > 1]:
            raise UsageError(f"--set-range {twice[0]} is given twice; give one range")
        refuse_seed([*self.set, *self.ranges])
        if self.out is not None:
            check_new(self.out, overwrite=self.overwrite, inputs=[find_recipe(self.recipe), *self.clips])

        load = partial(tune.load_with, self.recipe, self.set)

        recipe = load(())
        if not by_truth and not recipe.filters:
            raise UsageError(f"{recipe.name} is no particle filter, and so has no evidence; take --by truth")
        ranges = [tune.checked(one, load) for one in ranges]
        with Stop().listening() as stopped, progress(self.quiet) as shown:
            cases = []
            for i, clip in enumerate(self.clips):
                file = self.truth[i] if self.truth else default_truth(clip) if by_truth else None
                truth = None if file is None else known.read(file)
                begin = Begin(clip, stop=self.stop)
                cases.append(tune.case_of(begin, recipe, truth, stopped, known.target, partial=known.partial))
            measure = (self.measure or tune.usual_measure(cases)) if by_truth else tune.EVIDENCE
            search = tune.Search(seeds=self.seeds, trials=self.trials, seed=self.seed, workers=self.jobs)
            found = tune.tune(load, ranges, cases, measure, search, stopped, shown)
            shown.close()
            if found is None:
                shown.say(f"facetrack: {stopped.reason} before the recipe as it is was measured; nothing was written")
                return stopped.code or ExitCode.FAULT
            for line in found.warnings:
                shown.say(f"facetrack: warning: {line}")
            try:
                if self.out is not None:
                    text = tune.tuned_recipe(found, self.set)
                    write_new(self.out, text.encode(), overwrite=self.overwrite)
                    shown.say(f"{recipe.name} -> {self.out}")
            finally:  # what took long is not lost for a full disk
                if self.as_json:
                    click.echo(tune.as_json(found), nl=False)
                else:
                    tune.sheet(found).show()
        return stopped.code or ExitCode.DONE


command = verb(Tune)
