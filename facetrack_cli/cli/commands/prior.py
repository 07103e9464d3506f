"""facetrack prior: learn shape priors from annotated frames, and draw them."""

from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import option, say, write_figure
from facetrack_cli.cli.types import FILE, Text, Whole, words


@click.group()
def command() -> None:
    """Learn shape priors from annotated frames, and draw them.

    A shape prior knows how the parts of a face move together. A recipe names its file as `prior.file`:

    \b
        facetrack prior fit anna.truth.csv -o mouths.npz
        facetrack run clip.mp4 --set prior.file=mouths.npz
    """


def _parts(value: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in value.split(",") if name.strip())
    if not names:
        raise click.BadParameter(f"{value!r}: name the parts with commas, such as nose,mouth_left,mouth_right")
    return names


_SCALE = words("A,B", "([^,]*),([^,]*)", "name two parts with a comma, such as mouth_left,mouth_right")


@command.command()
@click.argument("truth", type=Text("TRUTH.csv", Path), nargs=-1, required=True)
@options.array_file("prior")
@option("--parts", type=Text("LIST", _parts), help="Parts to learn, with commas [default: all].")
@option("--stable", type=Text("PART"), default="nose", help="Part that registers the others.")
@option(
    "--scale", type=_SCALE, default="mouth_left,mouth_right",
    help="Parts whose distance in the first frame is the unit.",
)  # fmt: skip
@option("--max-shapes", type=Whole(1, 10_000), default=500, help="Keep so many at most.")
@options.overwrite
@options.quiet
def fit(
    truth: tuple[Path, ...], out: Path, parts: tuple[str, ...] | None, stable: str, scale: tuple[str, str],
    max_shapes: int, overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn a prior from ground truth or checked trajectories.

    Every file's first frame in which all parts are seen is taken as its neutral one; frames in which a part is hidden,
    absent or lost are left out.

    \b
    Examples:
      facetrack prior fit anna.truth.csv ben.truth.csv -o mouths.npz
      facetrack prior fit clip.truth.csv --parts nose,mouth_left,mouth_right
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.trackers.points.shape_prior import fit_prior

    check_new(out, overwrite=overwrite)
    fitted = fit_prior(truth, parts, stable, scale, max_shapes)
    fitted.prior.save(out)
    if quiet:
        return
    for path, frames, seen in fitted.files:
        say(f"{path}: {seen} of {frames} frames used, {frames - seen} skipped")
    used = sum(seen for _, _, seen in fitted.files)
    say(f"{out}: {len(fitted.prior.shapes)} shapes kept of {used}: {', '.join(fitted.prior.parts)}")
    say(f"suggested sigma: {fitted.sigma:.3f} ({' to '.join(scale)} is 1)")


@command.command()
@click.argument("file", type=FILE, required=False)
@options.figure_file("beside FILE; mouth_prior.png for the shipped prior")
@options.overwrite
def show(file: Path | None, out: Path | None, overwrite: bool) -> None:
    """Summarise and draw a prior; without FILE, the shipped one.

    \b
    Examples:
      facetrack prior show
      facetrack prior show mouths.npz -o mouths.svg
    """
    from facetrack_cli.evaluation.sheet import Sheet
    from facetrack_cli.report.figures.models import prior_figure
    from facetrack_cli.trackers.points.shape_prior import default_prior_path, load_prior, suggested_sigma

    path = file or default_prior_path()
    prior = load_prior(path)
    out = out or (path.with_suffix(".png") if file else Path(path.with_suffix(".png").name))
    sigma = suggested_sigma(prior)
    write_figure(out, lambda: prior_figure(prior, sigma, title=path.name), overwrite=overwrite, inputs=[path])
    rows = []
    for name, low, high, sd in zip(
        prior.parts, prior.shapes.min(0), prior.shapes.max(0), prior.shapes.std(0), strict=True
    ):
        rows.append((name, *(f"{of[axis]:.3f}" for axis in (0, 1) for of in (low, high, sd))))
    notes = (
        f"registered by {prior.stable}; unit: {' to '.join(prior.scale)} in the first frame",
        f"suggested sigma: {sigma:.3f}",
        f"figure: {out}",
    )
    title = f"{path.name}: {len(prior.shapes)} shapes of {len(prior.parts)} parts"
    Sheet(title, ("part", "x from", "to", "sd", "y from", "to", "sd"), tuple(rows), notes).show()
