"""facetrack calibrate: from clips with ground truth to a file that makes a probability of a recipe's confidence."""

from pathlib import Path

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FIGURES, FILE, Whole, argument, option, verb, write_figure
from facetrack_cli.core.errors import UsageError


def _file(value: str) -> Path:
    if Path(value).suffix != ".json":
        raise UsageError(f"{value}: a calibration is a .json file; let its name end so")
    return Path(value)


class Calibrate:
    """Learn how probable it is that a recipe's rows are right.

    Runs the recipe on clips with ground truth, and fits a map from what it knows of a row (confidence, spread,
    effective sample size, status) to the probability that the error of the centre is below a quarter of the size: one
    for points, one for boxes. All clips weigh the same. Tables show how reliable confidence is before and after, each
    clip by the map that was fitted to the others.

    A recipe names the file as confidence.calibration, and the column confidence is then that probability. Places and
    status stay the same.

    \b
    Examples:
      facetrack calibrate clips/*.mp4 --config factorized_robust -o mine.json
      facetrack run clip.mp4 --config factorized_robust \\
        --set confidence.calibration=mine.json
      facetrack calibrate a/img b/img --truth a/boxes.txt --truth b/boxes.txt \\
        --config correlation_filter --seeds 5 -j 2

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input, 130 interrupted,
    143 terminated.
    """

    clips: tuple[Path, ...] = argument("INPUT...", nargs=-1, required=True)
    config: str | None = option("--config RECIPE", "Recipe: a file, or a name [default: face].")
    truth: tuple[Path, ...] = option(
        "--truth FILE",
        "Ground truth of each clip, in their order; repeatable [default: <clip>.truth.csv, else groundtruth.csv beside "
        "the clip].",
        type=FILE,
        multiple=True,
    )
    seeds: int = option("--seeds N", "Runs of each clip, seed 0 on.", type=Whole(min=1), default=2)
    set: tuple[str, ...] = options.OVERRIDES
    gallery: str | None = options.GALLERY
    stop: int | None = option("--stop N", "Frame to stop before.", type=Whole(min=2))
    out: Path | None = option("-o --out FILE", "Where it goes [default: <recipe>.calibration.json].", type=_file)
    plot: Path | None = option("--plot FILE.png", "Draw the clips left out (needs [plot]).", type=FILE)
    overwrite: bool = options.OVERWRITE
    jobs: int = options.jobs_option("Processes that share the runs.")
    quiet: bool = options.QUIET

    def run(self) -> int:
        from facetrack_cli.core.files import check_new, write_new
        from facetrack_cli.evaluation.experiments import calibrate
        from facetrack_cli.evaluation.experiments.compare import default_truth
        from facetrack_cli.recipe.files import default_recipe
        from facetrack_cli.report.figures.compare import calibration_figure
        from facetrack_cli.report.figures.style import need_matplotlib
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.seeds import load_recipes, refuse_seed
        from facetrack_cli.runs.signals import Stop
        from facetrack_cli.trajectory.formats.read import read_truth

        if self.truth and len(self.truth) != len(self.clips):
            raise UsageError(f"--truth is given {len(self.truth)} times for {len(self.clips)} clips; give one of each")
        if self.plot is not None:
            if self.plot.suffix[1:].lower() not in FIGURES:
                raise UsageError(f"--plot {self.plot}: cannot tell the kind of file; let its name end in .png")
            check_new(self.plot, overwrite=self.overwrite)
            need_matplotlib()
        refuse_seed(self.set)
        [recipe] = load_recipes([(self.config or default_recipe(box=False), self.set)], self.gallery)
        files = self.truth or tuple(map(default_truth, self.clips))
        out = self.out or Path(f"{recipe.name}.calibration.json")
        check_new(out, overwrite=self.overwrite, inputs=(*self.clips, *files))
        known = list(zip(self.clips, map(read_truth, files), strict=True))
        with Stop().listening() as stopped, progress(self.quiet) as shown:
            shown.begin(f"{len(known)} clips")
            found = calibrate.run(recipe, known, self.seeds, self.stop, self.jobs, stopped, shown.update)
            shown.close()
            if found is None:
                shown.say(f"facetrack: {stopped.reason} before all runs were complete; nothing was written")
                return stopped.code or 1
            write_new(out, found.calibration.to_json().encode(), overwrite=self.overwrite)
            for sheet in () if self.quiet else found.sheets():
                sheet.show()
            if self.plot is not None:
                write_figure(self.plot, lambda: calibration_figure(found.bins()), overwrite=self.overwrite)
            shown.say(f"wrote {out}")
        return stopped.code or 0


command = verb(Calibrate)
