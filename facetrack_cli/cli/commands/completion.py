"""facetrack completion: what a shell reads to complete command lines."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

from facetrack_cli.cli.app import cli


@click.command()
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]), metavar="SHELL")
def command(shell: str) -> None:
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
    made = kind(cli, {}, "facetrack", "_FACETRACK_COMPLETE")
    click.echo(made.source_template % made.source_vars())  # not source(): that calls Bash to ask for its version
