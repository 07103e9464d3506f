"""facetrack repeat: how far the runs of a recipe differ from seed to seed."""

from pathlib import Path

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Extent, Number, Results, Whole, argument, group, option, verb
from facetrack_cli.core.errors import ExitCode


class Repeat:
    """Show how far the runs of a recipe differ from seed to seed.

    For each part: the spread over seeds, the run farthest from the median of all, and the frame at which the runs
    part ways, which is the first of 5 frames in a row in which a run is farther from the median of all than a
    quarter of the target's size (--apart). Then who leaves, when and how far; with ground truth, each run's error at
    the end.

    All runs advance together; after Ctrl-C the table holds the frames that they had reached.

    \b
    The folder gets repeat.csv (a row a frame and part: mean position,
    standard deviations, farthest run), repeat.json, repeat.md, spread.png.

    \b
    Examples:
      facetrack repeat clip.mp4 --config factorized
      facetrack repeat clip.mp4 --seeds 50 -j 2 --truth clip.truth.csv
      facetrack repeat frames/ --config sir --stop 200 --csv -q > spread.csv

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input, 130 interrupted,
    143 terminated.
    """

    clip: Path = argument("INPUT")
    config: str | None = options.CONFIG
    seeds: int = option("--seeds N", "Runs, from seed 0 on.", type=Whole(min=2), default=20)
    set: tuple[str, ...] = options.OVERRIDES
    gallery: str | None = options.GALLERY
    extent: Extent = group(Extent)
    apart: float = option(
        "--apart SHARE",
        "Share of the target's size beyond which a run is apart from the others.",
        type=Number(0, min_open=True),
        default=0.25,
    )
    truth: Path | None = option("--truth FILE", "Ground truth, for the error of each run at the end.", type=FILE)
    out: str | None = option("-o --out DIR", "Folder for results [default: ./<clip>-<recipe>-repeat].")
    results: Results = group(Results)

    def run(self) -> int:
        from facetrack_cli.evaluation.experiments.repeat import Repetition, spreads
        from facetrack_cli.evaluation.sheet import clip_name
        from facetrack_cli.recipe.files import default_recipe
        from facetrack_cli.report.figures.comparison import repeat_figures
        from facetrack_cli.runs.batch import title
        from facetrack_cli.runs.seeds import Plan, load_recipes, refuse_seed, run_plans
        from facetrack_cli.runs.start import Begin
        from facetrack_cli.trajectory.formats.read import read_truth

        clip, results = self.clip, self.results
        self.extent.check(clip)
        refuse_seed(self.set)
        config = default_recipe(box=self.extent.box is not None) if self.config is None else self.config
        [recipe] = load_recipes([(config, self.set)], self.gallery)
        truth = None if self.truth is None else read_truth(self.truth)
        name = f"{title(clip)}-{recipe.name}-repeat"
        with results.open(clip, self.out, name, "repeat", ["spread.png"]) as (stopped, shown, publish):
            begin = Begin(clip, **vars(self.extent))
            start = begin.find(recipe, truth, stopped)
            plan = Plan(recipe.name, clip, recipe, start, tuple(range(self.seeds)), begin.stop, begin.fps)
            shown.begin(clip_name(clip))
            [ended] = run_plans([plan], results.jobs, stopped, shown.update, partial=True)
            if ended.error is not None:
                raise ended.error
            runs = ended.runs
            shown.close()
            warned = tuple(dict.fromkeys(line for run in runs for line in run.warnings))
            for line in warned:
                shown.say(f"facetrack: warning: {line}")
            if len(runs) < 2:
                shown.say(f"facetrack: {stopped.reason} before two runs had begun; nothing was written")
                return stopped.code or ExitCode.FAULT
            tables, seeds = [run.trajectory for run in runs], tuple(run.seed for run in runs)
            spread = spreads(seeds, tables, self.apart, truth)
            complete = stopped.code is None
            found = Repetition(clip, recipe.name, recipe, seeds, spread, self.apart, self.truth, complete, warned)
            publish(found, lambda: repeat_figures(found))
        return stopped.code or ExitCode.DONE


command = verb(Repeat)
