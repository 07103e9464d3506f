"""The command line: a group that loads a command only when it is called, so that `facetrack --help` is instant."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

import click
from click.shell_completion import CompletionItem

from facetrack_cli.cli.options import option
from facetrack_cli.core import __version__
from facetrack_cli.core.errors import LOG_FORMAT

SECTIONS = {
    "Track": {
        "run": "Track faces, heads and hands in videos and image folders.",
        "app": "Track, look, correct and export on one page.",
        "init": "Write where the track of a clip begins, as a file to edit.",
        "status": "Tell how far a batch is: done, running, failed, time left.",
    },
    "Correct": {
        "fix": "Correct a finished run, on a page.",
        "people": "Show and correct who is in a film.",
    },
    "Look and share": {
        "report": "Write one HTML page about a run.",
        "plot": "Draw what happened in a trajectory.",
        "export": "Write a trajectory as other tools read it.",
    },
    "Measure": {
        "eval": "Measure a trajectory against ground truth.",
        "compare": "Run and rank several recipes on a clip with ground truth.",
        "regress": "Check clips against their golden results, for CI.",
    },
    "Recipes and networks": {
        "recipes": "List, show and check the recipes of trackers.",
        "prior": "Learn shape priors from annotated frames, and show them.",
        "gallery": "Learn who is who from images and videos, and draw it.",
        "models": "List and fetch optional networks.",
    },
}
"""Commands and their one-line helps, which stand here because to ask the commands for theirs would load them."""
COMMANDS = {name: text for section in SECTIONS.values() for name, text in section.items()}
MODULES = {
    **dict.fromkeys(("app", "init", "status"), "start"),
    **dict.fromkeys((*SECTIONS["Correct"], *SECTIONS["Look and share"]), "finished"),
    **dict.fromkeys(SECTIONS["Measure"], "measure"),
    **dict.fromkeys(SECTIONS["Recipes and networks"], "recipes"),
}
"""The file in commands/ of a command; others have one of their own name."""
SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True, "auto_envvar_prefix": "FACETRACK"}
READER_GONE = 141
"""Exit code when the reader of standard output is gone, as in `facetrack ... | head`: the shell's, for SIGPIPE."""


@contextmanager
def _quiet_when_reader_gone() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise click.exceptions.Exit(READER_GONE) from None  # click itself would exit with 1


class LazyGroup(click.Group):
    def make_context(self, *args: Any, **more: Any) -> click.Context:
        with _quiet_when_reader_gone():  # it prints the help of the group, and the version
            return super().make_context(*args, **more)

    def invoke(self, ctx: click.Context) -> Any:
        with _quiet_when_reader_gone():
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = import_module(f"facetrack_cli.cli.commands.{MODULES.get(cmd_name, cmd_name)}")
        command = getattr(module, f"{cmd_name}_command")
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for title, commands in SECTIONS.items():
            with formatter.section(title):
                formatter.write_dl([*commands.items()], col_max=12)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        names = [CompletionItem(name, help=text) for name, text in COMMANDS.items() if name.startswith(incomplete)]
        return names + click.Command.shell_complete(self, ctx, incomplete)


@click.group(cls=LazyGroup, invoke_without_command=True, context_settings=SETTINGS)
@option(
    "--log-format", type=click.Choice(["text", "json"]), default="text", metavar="FORMAT",
    help="What stderr says: text, or an object of JSON a line.",
)  # fmt: skip
@click.version_option(__version__, prog_name="facetrack", message="%(prog)s %(version)s")
@click.pass_context
def cli(ctx: click.Context, log_format: str) -> None:
    """Track faces, facial features, heads and hands in video with particle filters.

    A recipe says which tracker; a clip goes in, a trajectory and an annotated
    video come out:

    \b
        facetrack run clip.mp4 --config factorized
        facetrack recipes
        facetrack run --help

    Variables set defaults of options, as FACETRACK_RUN_JOBS=4 for --jobs of
    run. FACETRACK_DEBUG=1 shows the traceback of an error.

    Exit codes: 0 done, 1 internal error, 2 usage, recipe or output,
    3 input, 4 target lost (with --fail-on-lost), 5 some of a batch failed,
    6 regression, 130 interrupted, 143 terminated.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
        return
    os.environ[LOG_FORMAT] = log_format
