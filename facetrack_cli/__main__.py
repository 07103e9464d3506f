"""Run the command line: every error ends in one line on stderr and its exit code (core/errors.py)."""

import contextlib
import errno
import gc
import io
import os
import signal
import sys
from collections.abc import Sequence
from typing import TextIO

from facetrack_cli.core.errors import ExitCode, FacetrackError, from_system, log_line
from facetrack_cli.runs.signals import ending_at_once

_MAX_MESSAGE = 1000  # characters of an error
_STREAM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command line (by default the process's own) and return its exit code."""
    _open_streams()
    if argv is None:
        gc.set_threshold(300_000, 20, 100)  # to look through what is imported, and stays, takes a tenth of a short run
        # before numpy is imported: the matrices are small, and threads only wait for each other
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # or it looks through all packages for some
    with ending_at_once():  # also while the commands are loaded
        code = _run(argv)
    if argv is None:
        for name in ("SIGINT", "SIGTERM", "SIGHUP"):  # while the interpreter ends, they must not change the exit code
            with contextlib.suppress(ValueError, KeyError):  # not in the main thread; not on Windows
                signal.signal(signal.Signals[name], signal.SIG_IGN)
        try:
            sys.stderr.flush()
        except OSError:  # a full disk under the log must not change the exit code
            _forget(sys.stderr)
        gc.freeze()  # the interpreter's last look through all that numba made, a fifth of a second, frees nothing
    return code


def _open_streams() -> None:
    """Streams that can be written to, whatever the shell closed; output to a closed stdout is an error."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull)  # noqa: SIM115, PTH123 -- for as long as the process lives
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115, PTH123
    # as stderr does: a name that is no text, or an arrow on a pipe of Windows, must not end a command
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def _run(argv: Sequence[str] | None) -> int:
    import click

    from facetrack_cli.cli.app import READER_GONE, cli

    try:
        code = cli.main(None if argv is None else list(argv), prog_name="facetrack", standalone_mode=False)
        sys.stdout.flush()
        return int(code) if isinstance(code, int) else ExitCode.DONE
    except click.ClickException as error:
        context = getattr(error, "ctx", None)
        hint = f" (see {context.command_path} --help)" if context is not None else ""
        message = error.format_message().replace("\n\t", " ")  # Click lists choices a line each
        _say(f"error: {message.rstrip('.')}{hint}")
        return ExitCode.USAGE
    except (KeyboardInterrupt, click.Abort) as error:
        if isinstance(error.__cause__, EOFError):  # which click takes for Ctrl-C at a prompt
            return _failed(error.__cause__)
        _say("interrupted")
        return ExitCode.INTERRUPTED
    except BrokenPipeError:
        _forget(sys.stdout)
        return READER_GONE
    except Exception as error:
        return _failed(error)


def _failed(error: Exception) -> int:
    """Say what went wrong, with FACETRACK_DEBUG=1 also where; the exit code."""
    code = ExitCode.FAULT
    if isinstance(error, FacetrackError):
        code, message = error.exit_code, str(error)
    elif (of_system := from_system(error)) is not None:
        code, message = of_system.exit_code, str(of_system)
    elif (  # errors of files are raised with their names: without one it is standard output
        isinstance(error, OSError)
        and error.filename is None
        and (error.errno in _STREAM or isinstance(error, io.UnsupportedOperation))
    ):
        _forget(sys.stdout)
        code = ExitCode.USAGE
        message = f"standard output: cannot be written: {getattr(error, 'strerror', None) or error}; send it elsewhere"
    else:
        message = f"internal error: {type(error).__name__}{f': {error}' if str(error) else ''}; please report it"
        message += "" if _debugging() else ", with what FACETRACK_DEBUG=1 prints"
    _say(f"error: {message}")
    if _debugging():
        import traceback

        traceback.print_exception(error)
    return int(code)


def _say(message: str) -> None:
    if len(message) > _MAX_MESSAGE:  # it quotes what a file says; the place stands first, the remedy last
        message = f"{message[: _MAX_MESSAGE // 2]} ... {message[-_MAX_MESSAGE // 2 :]}"
    import click

    with contextlib.suppress(OSError):  # a full disk under the log must not change the exit code
        click.echo(log_line(f"facetrack: {message}"), err=True)


def _forget(stream: TextIO) -> None:
    """Or the interpreter tries to flush once more while it shuts down, and complains."""
    with contextlib.suppress(OSError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _debugging() -> bool:
    return os.environ.get("FACETRACK_DEBUG", "") not in ("", "0")


if __name__ == "__main__":
    sys.exit(main())
