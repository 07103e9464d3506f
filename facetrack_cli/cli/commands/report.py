"""facetrack report: one HTML page about a run."""

from pathlib import Path

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, TruthOptions, argument, group, option, verb


class Report:
    """Write one HTML page about a run, or about a batch.

    RUN_DIR is the folder that facetrack run wrote. The page shows when each part was lost and found again, with
    images of those frames, the plots, the recipe, and the command that repeats the run; with --truth also the
    measures. It is a single file that needs neither network nor scripts.

    Of a folder with the runs of a batch the page is batch.html: a table of the clips, the worst first, with a still of
    each and links to its files.

    The images are drawn from the clip, or taken from annotated.mp4 where the clip cannot be read.

    \b
    Examples:
      facetrack report out
      facetrack report out --truth clip.truth.csv -o paper/supplement.html
      facetrack report out --clip /archive/clip.mp4 --overwrite
      facetrack report results

    \b
    Exit codes: 0 done, 2 usage, output, or matplotlib is missing,
    3 input, 130 interrupted, 143 terminated.
    """

    folder: Path = argument("RUN_DIR")
    truth: Path | None = option("--truth FILE", "Measure against this file of ground truth.", type=FILE)
    truth_options: TruthOptions = group(TruthOptions)
    out: Path | None = option("-o --out FILE", "The page [default: RUN_DIR/report.html, or batch.html].", type=FILE)
    clip: Path | None = options.CLIP
    title: str | None = options.TITLE
    overwrite: bool = options.OVERWRITE
    quiet: bool = options.QUIET

    def run(self) -> int:
        from facetrack_cli.core.errors import UsageError
        from facetrack_cli.core.files import check_new, check_plain, write_new
        from facetrack_cli.report.batch import PAGE, make_batch_report
        from facetrack_cli.report.make import TruthFile, make_report
        from facetrack_cli.run_folder.manifest import REPORT, trajectory_of
        from facetrack_cli.run_folder.status import is_batch
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop

        if self.truth is None:
            self.truth_options.refuse(target=True)
        batch = is_batch(self.folder)
        if batch and (self.truth or self.clip):
            raise UsageError("--truth and --clip are of one run; name its folder, or leave them out")
        if not batch:
            trajectory_of(self.folder)
        to = self.folder / (PAGE if batch else REPORT) if self.out is None else self.out
        if self.out is None:
            check_plain(to)
        check_new(to, overwrite=self.overwrite, inputs=(self.truth, self.clip))
        with progress(self.quiet) as shown:
            shown.begin(self.folder.name or str(self.folder), "clips" if batch else "frames")
            truth = None if self.truth is None else TruthFile(self.truth, *vars(self.truth_options).values())
            if batch:
                page = make_batch_report(self.folder, to, self.title, shown.update)
            else:
                page = make_report(self.folder, truth=truth, clip=self.clip, title=self.title, report=shown.update)
            with Stop().listening() as stop:  # a Ctrl-C before this ends us with nothing written, from here on with all
                write_new(to, page.html, overwrite=self.overwrite)
            for note in page.notes:
                shown.say(f"facetrack: warning: {note}")
            shown.say(f"{self.folder} -> {to} ({len(page.html) / 1e6:.1f} MB)")
        return stop.code or 0


command = verb(Report)
