"""facetrack smooth: a finished run, every row given the whole clip."""

from pathlib import Path

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, argument, flag, option, verb


class Smooth:
    """Smooth a finished run: every row given the whole clip.

    RUN_DIR is a folder that facetrack run --keep-posterior wrote. A filter knows the frames up to now; the smoother
    also those after it. Rows are quieter, and where a part was hidden they lead from where it was last seen to where
    it was seen next. Rows given by hand stay.

    The rows go with annotated.mp4, drawn again, to the folder of -o; or, with --overwrite, to RUN_DIR, where those of
    before are kept in trajectory.filtered.csv.

    \b
    Examples:
      facetrack run clip.mp4 --keep-posterior -o out
      facetrack smooth out -o smooth
      facetrack smooth out --overwrite

    \b
    Exit codes: 0 done, 2 usage or output, 3 input, 130 interrupted,
    143 terminated.
    """

    folder: Path = argument("RUN_DIR")
    out: Path | None = option("-o --out DIR", "Folder for the smoothed run.", type=FILE)
    clip: Path | None = options.CLIP
    no_video: bool = flag("--no-video", "Do not draw annotated.mp4 again.")
    overwrite: bool = options.OVERWRITE
    quiet: bool = options.QUIET

    def run(self) -> int:
        from facetrack_cli.runs.progress import progress
        from facetrack_cli.runs.signals import Stop, StoppedError
        from facetrack_cli.runs.smooth import save_smoothed

        with Stop().listening() as stop, progress(self.quiet) as shown:
            shown.begin(self.folder.name or str(self.folder))
            try:
                files, notes = save_smoothed(
                    self.folder,
                    self.out,
                    overwrite=self.overwrite,
                    video=not self.no_video,
                    clip=self.clip,
                    report=shown.update,
                    stop=stop,
                )
            except StoppedError:
                shown.say(f"{self.folder}: stopped, nothing was written")
                return stop.code or 0
            for note in notes:
                shown.say(f"facetrack: warning: {note}")
            shown.say(f"{self.folder} -> {files[0].parent} ({', '.join(path.name for path in files)})")
        return stop.code or 0


command = verb(Smooth)
