"""Defaults of options that the user sets: variables FACETRACK_RUN_JOBS=4, and `jobs = 4` in [tool.facetrack.run].

The command line wins, then the environment, then the nearest pyproject.toml at or above the working directory.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any

import click

from facetrack_cli.core.errors import FacetrackError, UsageError
from facetrack_cli.core.log import warn

_NOT_SET = {"debug", "version", "help"}  # of facetrack itself; FACETRACK_DEBUG is no default, it also holds elsewhere


def read_defaults(ctx: click.Context) -> dict[str, Any]:
    """The user's defaults for `facetrack` and for the command that is called, by the names of parameters.

    Raises UsageError for an unknown option or a wrong value; it names the file and the key, or the variable.
    """
    found = _nearest()
    path, table = found if found is not None else (Path("pyproject.toml"), {})
    return _of_command(ctx, table, f"{path}: tool.facetrack", "FACETRACK")


def _nearest() -> tuple[Path, Any] | None:
    """The nearest pyproject.toml and its table for us, if it has one."""
    try:
        here = Path.cwd()
    except OSError:  # the folder is gone
        return None
    path = next((one / "pyproject.toml" for one in (here, *here.parents) if (one / "pyproject.toml").is_file()), None)
    if path is None:
        return None
    try:
        data = path.read_bytes()
    except OSError as error:
        warn(f"{path}: cannot be read for defaults: {error.strerror}")
        return None
    if b"facetrack" not in data:  # as in most projects: the parser is not loaded
        return None
    try:
        import tomllib
    except ImportError:
        if b"tool.facetrack" in data:
            warn(f"{path}: its defaults are not read: that takes Python 3.11 or newer; set variables FACETRACK_...")
        return None
    try:
        tool = tomllib.loads(data.decode()).get("tool", {})
    except ValueError as error:
        raise UsageError(f"{path}: no valid TOML: {error}") from None
    return (path, tool["facetrack"]) if isinstance(tool, dict) and "facetrack" in tool else None


def _of_command(ctx: click.Context, table: Any, where: str, prefix: str) -> dict[str, Any]:
    """The defaults of a command's options, and of the command below it that is called, if it is a group."""
    if not isinstance(table, dict):
        raise UsageError(f"{where} is no table; write [tool.facetrack.COMMAND], and below it options")
    options = {_name(one): one for one in ctx.command.params if isinstance(one, click.Option)}
    options = {name: one for name, one in options.items() if ctx.parent is not None or name not in _NOT_SET}
    group = ctx.command if isinstance(ctx.command, click.Group) else None
    below = group.list_commands(ctx) if group is not None else []
    found: dict[str, Any] = {}
    for key, value in table.items():
        name = key.replace("_", "-")
        if name in options:
            _check_kind(options[name], value, f"{where}.{key}")
            found[str(options[name].name)] = _checked(ctx, options[name], value, f"{where}.{name}")
        elif key not in below:
            near = get_close_matches(name, [*options, *below], n=1)
            hint = f'did you mean "{near[0]}"?' if near else f"there are: {', '.join([*options, *below])}"
            raise UsageError(f'{where}: unknown key "{key}"; {hint}')
    for name, option in options.items():
        variable = f"{prefix}_{name.replace('-', '_').upper()}"
        if text := os.environ.get(variable):
            value = option.type.split_envvar_value(text) if option.multiple else text
            found[str(option.name)] = _checked(ctx, option, value, variable)
    # other commands are not loaded
    for name in [one for one in below if ctx.parent is not None or one == ctx.invoked_subcommand]:
        command = group.get_command(ctx, name) if group is not None else None
        if command is not None:
            inner = click.Context(command, info_name=name, parent=ctx)
            variables = f"{prefix}_{name.replace('-', '_').upper()}"
            found[name] = _of_command(inner, table.get(name, {}), f"{where}.{name}", variables)
    return found


def _name(option: click.Option) -> str:
    return max(option.opts, key=len).lstrip("-")


def _check_kind(option: click.Option, value: Any, where: str) -> None:
    """UsageError if a value of TOML is of another kind than the option."""
    if option.is_flag:
        good, wanted = isinstance(value, bool), "true or false"
    else:
        texts = value if option.multiple and isinstance(value, list) else [value]
        good = isinstance(value, list) == option.multiple
        good = good and all(isinstance(one, (str, int, float)) and not isinstance(one, bool) for one in texts)
        wanted = "a list of texts" if option.multiple else "text or a number"
    if not good:
        raise UsageError(f"{where}: give {wanted}")


def _checked(ctx: click.Context, option: click.Option, value: Any, where: str) -> Any:
    """The value as the command line would have it, of a flag whether it is set; UsageError if the option refuses it."""
    if not option.is_flag:
        value = [str(one) for one in value] if option.multiple else str(value)
    try:
        taken = option.process_value(ctx, value)
    except (click.ClickException, FacetrackError) as error:
        message = error.message if isinstance(error, click.ClickException) else str(error)
        raise UsageError(f"{where}: {message.rstrip('.')}") from None
    return taken if option.is_flag else value


def option_of(values: Mapping[str, Any], ctx: click.Context, name: str) -> Any:
    """The value of an option of `facetrack` itself: as given, else its default."""
    given = ctx.get_parameter_source(name) is click.core.ParameterSource.COMMANDLINE
    return ctx.params[name] if given else values.get(name, ctx.params[name])
