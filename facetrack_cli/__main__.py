"""Run the command line: every error ends in one line on stderr and its exit code (errors.py)."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

import click

from facetrack_cli.cli import READER_GONE, cli
from facetrack_cli.errors import ExitCode, FacetrackError, RecipeError


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (by default the process's own) and return its exit code."""
    try:
        code = cli.main(None if argv is None else list(argv), prog_name="facetrack", standalone_mode=False)
        sys.stdout.flush()
        return int(code) if isinstance(code, int) else ExitCode.DONE
    except FacetrackError as error:
        _say(f"error: {error}", error.excerpt if isinstance(error, RecipeError) else "")
        _traceback_if_wanted()
        return int(error.exit_code)
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        _say(f"error: {error.format_message().rstrip('.')}{hint}")
        return ExitCode.USAGE
    except (KeyboardInterrupt, click.Abort):
        _say("interrupted")
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        # or the interpreter tries to flush once more while it shuts down, and complains
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return READER_GONE
    except Exception as error:
        told = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        again = "" if _debugging() else "; run it again as facetrack --debug ... and send us what it prints"
        _say(f"error: this is our fault, not yours: {told}{again}")
        _traceback_if_wanted()
        return ExitCode.FAULT


def _say(message: str, excerpt: str = "") -> None:
    click.echo(f"facetrack: {' '.join(message.splitlines())}", err=True)
    if excerpt:
        click.echo(excerpt, err=True)


def _debugging() -> bool:
    return os.environ.get("FACETRACK_DEBUG", "") not in ("", "0")


def _traceback_if_wanted() -> None:
    if _debugging():
        traceback.print_exc()


if __name__ == "__main__":
    sys.exit(main())
