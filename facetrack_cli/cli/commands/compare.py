"""facetrack compare: recipes side by side on a clip with ground truth."""

from pathlib import Path

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, Extent, Results, TruthOptions, Whole, argument, group, option, verb
from facetrack_cli.core.errors import ExitCode

PLOTS = ("success.png", "precision.png", "cumulative.png", "error.png")


class Compare:
    """Run recipes on a clip with ground truth, and rank them.

    Each recipe runs with seeds 0 to N-1; one that cannot run on this clip gets a row that says why. The table has the
    mean and the standard deviation over seeds, the runs that failed, and the frames/s of the tracker alone, without
    decoding. All rows are timed in the same run; only ratios between them mean anything (best with -j 1).

    Boxes are ranked by success AUC, points by the mean normalised error. Recipes whose means +- 2 standard errors
    overlap share their ranks: the runs do not tell them apart.

    \b
    The folder gets compare.json, compare.csv (a row a recipe and seed),
    compare.md, and
      success.png, precision.png    of boxes
      cumulative.png                of points
      error.png                     over time: median and 10-90 % of the
                                    seeds, hidden spans shaded

    \b
    Examples:
      facetrack compare clip.mp4 --config factorized --config sir
      facetrack compare clip.mp4 --config mil --config csrt --seeds 20 -j 2
      facetrack compare hands.mp4 --target left_hand \\
        --config histogram --config contour_histogram
      facetrack compare frames/ --truth groundtruth.txt \\
        --config sir:filter.particles=100 --config sir:filter.particles=500
      facetrack compare clip.mp4 --config adaptive --config mine.yaml \\
        --gallery people.npz
      facetrack compare clip.mp4 --config a.yaml --config b.yaml --csv -q

    \b
    Exit codes: 0 done, 2 usage, recipe or output, 3 input,
    5 some of the recipes could not run, 130 interrupted, 143 terminated.
    """

    clip: Path = argument("INPUT")
    config: tuple[str, ...] = option(
        "--config RECIPE",
        "Recipe: a file, a name, or either with its own keys, as sir:filter.particles=500; repeat for each.",
        multiple=True,
        required=True,
    )
    seeds: int = option("--seeds N", "Runs of each, seed 0 on.", type=Whole(min=1), default=10)
    rank_by: str | None = option("--rank-by MEASURE", "Rank by this, as points.median_px or boxes.precision_20.")
    set: tuple[str, ...] = option("--set KEY=VALUE", "Override a key of all; repeatable.", multiple=True)
    gallery: str | None = options.GALLERY
    truth: Path | None = option(
        "--truth FILE", "Ground truth [default: <clip>.truth.csv, else groundtruth.csv beside the clip].", type=FILE
    )
    truth_options: TruthOptions = group(TruthOptions)
    extent: Extent = group(Extent)
    out: str | None = option("-o --out DIR", "Folder for results [default: ./<clip>-compare].")
    results: Results = group(Results)

    def run(self) -> int:
        from facetrack_cli.evaluation import compare
        from facetrack_cli.evaluation.compare import Comparison
        from facetrack_cli.report.figures.compare import compare_figures
        from facetrack_cli.runs.batch import title
        from facetrack_cli.runs.plan import ClipRequest
        from facetrack_cli.runs.seeds import labels, load_recipes, refuse_seed, variant

        clip, results, extent, known = self.clip, self.results, self.extent, self.truth_options
        extent.check(clip)
        if self.rank_by is not None:
            compare.check_measure(self.rank_by)
        asked = [(name, (*self.set, *own)) for name, own in map(variant, self.config)]
        refuse_seed([one for _, keys in asked for one in keys])
        recipes = dict(zip(labels(self.config), load_recipes(asked, self.gallery), strict=True))
        file = self.truth or compare.default_truth(clip)
        truth = known.read(file)
        with results.open(clip, self.out, f"{title(clip)}-compare", "compare", PLOTS) as (stopped, shown, publish):
            begin = ClipRequest(clip, **vars(extent))
            with begin.open() as source:
                options = compare.Scoring(known.target, known.partial, extent.stop, source.size)
            entries = compare.run_recipes(
                recipes,
                begin,
                truth,
                self.seeds,
                options,
                rank_by=self.rank_by,
                workers=results.jobs,
                stop=stopped,
                shown=shown,
            )
            shown.close()
            if not any(entry.scores for entry in entries):
                shown.say(f"facetrack: {stopped.reason} before a run was complete; nothing was written")
                return stopped.code or ExitCode.FAULT
            measure = self.rank_by or compare.USUAL[compare.kind_of(entries)][0]
            found = Comparison(clip, file, self.seeds, tuple(entries), measure, results.jobs, stopped.code is None)
            publish(found, lambda: compare_figures(found))
            failed = sum(entry.error is not None for entry in entries)
            if failed:
                shown.say(f"{failed} of {len(entries)} recipes could not run")
        return stopped.code or (ExitCode.BATCH if failed else ExitCode.DONE)


command = verb(Compare)
