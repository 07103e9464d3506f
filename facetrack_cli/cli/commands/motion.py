"""facetrack motion: learn motion models from annotated tracks."""

from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, argument, option, say, verb


@click.group()
def command() -> None:
    """Learn motion models from annotated tracks.

    \b
        facetrack motion fit anna.truth.csv ben.truth.csv
    """


class Fit:
    """Learn the section `motion` of a recipe from tracks.

    Of boxes: A and B of first_order, c_k = A c_{k-1} + B w_k for place and scale with their speeds (Odobez et al.
    2003, section 3.2), by maximum likelihood, and sigma of random_walk. Of points: sigma of random_walk for each part.
    Frames in which a part is hidden, absent or lost are left out, and jitter of the annotations counts as no motion.
    The block is for recipes as it is: it stands in place of their section `motion`.

    \b
    Examples:
      facetrack motion fit anna.truth.csv ben.truth.csv
      facetrack motion fit anna.truth.csv --target face -o motion.yaml
    """

    truth: tuple[Path, ...] = argument("TRUTH.csv...", nargs=-1, required=True)
    target: str | None = options.TARGET
    out: Path | None = option("-o --out FILE", "Where the block goes [default: standard output].", type=FILE)
    overwrite: bool = options.OVERWRITE

    def run(self) -> None:
        from facetrack_cli.core.files import check_new, write_new
        from facetrack_cli.tracking.models.motion_fit import as_yaml, fit_motion

        if self.out is not None:
            check_new(self.out, overwrite=self.overwrite, inputs=self.truth)
        found = as_yaml(fit_motion(self.truth, self.target))
        if self.out is None:
            click.echo(found, nl=False)
        else:
            write_new(self.out, found.encode(), overwrite=self.overwrite)
            say(f"{len(self.truth)} files -> {self.out}")


command.add_command(verb(Fit, "fit"))
